"""Motions from files that hold a skeleton of their own, on the skeleton of a character."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nilbs.characters.report import Report
from nilbs.geometry.plane import transforms_in_plane
from nilbs.geometry.retargeting import guess_bone_map, retarget
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import listed
from nilbs.io.bone_map import read_bone_map
from nilbs.io.bundle import Clip
from nilbs.io.errors import FileFormatError

BoneMap = Mapping[str, str | None] | str | os.PathLike

SAME_PLACE = 1e-4  # of the skeleton's size: joints that are nearer are the same


def chosen_clip(path: Path, name: str | None, report: Report) -> Clip:
    """Read a motion from a file that holds its skeleton too.

    Parameters
    ----------
    path : path
    name : str, optional
        Of the motion; the first by default, and the others are reported.
    report : function of str

    Returns
    -------
    clip : Clip

    Raises
    ------
    FileFormatError
        If the file holds no motion, none of that name, or one without frames.
    OSError
        If it cannot be read.
    """
    from nilbs.io.registry import read_bundle

    parts = read_bundle(path)
    for note in parts.notes:
        report(f"{path.name}: {note}")
    names = [clip.name for clip in parts.clips]
    if not names:
        raise FileFormatError(path, "the file holds no motion")
    if name is not None and name not in names:
        raise FileFormatError(path, f"there is no motion {name!r}; the file holds {_quoted(names)}")
    chosen = parts.clips[0 if name is None else names.index(name)]
    if name is None and len(names) > 1:
        report(f"{path.name}: took the motion {chosen.name!r}; the file also holds {_quoted(names[1:])}")
    if not len(chosen.B):
        raise FileFormatError(path, f"the motion {chosen.name!r} has no frame")
    return chosen


def clip_transforms(path: Path, clip: Clip, target: Skeleton, bone_map: BoneMap | None, report: Report) -> np.ndarray:
    """Transforms of bones that move as a clip does.

    Parameters
    ----------
    path : path
        Where the clip came from, for errors and reports.
    clip : Clip
    target : Skeleton
        With b bones.
    bone_map : mapping or path, optional
        Which bone of the target follows which of the clip. By default the clip's own transforms, where it has the
        target's names and joints; else guessed.
    report : function of str

    Returns
    -------
    B : (t, b, d+1, d+1) float array

    Raises
    ------
    FileFormatError
        If the clip leaves the plane of a flat target, or the map cannot be read.
    ValueError
        If no bone of the target follows one of the clip, or the map names bones that do not exist.
    """
    source, B = clip.skeleton, clip.B
    if target.d == 2:
        try:
            source = source.in_plane()
        except ValueError as error:
            raise FileFormatError(path, str(error)) from None
        B = in_plane(path, B)
    own = _own_bones(source, target) if bone_map is None else None
    if own is not None:
        return B[:, own]
    if isinstance(bone_map, str | os.PathLike):
        bone_map = read_bone_map(bone_map)
    try:
        guessed = guess_bone_map(source, target) if bone_map is None else bone_map
        moved = retarget(source, B, target, guessed)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    for line in bone_map_lines(source, target, guessed):
        report(f"{path.name}: {line}")
    report(f"{path.name}: {_axes(moved.axes)}; lengths are multiplied by {moved.scale:.4g}")
    if moved.from_first.any():
        axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(moved.from_first))
        report(f"{path.name}: starts far from its rest pose along {axes}; there it starts where the character stands")
    return moved.B


def bone_map_lines(source: Skeleton, target: Skeleton, bone_map: Mapping[str, str | None]) -> list[str]:
    """Say in lines which bones follow which: a table by bones of the motion, and what is left over.

    Parameters
    ----------
    source : Skeleton
        Of the motion.
    target : Skeleton
        Of the character.
    bone_map : mapping of str to str or None
        Target to source.

    Returns
    -------
    lines : list of str

    Examples
    --------
    >>> arm = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))
    >>> hand = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("arm", "hand"))
    >>> for line in bone_map_lines(arm, hand, {"arm": "upper"}):
    ...     print(line)
    1 of 2 bones follow a bone of the motion, 0 of them one of the same name
    upper -> arm
    keep their rest pose to the bone above: hand
    not used of the motion: lower
    """
    followers: dict[str, list[str]] = {}
    for name in target.names:
        led = bone_map.get(name)
        if led is not None:
            followers.setdefault(led, []).append(name)
    follow, same = sum(map(len, followers.values())), sum(led in names for led, names in followers.items())
    lines = [
        f"{follow} of {len(target.names)} bones follow a bone of the motion, {same} of them one of the same name",
        *(f"{led} -> {', '.join(followers[led])}" for led in source.names if followers.get(led, [led]) != [led]),
    ]
    alone = [name for name in target.names if bone_map.get(name) is None]
    unused = [name for name in source.names if name not in followers]
    if alone:
        lines.append(f"keep their rest pose to the bone above: {', '.join(alone)}")
    if unused:
        lines.append(f"not used of the motion: {', '.join(unused)}")
    return lines


def _own_bones(source: Skeleton, target: Skeleton) -> np.ndarray | None:
    """The source's bones in the target's order, where they are the same bones at the same places."""
    numbers = {name: bone for bone, name in enumerate(source.names)}
    if not set(target.names) <= set(numbers):
        return None
    own = np.array([numbers[name] for name in target.names])
    start, size = target.C[target.BE[:, 0]], np.linalg.norm(np.ptp(target.C, axis=0))
    apart = np.linalg.norm(source.C[source.BE[own, 0]] - start, axis=1)
    return own if (apart <= SAME_PLACE * size).all() else None


def in_plane(path: Path, B: np.ndarray) -> np.ndarray:
    """`transforms_in_plane` of a file's motion; FileFormatError if one leaves the plane."""
    try:
        return transforms_in_plane(B)
    except ValueError as error:
        raise FileFormatError(path, str(error)) from None


def _axes(R: np.ndarray) -> str:
    """A rotation of quarter turns in words."""
    if np.array_equal(R, np.eye(len(R))):
        return "axes agree"
    row = np.abs(R).argmax(axis=0)
    turns = [f"its {'xyz'[a]} is {'-' if R[row[a], a] < 0 else ''}{'xyz'[row[a]]} here" for a in range(len(R))]
    return "axes differ: " + ", ".join(turns)


def _quoted(names: list[str]) -> str:
    return listed([repr(name) for name in names])
