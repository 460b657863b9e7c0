"""Motions: a sequence of poses over time, with the frames that they were taken from."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from nilbs.characters import AMPLITUDE, FRAMES
from nilbs.characters.character import Character
from nilbs.characters.clips import FPS, BoneMap, clips_named, on_skeleton, own_clip
from nilbs.characters.report import Report, silent
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

    def at(self, *, frame: float | None = None, seconds: float | None = None) -> np.ndarray:
        """Pose at a frame or a time, and between frames.

        Between two frames local rotations are slerped and the roots' translation is linear, so that joints stay
        together; transforms that the skeleton's rotations cannot make are taken bone by bone. After the last frame of
        one clip that pose stays until the next clip starts.

        Parameters
        ----------
        frame : float, optional
            `at(frame=2.5)` lies half-way between `self[2]` and `self[3]`.
        seconds : float, optional
            A time between the first and the last of `times`; give either this or `frame`.

        Returns
        -------
        pose : (b, d+1, d+1) float array

        Raises
        ------
        ValueError
            If the motion has no such frame or time, or not exactly one is given.
        """
        if (frame is None) == (seconds is None):
            raise ValueError("give either frame or seconds")
        last = len(self) - 1
        if seconds is not None:
            if not (last >= 0 and self.times[0] <= seconds <= self.times[last]):
                span = f"lasts from {self.times[0]:g} to {self.times[last]:g} s" if last >= 0 else "has no frame"
                raise ValueError(f"there is no pose at {seconds:g} s: the motion {span}")
            # The last frame that is not later: the next one is, so that their times differ.
            k = int(np.searchsorted(self.times, seconds, side="right")) - 1
            s = 0.0 if k == last else (seconds - self.times[k]) / (self.times[k + 1] - self.times[k])
        else:
            if not 0 <= frame <= last:  # type: ignore[operator]
                raise ValueError(f"there is no frame {frame:g}: the motion has {len(self)} frames, counted from 0")
            k = int(frame)  # type: ignore[arg-type]
            s = frame - k  # type: ignore[operator]
        if s == 0 or k not in self.gaps():
            return self.B[k]
        if self.skeleton is None:
            return interpolate_transforms(self.B[k], self.B[k + 1], s)
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
        clips = {int(k): name for (name, _), k in zip(self.clips, first, strict=True) if k < len(chosen)}
        return replace(
            self,
            B=self.B[chosen],
            frames=self.frames[chosen],
            times=self.times[chosen],
            clips=tuple((name, start) for start, name in clips.items()),
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
    report: Report | None = None,
) -> Motion:
    """Load a motion, and put it on a character if it was made for another.

    Parameters
    ----------
    path : path
        Transforms of the character's bones (`.dmat`), local motions by their names (`.json`), or a file with a skeleton
        of its own: `.bvh`, `.glb`, `.gltf`, `.fbx`. Where that has the character's names and joints its transforms are
        taken as they are; else its motion is put on the character, see `nilbs.geometry.retargeting.retarget`.
    character : Character or Skeleton
        Whose bones move.
    clip : str, optional
        Name of the motion, in a file with several; all by default, one after the other.
    bone_map : mapping or path, optional
        For bones of the character, by name, the bones of the file that they follow, or a JSON file of these, see
        `nilbs.io.bone_map.read_bone_map`. Guessed by default.
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
        for value, what in ((clip, "clip"), (bone_map, "bone map")):
            if value is not None:
                raise FileFormatError(
                    path, f"a {path.suffix} file moves the character's own bones: there is no {what} to choose"
                )
        return motion_of_clips([own_clip(path, skeleton)], skeleton)
    bundle = read_bundle(path)
    for note in bundle.notes:
        report(f"{path.name}: {note}")
    if not bundle.clips:
        raise FileFormatError(path, "the file holds no motion")
    clips = [replace(found, file=str(path)) for found in bundle.clips]
    return motion_of_clips(clips, skeleton, clip=clip, bone_map=bone_map, report=report)


def motion_of_clips(
    clips: Sequence[Clip],
    skeleton: Skeleton,
    *,
    clip: str | None = None,
    bone_map: BoneMap | None = None,
    report: Report | None = None,
) -> Motion:
    """Clips of a file, or of several, as one motion of a skeleton: one after the other, or the one of a name."""
    chosen = on_skeleton(clips_named(clips, clip), skeleton, bone_map=bone_map, report=report or silent)
    sources = []
    for file in dict.fromkeys(found.file for found in chosen):
        names = [found.name for found in chosen if found.file == file]
        alone = clip is None and sum(found.file == file for found in clips) == 1
        sources.append(Path(file).name if alone else ", ".join([Path(file).name, *names]))
    starts = np.cumsum([0, *(len(found.B) for found in chosen)]).tolist()
    times, end = [chosen[0].times], chosen[0].times[-1]
    for found in chosen[1:]:
        times.append(found.times - found.times[0] + end)
        end = times[-1][-1]
    return Motion(
        np.concatenate([found.B for found in chosen]),
        np.arange(starts[-1]),
        "; ".join(sources),
        np.concatenate(times),
        skeleton,
        tuple(zip((found.name for found in chosen), starts, strict=False)) if len(chosen) > 1 else (),
    )


def clips_of(motion: Motion, skeleton: Skeleton) -> tuple[Clip, ...]:
    """The clips of a motion as files hold them: in space, each with a name and times of its own."""
    space, B = skeleton.in_space(), transforms_in_space(motion.B)
    if not motion.clips:
        source = Path(motion.source)
        name = source.stem if source.suffix.lower() in MOTIONS else motion.source  # it may end in a number with a point
        return (Clip(name, space, motion.times, B),)
    ends = [start for _, start in motion.clips[1:]] + [len(motion)]
    return tuple(
        Clip(name, space, motion.times[start:end] - motion.times[start], B[start:end])
        for (name, start), end in zip(motion.clips, ends, strict=True)
    )
