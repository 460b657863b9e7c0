"""Characters and their motions to files: mesh, rig, weights and motion in the format that each file's suffix names."""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from shutil import copyfileobj
from typing import NamedTuple, TypeVar

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.clips import FPS
from nilbs.characters.motion import Motion, clips_of
from nilbs.geometry.plane import in_space, transforms_in_space
from nilbs.geometry.validation import listed
from nilbs.io.atomic import check_writable, replacing
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.errors import check_suffix
from nilbs.io.registry import MESHES, WRITABLE

_Part = TypeVar("_Part")


class Written(NamedTuple):
    """A file that was written, what it holds ("mesh", "rig", "weights", "motion"), and notes on what it could not."""

    path: str | Path
    holds: tuple[str, ...]
    notes: tuple[str, ...]


def save_character(character: Character, *paths: str | Path, motion: Motion | None = None) -> tuple[Written, ...]:
    """Write a character, and a motion of it, to one file or several; all of them or none.

    Parameters
    ----------
    character : Character
        One in the plane is written as the triangles of its volume mesh, with z = 0.
    *paths : path
        `.obj`, `.ply`, `.off`, `.stl`, `.3mf`: the mesh. `.glb`, `.gltf`: everything. `.txt`: rig and weights as
        RigNet writes them. `.tgf`: the rig. `.npz`: weights. `.bvh`: rig and motion. `.dmat`: the motion or the
        weights, whichever there is; where there are both, the end of the name decides: `-weights.dmat`, `-motion.dmat`.
    motion : Motion, optional

    Returns
    -------
    written : tuple of Written
        For each path, what the file holds and a sentence on everything that its format could not hold.

    Raises
    ------
    FileFormatError
        If a suffix is unknown.
    ValueError
        If a file's format needs what is not there, holds one motion and there are several, or a path is named twice.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.geometry.skeleton import Skeleton
    >>> from nilbs.characters.character import assemble
    >>> square = [[0, 0], [2, 0], [2, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> character = assemble(*square, Skeleton([[0.5, 0.5], [1.5, 0.5]], [[0, 1]], [-1], ("bar",)))
    >>> folder = tempfile.mkdtemp()
    >>> [file.holds for file in save_character(character, f"{folder}/bar.obj", f"{folder}/bar_rig.txt")]
    [('mesh',), ('rig', 'weights')]
    """
    c = character
    V, E, W = (c.V_volume, c.T, c.W_volume) if c.d == 2 else (c.V, c.F, c.W)
    clips = () if motion is None else clips_of(motion, c.skeleton)
    return write_bundle(Bundle(Mesh(V, E), c.skeleton, Influences.of_matrix(W), clips), paths)


def write_bundle(bundle: Bundle, paths: Sequence[str | Path]) -> tuple[Written, ...]:
    """Write what each file's suffix can hold of a bundle; all files are replaced, or none. As `save_character`."""
    check_outputs(paths)
    mesh, skeleton = bundle.mesh, bundle.skeleton
    bundle = replace(
        bundle,
        mesh=mesh and replace(mesh, V=in_space(mesh.V)),
        skeleton=skeleton and skeleton.in_space(),
        clips=tuple(
            replace(clip, skeleton=clip.skeleton.in_space(), B=transforms_in_space(clip.B)) for clip in bundle.clips
        ),
    )
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        written = []
        for k, path in enumerate(paths):
            # Under its own name, which some formats write inside.
            aside = Path(folder, str(k), Path(path).name)
            aside.parent.mkdir()
            try:
                written.append(Written(path, *_write(aside, bundle)))
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from error
        # Each is complete beside its place before the first one takes it.
        files = [stack.enter_context(replacing(path)) for path in paths]
        for k, (path, file) in enumerate(zip(paths, files, strict=True)):
            with open(Path(folder, str(k), Path(path).name), "rb") as source:
                copyfileobj(source, file)
    return tuple(written)


def check_outputs(paths: Sequence[str | Path], *, inputs: Sequence[str | Path] = ()) -> None:
    """Check that `write_bundle` can write these files and replaces no input, before the work that they are to hold."""
    for path in paths:
        check_suffix(path, *WRITABLE)
        check_writable(path, inputs=inputs)
        if sum(Path(path).resolve() == Path(other).resolve() for other in paths) > 1:
            raise ValueError(f"{path}: the same file is named twice")


def _write(path: Path, b: Bundle) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write one file; return what it holds, and notes on what it cannot hold."""
    suffix = path.suffix.lower()
    if suffix in MESHES:
        from nilbs.io.mesh import write_mesh

        mesh = _needed(b.mesh, "mesh")
        write_mesh(path, mesh.V, mesh.E)
        lost = "an .stl file holds triangles alone: number and order of the vertices, which weights need, are lost"
        return ("mesh",), (lost,) if suffix == ".stl" else ()
    if suffix in (".glb", ".gltf"):
        from nilbs.io.gltf_writer import write_gltf

        if b.mesh is None and b.skeleton is None:
            raise ValueError("there is no mesh and no rig to write")
        skinned = b.mesh is not None and b.skeleton is not None
        b = replace(b, influences=_weights(b) if skinned else None)
        there = {"mesh": b.mesh, "rig": b.skeleton, "weights": b.influences, "motion": b.clips or None}
        return tuple(name for name, value in there.items() if value is not None), write_gltf(path, b)
    if suffix == ".txt":
        from nilbs.io.rignet import write_rignet

        W = None if b.influences is None else _matrix(b)
        return ("rig",) if W is None else ("rig", "weights"), write_rignet(path, _needed(b.skeleton, "rig"), W)
    if suffix == ".tgf":
        from nilbs.io.tgf import write_tgf_skeleton

        return ("rig",), write_tgf_skeleton(path, _needed(b.skeleton, "rig"))
    if suffix == ".bvh":
        from nilbs.io.bvh import write_bvh

        if b.clips:
            motion, joined = _motion(b)
            try:
                return ("rig", "motion"), (*joined, *write_bvh(path, motion))
            except ValueError as error:
                choose = f"; or choose one of {listed([clip.name for clip in b.clips])}" if joined else ""
                raise ValueError(f"{error}{choose}") from None
        skeleton = _needed(b.skeleton, "rig")
        rest = np.tile(np.eye(4), (1, len(skeleton.BE), 1, 1))
        return ("rig",), write_bvh(path, Clip("rest", skeleton, np.zeros(1), rest))
    if suffix == ".dmat" and _holds_motion(path, b):
        from nilbs.io.motion import write_transforms

        motion, joined = _motion(b)
        write_transforms(path, motion.B)
        return ("motion",), (*joined, "a .dmat file holds no times")
    from nilbs.io.weights import write_weights

    write_weights(path, _matrix(b))
    return ("weights",), ()


def _needed(part: _Part | None, what: str) -> _Part:
    if part is None:
        raise ValueError(f"there is no {what} to write")
    return part


def _weights(b: Bundle) -> Influences:
    if b.influences is None:
        raise ValueError("there are no weights to write: give their file, or solve for them (--solve)")
    return b.influences


def _matrix(b: Bundle) -> np.ndarray:
    influences = _weights(b)
    assert influences.shape is not None
    return influences.dense(*influences.shape, "the weights")


def _motion(b: Bundle) -> tuple[Clip, tuple[str, ...]]:
    """The motion of a file that holds one: of several, all, one after the other; and a note if so."""
    first = _needed(next(iter(b.clips), None), "motion")
    if len(b.clips) == 1:
        return first, ()
    times, start = [], 0.0
    for clip in b.clips:
        if clip.skeleton.names != first.skeleton.names:
            raise ValueError(f"it holds one skeleton, and {first.name!r} and {clip.name!r} are of different ones")
        times.append(clip.times - clip.times[:1] + start)
        step = np.ptp(clip.times) / (len(clip.times) - 1) if len(clip.times) > 1 else 1 / FPS
        start = times[-1][-1] + step if len(clip.times) else start
    names = listed([clip.name for clip in b.clips])
    note = f"it holds one motion: all {len(b.clips)} were written, one after the other ({names}); --clip chooses one"
    B = np.concatenate([clip.B for clip in b.clips])
    return Clip(first.name, first.skeleton, np.concatenate(times), B), (note,)


def _holds_motion(path: Path, b: Bundle) -> bool:
    """Whether a `.dmat` file is for the motion and not for the weights."""
    stem = path.stem.lower()
    if stem.endswith("weights"):
        return False
    if stem.endswith(("motion", "anim")):
        return True
    if b.clips and b.influences is not None:
        raise ValueError("a .dmat file holds the weights or the motion: call it ...-weights.dmat or ...-motion.dmat")
    return bool(b.clips)
