"""Motions: a sequence of poses over time, with the frames that they were taken from."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from nilbs.characters import AMPLITUDE, FRAMES
from nilbs.characters.character import Character
from nilbs.characters.clips import FPS, BoneMap, Retargeting, Show, clips_named, on_skeleton, own_clip
from nilbs.characters.report import Report, silent
from nilbs.geometry.curves import PosesOverTime
from nilbs.geometry.kinematics import (
    forward_kinematics,
    interpolate_poses,
    local_rotations,
    rms_rotation,
    smooth_random_rotations,
)
from nilbs.geometry.plane import transforms_in_space
from nilbs.geometry.rotations import interpolate_transforms
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays
from nilbs.io.bundle import Clip
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.registry import MOTIONS, OWN_MOTIONS, read_bundle


def _unknown() -> np.ndarray:
    return np.zeros(0)


def _at_least_one(n: int) -> int:
    if n < 1:
        raise ValueError(f"a motion needs at least one frame, got {n}")
    return n


@dataclass(frozen=True)
class Motion:
    """Poses of one skeleton over time.

    Attributes
    ----------
    B : (t, b, d+1, d+1) float array
        Bone transforms of every frame, rest to posed.
    frames : (t,) int array
        Number of each frame in the motion that it came from, counted from 0.
    source : str
        Where the motion came from: a file's name, or the generator and its settings.
    times : (t,) float array
        Seconds of every frame, not decreasing; by default its number at 24 frames a second.
    skeleton : Skeleton, optional
        Whose bones move. Without one, poses between frames are found bone by bone.
    clips : tuple of (str, int)
        Name and first frame of each clip, in a motion of several that follow each other. No pose lies between the last
        frame of one and the first of the next.
    curves : tuple of PosesOverTime or None
        The poses at any time, as files hold them: of each clip, or of a motion that is not of several. Between frames
        the poses are theirs.

    Raises
    ------
    ValueError
        If sizes disagree, a number is not finite, times decrease, or clips do not start one after the other from 0.
    """

    B: np.ndarray
    frames: np.ndarray
    source: str
    times: np.ndarray = field(default_factory=_unknown)
    skeleton: Skeleton | None = None
    clips: tuple[tuple[str, int], ...] = ()
    curves: tuple[PosesOverTime | None, ...] = ()

    def __post_init__(self) -> None:
        B, frames = arrays(B=(self.B, "t b d+1 d+1"), frames=(self.frames, "t", int))
        (times,) = arrays(times=(self.times if np.size(self.times) else frames / FPS, f"{len(B)}"))
        if (np.diff(times) < 0).any():
            raise ValueError(f"times decrease after frame {int(np.argmax(np.diff(times) < 0))}")
        for name, value in (("B", B), ("frames", frames), ("times", times)):
            object.__setattr__(self, name, value)
        if self.skeleton is not None and (len(self.skeleton.BE), self.skeleton.d + 1) != B.shape[1:3]:
            raise ValueError(
                f"the motion has shape {B.shape}, but the skeleton has {len(self.skeleton.BE)} bones "
                f"in {self.skeleton.d} dimensions"
            )
        starts = [start for _, start in self.clips]
        if starts and (starts[0] != 0 or (np.diff([*starts, len(B)]) <= 0).any()):
            raise ValueError(f"clips must start one after the other from frame 0 of {len(B)}, got {starts}")
        if self.curves and len(self.curves) != max(len(starts), 1):
            raise ValueError(f"curves must be of each of {max(len(starts), 1)} clips, got {len(self.curves)}")

    def __len__(self) -> int:
        return len(self.B)

    def __getitem__(self, k: int) -> np.ndarray:
        """Pose of frame k, a (b, d+1, d+1) array; frames count from 0.

        Raises
        ------
        IndexError
            If the motion has no frame k.
        """
        if not -len(self) <= k < len(self):
            raise IndexError(f"frame {k} does not exist: the motion has {len(self)} frames, counted from 0")
        return self.B[k]

    def at(self, *, frame: float | np.ndarray | None = None, seconds: float | np.ndarray | None = None) -> np.ndarray:
        """Pose at a frame or a time, and between frames.

        Between two frames of a clip that a file holds, the pose is that of the file's curves at the time in between.
        Between others local rotations are slerped, local translations and stretches are linear, so that joints stay
        together; without a skeleton, bone by bone. After the last frame of one clip that pose stays until the next clip
        starts, as that of the first frame does before its time, and of the last one after it.

        Parameters
        ----------
        frame : float or array, optional
            `at(frame=2.5)` lies half-way between `self[2]` and `self[3]`.
        seconds : float or array, optional
            A time; give either this or `frame`.

        Returns
        -------
        pose : (..., b, d+1, d+1) float array
            One pose, or as many as frames or times are given.

        Raises
        ------
        ValueError
            If the motion has no such frame, a time is no number, or not exactly one of the two is given.

        Examples
        --------
        >>> from nilbs.geometry.rotations import rigid_transforms
        >>> motion = Motion(rigid_transforms(np.eye(2), [[[0, 0]], [[4, 0]]]), [0, 1], "moved", [0, 0.5])
        >>> motion.at(frame=0.25)[0, :2, 2], motion.at(seconds=[0.25, 9.0])[:, 0, 0, 2]
        (array([1., 0.]), array([2., 4.]))
        """
        if (frame is None) == (seconds is None):
            raise ValueError("give either frame or seconds")
        if not len(self):
            raise ValueError("the motion has no frame")
        place = np.asarray(seconds if frame is None else frame, dtype=np.float64)
        shape, place, last = place.shape, place.ravel(), len(self) - 1
        if frame is None:
            if np.isnan(place).any():
                raise ValueError("there is no pose at nan s")
            at = np.clip(place, self.times[0], self.times[last])
            # The last frame that is not later: the next one is, so that their times differ.
            k = np.searchsorted(self.times, at, side="right") - 1
            h = self.times[np.minimum(k + 1, last)] - self.times[k]
            s = (at - self.times[k]) / np.where(h > 0, h, 1.0)
        else:
            bad = ~((place >= 0) & (place <= last))
            if bad.any():
                there = f"the motion has {len(self)} frames, counted from 0"
                raise ValueError(f"there is no frame {place[bad][0]:g}: {there}")
            k = place.astype(np.int64)
            s = place - k
            at = (1 - s) * self.times[k] + s * self.times[np.minimum(k + 1, last)]
        pose = self.B[k]
        between = (s > 0) & np.isin(k, self.gaps())
        clip = np.searchsorted([start for _, start in self.clips[1:]], k, side="right")
        for c in np.unique(clip[between]).tolist():
            mine = between & (clip == c)
            pose[mine] = self._between(c, k[mine], s[mine], at[mine])
        return pose.reshape(*shape, *pose.shape[1:])

    def _between(self, clip: int, k: np.ndarray, s: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Poses a fraction s (p,) of the way from frames k of a clip to the next ones."""
        curves = self.curves[clip] if self.curves else None
        if curves is not None:
            return curves.at(times)
        if self.skeleton is None:
            return interpolate_transforms(self.B[k], self.B[k + 1], s[:, None])
        return interpolate_poses(self.skeleton.C, self.skeleton.BE, self.skeleton.P, self.B[k], self.B[k + 1], s)

    def gaps(self) -> np.ndarray:
        """Frames k for which poses lie between k and k + 1: all but the last of each clip."""
        return np.setdiff1d(np.arange(len(self) - 1), [start - 1 for _, start in self.clips])

    def take(self, n: int) -> "Motion":
        """Motion of n frames, evenly spaced in number, the first and the last among them; all, if it has fewer."""
        return self._taken(np.linspace(0, len(self) - 1, _at_least_one(n)), n)

    def spread(self, n: int) -> "Motion":
        """Motion of at most n frames that are evenly spread over its duration; all, if it has no more.

        Each is the frame nearest in time to one of n evenly spaced times; none is taken twice.
        """
        if not len(self) or self.times[0] == self.times[-1]:
            return self.take(n)
        times = np.linspace(self.times[0], self.times[-1], _at_least_one(n))
        place = np.interp(times, self.times, np.arange(len(self)))
        return self._taken(np.round(place, 9), n)  # times of even frames are not quite even

    def _taken(self, place: np.ndarray, n: int) -> "Motion":
        if n >= len(self):
            return self
        chosen = np.unique(np.round(place).astype(np.int64))
        first = np.searchsorted(chosen, [start for _, start in self.clips])
        left = {int(k): clip for clip, k in enumerate(first) if k < len(chosen)}  # of those without a frame, none
        return replace(
            self,
            B=self.B[chosen],
            frames=self.frames[chosen],
            times=self.times[chosen],
            clips=tuple((self.clips[clip][0], start) for start, clip in left.items()),
            curves=tuple(self.curves[clip] for clip in left.values()) if self.clips and self.curves else self.curves,
        )

    def rms_rotation(self, character: Character) -> float | None:
        """Root mean square of the local rotation angles of all bones but the roots, in radians.

        None where the transforms have no local rotations (a bone is scaled, a joint comes apart) or every bone is a
        root.
        """
        try:
            theta, _ = local_rotations(character.skeleton.C, character.skeleton.BE, character.skeleton.P, self.B)
        except ValueError:
            return None
        return rms_rotation(theta, character.skeleton.P)


def random_motion(character: Character, *, frames: int = FRAMES, amplitude: float = AMPLITUDE, seed: int = 0) -> Motion:
    """Smooth random motion of a character: temporally coherent, and looping.

    Parameters
    ----------
    character : Character
    frames : int
        How many.
    amplitude : float
        Root mean square over the motion of each non-root bone's local rotation, in radians.
    seed : int
        The same seed gives the same motion.

    Returns
    -------
    motion : Motion

    Raises
    ------
    ValueError
        If frames is not positive or amplitude is negative.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> character = capsule(d=2)
    >>> random_motion(character, frames=3).B.shape
    (3, 2, 3, 3)
    """
    _at_least_one(frames)
    rng = np.random.default_rng(seed)
    theta = smooth_random_rotations(character.skeleton.P, character.d, frames, amplitude=amplitude, rng=rng)
    B = forward_kinematics(character.skeleton.C, character.skeleton.BE, character.skeleton.P, theta)
    source = f"random, amplitude {amplitude:g} rad rms, {frames} frames, seed {seed}"
    return Motion(B, np.arange(frames), source, skeleton=character.skeleton)


def load_motion(
    path: str | Path,
    character: Character | Skeleton,
    *,
    clip: str | None = None,
    bone_map: BoneMap | None = None,
    rest_frame: int | None = None,
    up: str | None = None,
    forward: str | None = None,
    positions: str = "auto",
    show: Show | None = None,
    report: Report | None = None,
) -> Motion:
    """Load a motion, and put it on a character if it was made for another.

    Parameters
    ----------
    path : path
        Transforms of the character's bones (`.dmat`), local motions by their names (`.json`), or a file with a skeleton
        of its own: `.bvh`, `.glb`, `.gltf`, `.fbx`, `.npz` of AMASS. Where that has the character's names and joints
        its transforms are taken as they are; else its motion is put on the character, see
        `nilbs.geometry.retargeting.retarget`.
    character : Character or Skeleton
        Whose bones move.
    clip : str, optional
        Name of the motion, in a file with several, or a part that only one name has; all by default, one after the
        other.
    bone_map : mapping or path, optional
        For bones of the character, by name, the bones of the file that they follow, or a JSON file of these, see
        `nilbs.io.bone_map.read_bone_map`. Guessed by default.
    rest_frame : int, optional
        The frame of the file that is like the character's rest pose, -1 for the file's own rest pose. Found by default.
    up, forward : str, optional
        The file's axes, such as "z" or "-y", that point up, and to where its body looks. Found by default.
    positions : "auto", "add" or "replace"
        Whether the positions of a `.bvh` file are added to its OFFSETs or take their place; by default the data decide.
    show : function, optional
        As for `nilbs.characters.clips.Retargeting`.
    report : function of str, optional
        Receives a line on each decision that the files left open.

    Returns
    -------
    motion : Motion

    Raises
    ------
    FileFormatError
        If the file cannot be read as a motion, or has no motion of that name.
    ValueError
        If it moves another number of bones, moves a flat character out of its plane, or fits none of its bones.
    OSError
        If it cannot be opened.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.geometry.skeleton import skeleton_of_bones
    >>> from nilbs.io import write_motion_json
    >>> path = tempfile.mkdtemp() + "/bend.json"
    >>> write_motion_json(path, ["bone0"], np.zeros((2, 1, 1)), np.zeros((2, 2)))
    >>> load_motion(path, skeleton_of_bones([[0, 0], [1, 0]], [[0, 1]])).times.round(3)
    array([0.   , 0.042])
    """
    path = Path(path)
    report = report or silent
    skeleton = character if isinstance(character, Skeleton) else character.skeleton
    if check_suffix(path, *MOTIONS) in OWN_MOTIONS:
        given = ((clip, "clip"), (bone_map, "bone map"), (rest_frame, "rest frame"), (up, "axis"), (forward, "axis"))
        for value, what in given:
            if value is not None:
                raise FileFormatError(
                    path, f"a {path.suffix} file moves the character's own bones: there is no {what} to choose"
                )
        return motion_of_clips([own_clip(path, skeleton)], skeleton)
    bundle = read_bundle(path, rig=skeleton, positions=positions)
    for note in bundle.notes:
        report(f"{path.name}: {note}")
    if not bundle.clips:
        raise FileFormatError(path, "the file holds no motion")
    clips = [replace(found, file=str(path)) for found in bundle.clips]
    how = Retargeting(bone_map, rest_frame, up, forward, show)
    return motion_of_clips(clips, skeleton, clip=clip, how=how, report=report)


def motion_of_clips(
    clips: Sequence[Clip],
    skeleton: Skeleton,
    *,
    clip: str | None = None,
    how: Retargeting | None = None,
    report: Report | None = None,
) -> Motion:
    """Clips of a file, or of several, as one motion of a skeleton: one after the other, or the one of a name."""
    chosen = on_skeleton(clips_named(clips, clip), skeleton, how=how, report=report or silent)
    sources = []
    for file in dict.fromkeys(found.file for found in chosen):
        names = [found.name for found in chosen if found.file == file]
        alone = clip is None and sum(found.file == file for found in clips) == 1
        sources.append(Path(file).name if alone else ", ".join([Path(file).name, *names]))
    starts = np.cumsum([0, *(len(found.B) for found in chosen)]).tolist()
    times, curves, end = [chosen[0].times], [chosen[0].curves], chosen[0].times[-1]
    for found in chosen[1:]:
        times.append(found.times - found.times[0] + end)
        curves.append(None if found.curves is None else found.curves.shifted(found.times[0], end))
        end = times[-1][-1]
    return Motion(
        np.concatenate([found.B for found in chosen]),
        np.arange(starts[-1]),
        "; ".join(sources),
        np.concatenate(times),
        skeleton,
        tuple(zip((found.name for found in chosen), starts, strict=False)) if len(chosen) > 1 else (),
        tuple(curves) if any(found.curves is not None for found in chosen) else (),
    )


def clips_of(motion: Motion, skeleton: Skeleton) -> tuple[Clip, ...]:
    """The clips of a motion as files hold them: in space, each with a name and times of its own.

    Those of which all frames are there keep their curves.
    """
    space, B = skeleton.in_space(), transforms_in_space(motion.B)
    source = Path(motion.source)
    # A name that is no file's may end in a number with a point.
    alone = source.stem if source.suffix.lower() in MOTIONS else motion.source
    names, starts = zip(*(motion.clips or ((alone, 0),)), strict=True)
    found = []
    for name, start, end, curves in zip(
        names, starts, [*starts[1:], len(motion)], motion.curves or [None] * len(names), strict=True
    ):
        times = motion.times[start:end]
        if curves is not None and not np.isin(curves.key_times, times).all():
            curves = None
        if motion.clips:
            curves = None if curves is None else curves.shifted(times[0], 0.0)
            times = times - times[0]
        found.append(Clip(name, space, times, B[start:end], curves=curves))
    return tuple(found)
