"""Files of one character in any order: each is read once, sorted by what it holds, and fitted to the others."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from nilbs.characters.character import Character, assemble, check_sizes, in_dimension
from nilbs.characters.clips import BoneMap, Retargeting, own_clip
from nilbs.characters.motion import Motion, motion_of_clips
from nilbs.characters.report import Report, silent
from nilbs.geometry.plane import flattened, in_space
from nilbs.geometry.simplex import weights_on_simplex
from nilbs.geometry.skeleton import Skeleton
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh, select_group
from nilbs.io.errors import FileFormatError
from nilbs.io.registry import MESHES, RIGS, WHOLE, needs_rig, read_bundle
from nilbs.io.weights import read_weights

_SAME_PLACE = 1e-4  # of the mesh's size: how far vertices of two files may lie apart and still be the same
_AFTER_OTHERS = {".mhskel": 1, ".mhw": 2}  # files that need a mesh, or a rig, to be read


def load_character(
    *paths: str | Path,
    weights: str | Path | None = None,
    group: str | None = None,
    solve: bool = False,
    positions: str = "auto",
    progress: bool = False,
    report: Report | None = None,
) -> Character:
    """Load a rigged character from files; solve for its weights where none are given.

    Parameters
    ----------
    *paths : path
        Files of one character, in any order: a mesh (`.obj`, `.ply`, `.off`, `.stl`, `.3mf`), a rig (`.tgf`, `.txt` of
        RigNet, `.mhskel`, `.bvh`), weights (`.dmat`, `.npz`, `.mhw`); or one that holds several of these (`.glb`,
        `.gltf`, `.fbx`, `.npz` of the SMPL family). A flat mesh (z = 0) is a character in the plane.
    weights : path, optional
        A file of weights, whatever its numbers look like. By default the weights are those of a file of weights alone,
        else those in the rig's file; where there are none, bounded biharmonic weights are solved for.
    group : str, optional
        The group or object of the mesh that is the character; all of it by default. Vertices of other groups go.
    solve : bool
        Solve for weights even where the rig's file has some.
    positions : "auto", "add" or "replace"
        Whether the positions of a `.bvh` file are added to its OFFSETs or take their place; by default the data decide.
    progress : bool
        Show progress on standard error.
    report : function of str, optional
        Receives a line on each decision that the files left open.

    Returns
    -------
    character : Character

    Raises
    ------
    FileFormatError
        If a file cannot be read as what it should be.
    ValueError
        If two files hold the same thing, one is missing, they do not fit each other, or no weights can be solved for.
    OSError
        If a file cannot be opened.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.characters.gingerbread import write_gingerbread
    >>> load_character(*write_gingerbread(tempfile.mkdtemp(), 2)).W.shape[1]
    13
    """
    bundle = load_bundle(paths, weights=weights, group=group, solve=solve, positions=positions, report=report)
    return character_of(bundle, progress=progress, report=report)


def load_animated(
    *paths: str | Path,
    clip: str | None = None,
    bone_map: BoneMap | None = None,
    weights: str | Path | None = None,
    group: str | None = None,
    solve: bool = False,
    positions: str = "auto",
    progress: bool = False,
    report: Report | None = None,
) -> tuple[Character, Motion]:
    """Load a character together with the motion in its files, each of which is read once.

    Parameters
    ----------
    *paths : path
        As for `load_character`, and files of motions. Motions are those of all files but the rig's, else its own.
    clip : str, optional
        Name of the one motion to take, or a part that only it has; all by default, one after the other.
    bone_map : mapping or path, optional
        As for `nilbs.load_motion`.
    weights, group, solve, positions, progress, report
        As for `load_character`.

    Returns
    -------
    character : Character
    motion : Motion

    Raises
    ------
    FileFormatError, ValueError, OSError
        As `load_character`, or if the files hold no motion, or none of that name.

    Examples
    --------
    >>> import nilbs, tempfile
    >>> from nilbs.characters.capsule import capsule
    >>> path, character = tempfile.mkdtemp() + "/hero.glb", capsule(resolution=8)
    >>> _ = nilbs.save_character(character, path, motion=nilbs.random_motion(character, frames=5))
    >>> character, motion = load_animated(path)
    >>> character.W.shape[1], len(motion)
    (2, 5)
    """
    bundle = load_bundle(paths, weights=weights, group=group, solve=solve, positions=positions, report=report)
    _, skeleton = rigged(bundle)
    if not bundle.clips:
        raise ValueError(f"{' and '.join(bundle.taken)}: there is no motion")
    motion = motion_of_clips(bundle.clips, skeleton, clip=clip, how=Retargeting(bone_map), report=report)
    return character_of(bundle, progress=progress, report=report), motion


def read_files(paths: Sequence[str | Path], *, positions: str = "auto") -> dict[str, Bundle]:
    """Each file as a bundle of its own, in the order given; files that need a mesh or a rig are read after those."""
    found: dict[str, Bundle] = {}
    for path in sorted(map(str, paths), key=_turn):
        if path not in found:
            mesh = next((found[other].mesh for other in _holders(found, "mesh")), None)
            rig = next((found[other].skeleton for other in _holders(found, "skeleton")), None)
            V, names = None if mesh is None else in_space(mesh.V), None if rig is None else rig.names
            bundle = read_bundle(path, V=V, names=names, rig=rig, positions=positions)
            found[path] = replace(bundle, clips=tuple(replace(clip, file=path) for clip in bundle.clips))
    return {path: found[path] for path in map(str, paths)}


def _turn(path: str) -> int:
    """When a file is read: 0 if it needs no other."""
    return 3 if needs_rig(path) else _AFTER_OTHERS.get(Path(path).suffix.lower(), 0)


def load_bundle(
    paths: Sequence[str | Path],
    *,
    weights: str | Path | None = None,
    group: str | None = None,
    solve: bool = False,
    positions: str = "auto",
    report: Report | None = None,
) -> Bundle:
    """What files hold of one character, fitted together; anything may be missing. Arguments as for `load_character`."""
    by_name = weights is not None and Path(weights).suffix.lower() == ".mhw"
    files = read_files([*paths, weights] if weights is not None and by_name else paths, positions=positions)
    if weights is not None and not by_name:
        files[str(weights)] = Bundle(influences=Influences.of_matrix(read_weights(weights)))
    return fit_together(files, group=group, solve=solve, report=report)


def load_mesh(paths: Sequence[str | Path], *, group: str | None = None, report: Report | None = None) -> Mesh:
    """The mesh in files, whatever else they hold. Arguments as for `load_character`."""
    report = report or silent
    files = read_files(paths)
    meshes = {path: Bundle(file.mesh, notes=file.notes) for path, file in files.items()}
    mesh = fit_together(meshes, group=group, report=report).mesh
    if mesh is None:
        raise FileFormatError(" and ".join(files), "there is no mesh: give its file too")
    for path, file in files.items():
        if file.skeleton is not None or file.influences is not None or _moves(file):
            report(f"{path}: only its mesh is used" if file.mesh else f"{path}: it is not used")
    return mesh


def fit_together(
    files: Mapping[str, Bundle], *, group: str | None = None, solve: bool = False, report: Report | None = None
) -> Bundle:
    """One bundle of what files hold.

    A mesh is taken from a file of a mesh alone, if there is one, else from one that holds more; so is a rig, and of
    files that hold more, that of the mesh comes first and that of a motion last. Weights, with rows on the simplex, are
    those of a file of weights alone, else those in the rig's file; with `solve` there are none. Motions are those of
    all files but the rig's, else its own.
    """
    report = report or silent
    mesh_file, rig_file, weights_file = (_chosen(files, part) for part in ("mesh", "skeleton", "influences"))
    for path, bundle in files.items():
        for note in bundle.notes:
            report(f"{path}: {note}")
    if solve and weights_file:
        raise ValueError(f"weights are solved for or read from {weights_file}, not both")
    found = files.get(mesh_file, Bundle()).mesh
    skeleton = files.get(rig_file, Bundle()).skeleton
    influences = files.get(weights_file, Bundle()).influences
    mesh = None
    if found is not None:
        with errors_of(mesh_file):
            V, E, kept = whole_or_group(found, group)
        mesh = Mesh(V, E)
        if skeleton is not None:
            if E.shape[1] != 3:
                raise FileFormatError(mesh_file, "the file holds a curve of edges: a character's mesh is of triangles")
            if not influences and not solve and _painted_on(found, rig_file, files[rig_file], report):
                weights_file, influences = rig_file, files[rig_file].influences
            with errors_of(mesh_file, rig_file, weights_file):
                skeleton = in_dimension(skeleton, V.shape[1])
                influences = influences and _fitting(influences, weights_file, found, V, kept, skeleton, report)
    if influences is not None and (mesh is None or skeleton is None):
        _check_alone(weights_file, influences, skeleton)
    moving = [path for path, bundle in files.items() if path != rig_file and _moves(bundle)]
    if not moving and files.get(rig_file, Bundle()).clips:
        moving = [rig_file]
    clips: list[Clip] = []
    for path in moving:
        if skeleton is None:
            raise ValueError(f"{path}: a motion goes together with its rig: give the rig's file too")
        clips += files[path].clips if files[path].motion is None else [own_clip(path, skeleton)]
    brought = {"mesh": [mesh_file], "rig": [rig_file], "weights": [weights_file], "motion": moving}
    taken = {path: [part for part, paths in brought.items() if path in paths] for path in files}
    fitted = Bundle(mesh, skeleton, influences, tuple(clips), taken=taken)
    if solve:
        rigged(fitted)
    return fitted


def rigged(bundle: Bundle) -> tuple[Mesh, Skeleton]:
    """The mesh and the skeleton of a bundle that must have both."""
    if bundle.mesh is None or bundle.skeleton is None:
        missing = "mesh" if bundle.mesh is None else "rig"
        raise FileFormatError(" and ".join(bundle.taken), f"there is no {missing}: give its file too")
    return bundle.mesh, bundle.skeleton


def character_of(bundle: Bundle, *, progress: bool = False, report: Report | None = None) -> Character:
    """The character of a bundle; weights that are missing are solved for."""
    mesh, skeleton = rigged(bundle)
    files = [path for path, parts in bundle.taken.items() if {"mesh", "rig", "weights"} & set(parts)]
    name = next(Path(path).stem for path, parts in bundle.taken.items() if "mesh" in parts)
    W = None
    with errors_of(*files):
        if bundle.influences is not None:
            W = bundle.influences.dense(len(mesh.V), len(skeleton.BE), files[-1])
        return assemble(mesh.V, mesh.E, skeleton, W, name=name, progress=progress, report=report)


def whole_or_group(mesh: Mesh, group: str | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V, planar if it is flat, and E of a mesh or of one of its groups, and where V stands in the whole mesh."""
    V, E, kept = (mesh.V, mesh.E, np.arange(len(mesh.V))) if group is None else select_group(mesh, group)
    return flattened(V), E, kept


@contextmanager
def errors_of(*files: str) -> Iterator[None]:
    """Name the files in errors about what they hold: "a with b and c"."""
    try:
        yield
    except FileFormatError:
        raise
    except ValueError as error:
        first, *others = dict.fromkeys(filter(None, files))
        raise ValueError(f"{first}{' with ' if others else ''}{' and '.join(others)}: {error}") from error


def _holders(files: Mapping[str, Bundle], part: str) -> list[str]:
    """The files that hold a part, from the first choice to the last; weights count where the file holds no rig."""
    holding = [path for path, bundle in files.items() if getattr(bundle, part) is not None]
    if part == "influences":
        return [path for path in holding if files[path].skeleton is None]
    return sorted(holding, key=lambda path: _rank(files, part, path))


def _rank(files: Mapping[str, Bundle], part: str, path: str) -> int:
    suffix = Path(path).suffix.lower()
    if part == "mesh":
        return 0 if suffix in MESHES else 1
    if part == "skeleton":
        with_mesh = path in _holders(files, "mesh")[:1]
        if files[path].is_motion:
            return 3 if suffix in WHOLE else 4
        return 0 if suffix in RIGS else 1 if with_mesh else 2
    return 0


def _chosen(files: Mapping[str, Bundle], part: str) -> str:
    """The file whose part is taken, "" if there is none; an error if two are as good."""
    holders = _holders(files, part)
    if len(holders) > 1 and _rank(files, part, holders[0]) == _rank(files, part, holders[1]):
        what = {"mesh": "a mesh", "skeleton": "a rig", "influences": "weights"}[part]
        raise ValueError(f"{holders[0]} and {holders[1]} both hold {what}: leave one out")
    return holders[0] if holders else ""


def _moves(bundle: Bundle) -> bool:
    return bool(bundle.clips) or bundle.motion is not None


def _fitting(
    influences: Influences, path: str, mesh: Mesh, V: np.ndarray, kept: np.ndarray, skeleton: Skeleton, report: Report
) -> Influences:
    """Weights, with rows on the simplex, of the vertices that stay: from a file of the whole mesh or of just these."""
    n, b = len(mesh.V), len(skeleton.BE)
    rows, _ = influences.shape or (n, b)
    if influences.shape is not None:
        check_sizes(influences.shape, n, b, group=len(kept))
    W = influences.dense(rows, b, path)
    W, notes = weights_on_simplex(W[kept] if rows == n else W, V, numbers=kept)
    for note in notes:
        report(note)
    return Influences.of_matrix(W)


def _painted_on(mesh: Mesh, path: str, rig: Bundle, report: Report) -> bool:
    """Whether the weights in the rig's file are of this mesh."""
    if rig.influences is None:
        return False
    own = rig.mesh is None or rig.mesh is mesh or _same_vertices(rig.mesh.V, mesh.V)
    report(
        f"{path}: its painted weights are "
        + ("used" if own else "of its own mesh, which is not the one given: they are left out")
    )
    return own


def _same_vertices(one: np.ndarray, other: np.ndarray) -> bool:
    one, other = in_space(one), in_space(other)
    return one.shape == other.shape and bool(np.abs(one - other).max() <= _SAME_PLACE * np.ptp(other, axis=0).max())


def _check_alone(path: str, influences: Influences, skeleton: Skeleton | None) -> None:
    """Refuse weights of another rig; those of a mesh that is not there must be a whole matrix."""
    if influences.shape is None:
        raise FileFormatError(path, "its weights are of bones by name: give the mesh and the rig too")
    if skeleton is not None and influences.shape[1] != len(skeleton.BE):
        raise FileFormatError(path, f"weights of {influences.shape[1]} bones, but the rig has {len(skeleton.BE)}")
