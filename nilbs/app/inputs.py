"""Files of one character, given in any order: which of them brings the mesh, the rig, the weights and the motions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nilbs.characters.loading import fit_together, whole_or_group
from nilbs.characters.report import Report
from nilbs.characters.saving import clip_of
from nilbs.geometry.plane import in_space
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import listed
from nilbs.io.bundle import Bundle, Clip, Mesh
from nilbs.io.errors import FileFormatError
from nilbs.io.registry import MESHES, RIGS, kind_of, read_bundle

if TYPE_CHECKING:
    from nilbs.characters.motion import Motion

ReadMotion = Callable[[str, Skeleton], "Motion"]


@dataclass(frozen=True)
class Inputs:
    """What files hold of one character, fitted together; anything may be missing.

    Attributes
    ----------
    taken : dict of str to list of str
        What each file brought: of "mesh", "rig", "weights" and "motion".
    mesh, skeleton, W, clips
        As `nilbs.characters.saving.write_files` takes them.
    """

    taken: dict[str, list[str]]
    mesh: Mesh | None
    skeleton: Skeleton | None
    W: np.ndarray | None
    clips: tuple[Clip, ...]

    def sizes(self) -> dict[str, str]:
        """How much there is of everything that there is, in words."""
        told = {}
        if self.mesh is not None:
            told["mesh"] = f"{len(self.mesh.V)} vertices, {len(self.mesh.E)} faces"
        if self.skeleton is not None:
            told["rig"] = f"{len(self.skeleton.BE)} bones"
        if self.W is not None:
            told["weights"] = f"{self.W.shape[0]} vertices, {self.W.shape[1]} bones"
        if self.clips:
            told["motion"] = "; ".join(f"{clip.name}: {len(clip.B)} frames" for clip in self.clips)
        return told


def gather(
    paths: Sequence[str],
    *,
    load_motion: ReadMotion,
    clip: str | None = None,
    group: str | None = None,
    solve: bool = False,
    report: Report,
) -> Inputs:
    """Read files and sort them by what they hold.

    Parameters
    ----------
    paths : sequence of str
        A mesh is taken from a file of a mesh alone, if there is one, else from one that holds more; so is a rig, and
        of files that hold more, that of the mesh comes first and a `.bvh` last. Motions are those of all other files,
        or else the rig's file's own.
    load_motion : function of str and Skeleton
        Reads a motion for a skeleton that is not the motion's own.
    clip : str, optional
        Which of the motions of the rig's own file; all by default.
    group, solve, report
        As for `nilbs.load_character`.

    Returns
    -------
    inputs : Inputs

    Raises
    ------
    FileFormatError, ValueError, OSError
        If a file cannot be read, two files bring the same thing, or files do not fit each other.
    """
    kinds = {path: kind_of(path) for path in paths}
    parts = {
        path: read_bundle(path)
        for path, kind in kinds.items()
        if kind == "parts" and not path.lower().endswith(".mhskel")
    }
    mesh_path = _one([path for path, held in parts.items() if held.mesh is not None], "a mesh", _mesh_rank)
    V = None if mesh_path is None else in_space(_mesh_of(parts[mesh_path]).V)
    parts |= {path: read_bundle(path, V=V) for path, kind in kinds.items() if kind == "parts" and path not in parts}
    rigs = [path for path, held in parts.items() if held.skeleton is not None]
    rig_path = _one(rigs, "a rig", lambda path: _rig_rank(path, path == mesh_path))
    weights_path = _one([path for path, kind in kinds.items() if kind == "weights"], "weights", lambda path: 0)
    moving = [path for path in paths if path != rig_path and (kinds[path] == "motion" or _moves(parts.get(path)))]
    taken: dict[str, list[str]] = {path: [] for path in paths}

    mesh, skeleton, W = None, None, None
    clips: tuple[Clip, ...] = ()
    if mesh_path is not None and rig_path is not None:
        rigged = fit_together(
            mesh_path,
            parts[mesh_path],
            rig_path,
            parts[rig_path],
            weights_path,
            group=group,
            solve=solve,
            report=report,
        )
        W = rigged.assemble(progress=True, report=report).W if solve else rigged.W
        mesh, skeleton, clips = Mesh(rigged.V, rigged.E), rigged.skeleton, rigged.clips
        if W is not None and not solve:
            taken[weights_path or rig_path].append("weights")
    elif solve:
        raise ValueError("to solve for weights takes a mesh and a rig")
    elif mesh_path is not None:
        try:
            mesh = Mesh(*whole_or_group(_mesh_of(parts[mesh_path]), group)[:2])
        except ValueError as error:
            raise ValueError(f"{mesh_path}: {error}") from error
        _tell_notes(mesh_path, parts[mesh_path], report)
    elif rig_path is not None:
        skeleton, clips = parts[rig_path].skeleton, parts[rig_path].clips
        _tell_notes(rig_path, parts[rig_path], report)
    if weights_path is not None and W is None:
        W = _weights_alone(weights_path, skeleton)
        taken[weights_path].append("weights")
    if mesh_path is not None:
        taken[mesh_path].insert(0, "mesh")
    if rig_path is not None:
        taken[rig_path].insert(1 if rig_path == mesh_path else 0, "rig")
    if moving:
        clips = tuple(_clip_of_file(path, skeleton, load_motion) for path in moving)
        for path in moving:
            taken[path].append("motion")
    elif clips and rig_path is not None:
        clips = _named(rig_path, clips, clip)
        taken[rig_path].append("motion")
    return Inputs(taken, mesh, skeleton, W, clips)


def _one(paths: list[str], what: str, rank: Callable[[str], int]) -> str | None:
    """The path of the lowest rank, which must be the only one of it."""
    best = min(map(rank, paths), default=0)
    first = [path for path in paths if rank(path) == best]
    if len(first) > 1:
        raise ValueError(f"{first[0]} and {first[1]} both hold {what}: leave one out")
    return first[0] if first else None


def _mesh_rank(path: str) -> int:
    return 0 if Path(path).suffix.lower() in MESHES else 1


def _rig_rank(path: str, with_mesh: bool) -> int:
    suffix = Path(path).suffix.lower()
    return 0 if suffix in RIGS else 3 if suffix == ".bvh" else 1 if with_mesh else 2


def _mesh_of(parts: Bundle) -> Mesh:
    assert parts.mesh is not None
    return parts.mesh


def _moves(parts: Bundle | None) -> bool:
    return parts is not None and bool(parts.clips)


def _tell_notes(path: str, parts: Bundle, report: Report) -> None:
    for note in parts.notes:
        report(f"{path}: {note}")


def _weights_alone(path: str, skeleton: Skeleton | None) -> np.ndarray:
    """Weights of a mesh that is not there."""
    from nilbs.io.weights import read_weights

    if Path(path).suffix.lower() == ".mhw":
        raise FileFormatError(path, "its weights are of bones by name: give the mesh and the rig too")
    W = read_weights(path)
    if skeleton is not None and W.shape[1] != len(skeleton.BE):
        raise FileFormatError(path, f"weights of {W.shape[1]} bones, but the rig has {len(skeleton.BE)}")
    return W


def _clip_of_file(path: str, skeleton: Skeleton | None, load_motion: ReadMotion) -> Clip:
    if skeleton is None:
        raise ValueError(f"{path}: a motion is written together with its rig: give the rig's file too")
    return clip_of(load_motion(path, skeleton), skeleton)


def _named(path: str, clips: tuple[Clip, ...], name: str | None) -> tuple[Clip, ...]:
    chosen = tuple(clip for clip in clips if name in (None, clip.name))
    if not chosen:
        known = listed([clip.name for clip in clips])
        raise FileFormatError(path, f"the file holds no motion {name!r}, but {known}")
    return chosen
