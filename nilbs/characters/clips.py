"""Clips of files as motions of the skeleton of a character."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from nilbs.characters.report import Detail, Report
from nilbs.geometry.curves import Curves
from nilbs.geometry.kinematics import bone_order, forward_kinematics
from nilbs.geometry.nearest_names import alike_names, nearest_name
from nilbs.geometry.plane import transforms_in_plane
from nilbs.geometry.reference_pose import ReferencePose, reference_pose
from nilbs.geometry.retargeting import followed_bones, guess_bone_map, retarget
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays, listed
from nilbs.io.bone_map import read_bone_map
from nilbs.io.bundle import Clip
from nilbs.io.errors import FileFormatError
from nilbs.io.motion import LocalMotion, read_motion_json, read_transforms

BoneMap = Mapping[str, str | None] | str | os.PathLike
Show = Callable[[Skeleton, Skeleton, Mapping[str, str | None]], object]


@dataclass(frozen=True)
class Retargeting:
    """How the motion of one skeleton is put on another; what is None is found.

    Attributes
    ----------
    bone_map : mapping or path, optional
        For bones of the character, by name, the bones of the file that they follow, or a JSON file of these, see
        `nilbs.io.bone_map.read_bone_map`.
    rest_frame, up, forward
        As for `nilbs.geometry.reference_pose.reference_pose`; a map's file may hold them too.
    show : function, optional
        Receives the skeleton of the motion in the pose and the axes that correspond to the character's rest pose, that
        of the character, and the bone map.
    """

    bone_map: BoneMap | None = None
    rest_frame: int | None = None
    up: str | None = None
    forward: str | None = None
    show: Show | None = field(default=None, compare=False)

    def read(self) -> "Retargeting":
        """The same with the bones, if there are any, and the options of the map's file."""
        if not isinstance(self.bone_map, str | os.PathLike):
            return self
        bones, options = read_bone_map(self.bone_map)
        given = {name[2:].replace("-", "_"): value for name, value in options.items()}
        given |= {name: value for name, value in vars(self).items() if value is not None}
        return Retargeting(**{**given, "bone_map": bones or None})


FPS = 24  # frames a second of a motion without times
_SAME_PLACE = 1e-4  # of the skeleton's size: joints that are nearer are the same


@dataclass(frozen=True)
class FollowedCurves:
    """Poses over time of a skeleton that follows the curves of another one.

    Attributes
    ----------
    source, target : Skeleton
        Whose motion the curves are, and who follows it.
    bone_map : mapping of str to str or None
        As for `nilbs.geometry.retargeting.retarget`.
    start : (b', d+1, d+1) float array
        The source's pose in the first frame of its clip.
    reference : ReferencePose
        The source's pose that corresponds to the target's rest pose.
    curves : Curves
        Of the source's bones.
    """

    source: Skeleton
    target: Skeleton
    bone_map: Mapping[str, str | None]
    start: np.ndarray
    reference: ReferencePose
    curves: Curves

    def __post_init__(self) -> None:
        d, b = self.source.d, len(self.source.BE)
        (start,) = arrays(start=(self.start, f"{b} {d + 1} {d + 1}"))
        object.__setattr__(self, "start", start)
        followed_bones(self.source, self.target, self.bone_map)

    @property
    def key_times(self) -> np.ndarray:
        """Those of the curves."""
        return self.curves.key_times

    def at(self, times: np.ndarray) -> np.ndarray:
        """Transforms (t, b, d+1, d+1) of the target's bones at times (t,): the source's poses there, retargeted."""
        B = np.concatenate([self.start[None], self.curves.at(times)])
        return retarget(self.source, B, self.target, self.bone_map, reference=self.reference).B[1:]

    def shifted(self, start: float, to: float) -> "FollowedCurves":
        """The same, with what was at the time `start` at the time `to`."""
        return replace(self, curves=self.curves.shifted(start, to))


def own_clip(path: str | os.PathLike, skeleton: Skeleton) -> Clip:
    """The motion of a skeleton in a `.dmat` or `.json` file, which holds no skeleton of its own."""
    path, times = Path(path), None
    if path.suffix.lower() == ".json":
        motion = read_motion_json(path, skeleton.names, skeleton.d)
        with np.errstate(over="ignore", invalid="ignore"):
            B, times = _posed(skeleton, motion), motion.times
        _check_finite(path, B, skeleton)
    else:
        B = read_transforms(path)
        if B.shape[1] != len(skeleton.BE):
            raise FileFormatError(path, f"moves {B.shape[1]} bones, but the rig has {len(skeleton.BE)}")
        B = _in_plane(path, B) if skeleton.d == 2 else B
    return Clip(path.stem, skeleton, np.arange(len(B)) / FPS if times is None else times, B, str(path))


def _posed(skeleton: Skeleton, motion: LocalMotion) -> np.ndarray:
    """Transforms of local motions; bones whose transform is given take it, and those below hang from it."""
    c = skeleton
    parts = {"translation": motion.translation, "scale": motion.scale}
    if motion.given is None:
        return forward_kinematics(c.C, c.BE, c.P, motion.theta, root_translation=motion.root_translation, **parts)
    moved = np.where((c.P < 0)[:, None], motion.root_translation[:, None], 0.0)
    parts["translation"] = moved if motion.translation is None else moved + motion.translation
    B = forward_kinematics(c.C, c.BE, np.full(len(c.P), -1), motion.theta, **parts)  # each relative to its parent
    for bone in bone_order(c.P):
        if c.P[bone] >= 0:
            B[:, bone] = B[:, c.P[bone]] @ B[:, bone]
        given = np.isfinite(motion.given[:, bone]).all(axis=(-1, -2))
        B[given, bone] = motion.given[given, bone]
    return B


def _check_finite(path: Path, B: np.ndarray, skeleton: Skeleton) -> None:
    """Refuse transforms that overflowed."""
    bad = np.argwhere(~np.isfinite(B).all(axis=(-1, -2)))
    if len(bad):
        raise FileFormatError(
            path, f"frame {bad[0][0]} moves bone {skeleton.names[bad[0][1]]!r} farther than numbers go"
        )


def clips_named(clips: Sequence[Clip], name: str | None) -> tuple[Clip, ...]:
    """The clips of a name, or of the only name with this part in any case, or all; an error if none has a frame."""
    files = " and ".join(dict.fromkeys(clip.file for clip in clips))
    names = list(dict.fromkeys(clip.name for clip in clips))
    meant = names if name is None else _names_meant(name, names)
    if name is not None and len(meant) != 1:
        if meant:
            raise FileFormatError(files, f"{len(meant)} motions have {name!r} in their names: {_quoted(meant)}")
        ranked = list(dict.fromkeys([*alike_names(name, names), *names]))
        raise FileFormatError(files, f"there is no motion {name!r}, but {_quoted(ranked)}{nearest_name(name, names)}")
    named = [clip for clip in clips if clip.name in meant]
    chosen = tuple(clip for clip in named if len(clip.B))
    if not chosen:
        raise FileFormatError(files, f"the motion {named[0].name!r} has no frame")
    return chosen


def _names_meant(name: str, names: Sequence[str]) -> list[str]:
    """The names that are as given; else those that differ in case alone; else those that have it as a part.

    Examples
    --------
    >>> _names_meant("walk", ["Armature|Walk_01", "Armature|Run"]), _names_meant("run", ["Run", "RunFast"])
    (['Armature|Walk_01'], ['Run'])
    """
    low = name.casefold()
    same, alike = ([other for other in names if found(other)] for found in (name.__eq__, lambda o: o.casefold() == low))
    return same or alike or [other for other in names if low in other.casefold()]


def _quoted(names: Sequence[str]) -> str:
    return listed([repr(name) for name in names])


def on_skeleton(
    clips: Sequence[Clip], target: Skeleton, *, how: Retargeting | None = None, report: Report
) -> tuple[Clip, ...]:
    """The clips as motions of a skeleton; what is reported of several clips alike is reported once."""
    reported: set[str] = set()

    def once(line: str) -> None:
        if line not in reported:
            reported.add(line)
            report(line)

    chosen = (how or Retargeting()).read()
    return tuple(_on_skeleton(clip, target, chosen, once) for clip in clips)


def _on_skeleton(clip: Clip, target: Skeleton, how: Retargeting, report: Report) -> Clip:
    """A clip of the target's bones, which move as another clip does.

    By default they are the clip's own transforms and curves, where it has the target's names and joints.
    """
    if clip.skeleton is target:
        return clip
    path, source, B, curves = Path(clip.file), clip.skeleton, clip.B, clip.curves
    if isinstance(curves, FollowedCurves):
        report(f"{path.name}: {clip.name!r} is of another skeleton already: it is linear between its frames")
    curves = replace(curves, d=target.d) if isinstance(curves, Curves) else None
    if target.d == 2:
        try:
            source = source.in_plane()
        except ValueError as error:
            raise FileFormatError(path, str(error)) from None
        B = _in_plane(path, B)
    own = _own_bones(source, target) if how == Retargeting() else None
    if own is not None:
        _check_finite(path, B[:, own], target)
        return replace(clip, skeleton=target, B=B[:, own], curves=None if curves is None else curves.of_bones(own))
    try:
        guessed = guess_bone_map(source, target) if how.bone_map is None else how.bone_map
        assert not isinstance(guessed, str | os.PathLike)  # it was read
        follows = followed_bones(source, target, guessed)
        reference = reference_pose(
            source, B, target, follows, rest_frame=how.rest_frame, up=how.up, forward=how.forward
        )
        moved = retarget(source, B, target, guessed, reference=reference)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if how.show is not None:
        alike = reference.skeleton(source)
        how.show(replace(alike, C=alike.C @ reference.axes.T), target, guessed)
    _check_finite(path, moved.B, target)
    first, *rest = bone_map_lines(source, target, guessed)
    report(f"{path.name}: {first}; {_axes(reference.axes)}; lengths are multiplied by {moved.scale:.4g}")
    if reference.unlike:
        report(
            f"{path.name}: its rest pose is unlike the character's, and so are all frames: the pose may be wrong; name "
            "the frame that is like the character's rest pose by --rest-frame, or correct the bones by --map"
        )
    elif reference.frame is None and (reference.pose != np.eye(target.d + 1)).any():
        report(
            f"{path.name}: its rest pose does not stand as the character's: it is set upright; --rest-frame -1 keeps it"
        )
    elif reference.frame is not None and how.rest_frame is None:
        report(
            f"{path.name}: its frame {reference.frame} is taken as the character's rest pose, which its own is not; "
            "--rest-frame names another (-1: its own)"
        )
    if moved.from_first.any():
        along = " and ".join("xyz"[axis] for axis in np.flatnonzero(moved.from_first))
        report(f"{path.name}: starts far from its rest pose along {along}; there it starts where the character stands")
    for line in rest:
        report(Detail(f"{path.name}: {line}"))
    followed = None if curves is None else FollowedCurves(source, target, guessed, B[0], reference, curves)
    return replace(clip, skeleton=target, B=moved.B, curves=followed)


def bone_map_lines(source: Skeleton, target: Skeleton, bone_map: Mapping[str, str | None]) -> list[str]:
    """Which bones follow which, by bones of the source, and what is left over; `bone_map` leads from target to source.

    Examples
    --------
    >>> arm = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))
    >>> hand = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("arm", "hand"))
    >>> for line in bone_map_lines(arm, hand, {"arm": "upper"}):
    ...     print(line)
    1 of 2 bones follow a bone of the motion, 0 of them one of the same name, and 1 keeps the rest pose
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
    still = len(target.names) - follow
    lines = [
        f"{follow} of {len(target.names)} bones follow a bone of the motion, {same} of them one of the same name"
        + (f", and {still} keep{'s' * (still == 1)} the rest pose" if still else ""),
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
    return own if (apart <= _SAME_PLACE * size).all() else None


def _in_plane(path: Path, B: np.ndarray) -> np.ndarray:
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
