"""Characters and their motions to files: mesh, rig, weights and motion in whatever format each file's suffix names."""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copyfileobj
from typing import TYPE_CHECKING

import numpy as np

from nilbs.geometry.plane import in_space, transforms_in_space
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import listed
from nilbs.io.atomic import check_writable, replacing
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.errors import check_suffix
from nilbs.io.registry import MESHES, MOTIONS, WRITABLE

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.characters.motion import Motion


@dataclass(frozen=True)
class Written:
    """A file that was written.

    Attributes
    ----------
    path : path
    holds : tuple of str
        Of "mesh", "rig", "weights" and "motion".
    notes : tuple of str
        A sentence on everything that the format could not hold.
    """

    path: str | Path
    holds: tuple[str, ...]
    notes: tuple[str, ...]


def save_character(character: "Character", *paths: str | Path, motion: "Motion | None" = None) -> tuple[Written, ...]:
    """Write a character, and a motion of it, to one file or several; all of them or none.

    Parameters
    ----------
    character : Character
        One in the plane is written as the triangles of its volume mesh, with z = 0.
    *paths : path
        As `write_files`.
    motion : Motion, optional

    Returns
    -------
    written : tuple of Written

    Raises
    ------
    ValueError, OSError
        As `write_files`.

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
    flat = c.d == 2
    return write_files(
        paths,
        mesh=Mesh(c.V_volume, c.T) if flat else Mesh(c.V, c.F),
        skeleton=c.skeleton,
        W=c.W_volume if flat else c.W,
        clips=() if motion is None else (clip_of(motion, c.skeleton),),
    )


def clip_of(motion: "Motion", skeleton: Skeleton) -> Clip:
    """A motion of a character as files hold it: in space, with a name.

    Parameters
    ----------
    motion : Motion
    skeleton : Skeleton
        The character's.

    Returns
    -------
    clip : Clip
    """
    source = Path(motion.source)
    name = source.stem if source.suffix.lower() in MOTIONS else motion.source  # it may end in a number with a point
    return Clip(name, skeleton.in_space(), motion.times, transforms_in_space(motion.B))


def write_files(
    paths: Sequence[str | Path],
    *,
    mesh: Mesh | None = None,
    skeleton: Skeleton | None = None,
    W: np.ndarray | None = None,
    clips: tuple[Clip, ...] = (),
) -> tuple[Written, ...]:
    """Write what each file's suffix can hold of a character; all files are replaced, or none.

    Parameters
    ----------
    paths : sequence of path
        `.obj`, `.ply`, `.off`, `.stl`, `.3mf`: the mesh. `.glb`, `.gltf`: everything. `.txt`: rig and weights as
        RigNet writes them. `.tgf`: the rig. `.npz`: weights. `.bvh`: rig and motion. `.dmat`: the motion or the
        weights, whichever there is; where there are both, the end of the name decides: `-weights.dmat`, `-motion.dmat`.
    mesh : Mesh, optional
    skeleton : Skeleton, optional
    W : (n, b) float array, optional
    clips : tuple of Clip
        Motions of the skeleton.

    Returns
    -------
    written : tuple of Written
        In the order of the paths.

    Raises
    ------
    FileFormatError
        If a suffix is unknown.
    ValueError
        If a file's format needs what is not there, holds one motion and there are several, or a path is named twice.
    OSError
        If a file cannot be written.
    """
    check_outputs(paths)
    character = _Character(
        None if mesh is None else replace(mesh, V=in_space(mesh.V)),
        None if skeleton is None else skeleton.in_space(),
        W,
        tuple(replace(clip, skeleton=clip.skeleton.in_space(), B=transforms_in_space(clip.B)) for clip in clips),
    )
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        written = []
        for k, path in enumerate(paths):
            # Under its own name, which some formats write inside.
            aside = Path(folder, str(k), Path(path).name)
            aside.parent.mkdir()
            try:
                holds, notes = _write(aside, character)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from error
            written.append(Written(path, holds, notes))
        # Each is complete beside its place before the first one takes it.
        files = [stack.enter_context(replacing(path)) for path in paths]
        for k, (path, file) in enumerate(zip(paths, files, strict=True)):
            with open(Path(folder, str(k), Path(path).name), "rb") as source:
                copyfileobj(source, file)
    return tuple(written)


def check_outputs(paths: Sequence[str | Path], *, inputs: Sequence[str | Path] = ()) -> None:
    """Check that `write_files` can write these files, before the work that they are to hold.

    Parameters
    ----------
    paths, inputs : sequences of path
        What is to be written, and what it is made from and must not be replaced.

    Raises
    ------
    FileFormatError
        If a suffix is unknown.
    ValueError
        If a path is named twice.
    OSError
        If a file cannot be written.
    """
    for path in paths:
        check_suffix(path, *WRITABLE)
        check_writable(path, inputs=inputs)
        if sum(Path(path).resolve() == Path(other).resolve() for other in paths) > 1:
            raise ValueError(f"{path}: the same file is named twice")


@dataclass(frozen=True)
class _Character:
    """What there is to write, in space."""

    mesh: Mesh | None
    skeleton: Skeleton | None
    W: np.ndarray | None
    clips: tuple[Clip, ...]

    def rig(self) -> Skeleton:
        if self.skeleton is None:
            raise ValueError("there is no rig to write")
        return self.skeleton

    def motion(self) -> Clip:
        if not self.clips:
            raise ValueError("there is no motion to write")
        if len(self.clips) > 1:
            names = listed([clip.name for clip in self.clips])
            raise ValueError(f"it holds one motion, and there are {len(self.clips)}: choose one of {names}")
        return self.clips[0]

    def weights(self) -> np.ndarray:
        if self.W is None:
            raise ValueError("there are no weights to write: give their file, or solve for them (--solve)")
        return self.W


def _write(path: Path, c: _Character) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write one file; return what it holds, and notes on what it cannot hold."""
    suffix = path.suffix.lower()
    if suffix in MESHES:
        from nilbs.io.mesh import write_mesh

        if c.mesh is None:
            raise ValueError("there is no mesh to write")
        write_mesh(path, c.mesh.V, c.mesh.E)
        lost = "an .stl file holds triangles alone: number and order of the vertices, which weights need, are lost"
        return ("mesh",), (lost,) if suffix == ".stl" else ()
    if suffix in (".glb", ".gltf"):
        return _write_gltf(path, c)
    if suffix == ".txt":
        from nilbs.io.rignet import write_rignet

        notes = write_rignet(path, c.rig(), c.W)
        return ("rig",) if c.W is None else ("rig", "weights"), notes
    if suffix == ".tgf":
        from nilbs.io.tgf import write_tgf_skeleton

        return ("rig",), write_tgf_skeleton(path, c.rig())
    if suffix == ".bvh":
        from nilbs.io.bvh import write_bvh

        if c.clips:
            return ("rig", "motion"), write_bvh(path, c.motion())
        rest = np.tile(np.eye(4), (1, len(c.rig().BE), 1, 1))
        return ("rig",), write_bvh(path, Clip("rest", c.rig(), np.zeros(1), rest))
    if suffix == ".dmat" and _holds_motion(path, c):
        from nilbs.io.motion import write_transforms

        write_transforms(path, c.motion().B)
        return ("motion",), ("a .dmat file holds no times",)
    from nilbs.io.weights import write_weights

    write_weights(path, c.weights())
    return ("weights",), ()


def _write_gltf(path: Path, c: _Character) -> tuple[tuple[str, ...], tuple[str, ...]]:
    from nilbs.io.gltf_writer import write_gltf

    if c.mesh is None and c.skeleton is None:
        raise ValueError("there is no mesh and no rig to write")
    influences = None
    if c.mesh is not None and c.skeleton is not None:
        vertex, bone = np.nonzero(c.weights())
        influences = Influences(vertex, bone, c.weights()[vertex, bone])
    notes = write_gltf(path, Bundle(c.mesh, c.skeleton, influences, c.clips))
    there = {"mesh": c.mesh, "rig": c.skeleton, "weights": influences, "motion": c.clips or None}
    return tuple(name for name, value in there.items() if value is not None), notes


def _holds_motion(path: Path, c: _Character) -> bool:
    """Whether a `.dmat` file is for the motion and not for the weights."""
    stem = path.stem.lower()
    if stem.endswith("weights"):
        return False
    if stem.endswith(("motion", "anim")):
        return True
    if c.clips and c.W is not None:
        raise ValueError(
            "a .dmat file holds the weights or the motion: call it ...-weights.dmat or ...-motion.dmat, to say which"
        )
    return bool(c.clips)
