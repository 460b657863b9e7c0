"""Motions: a sequence of poses over time, with the frames that they were taken from."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nilbs.characters import AMPLITUDE, FRAMES
from nilbs.characters.character import Character
from nilbs.characters.report import Report, silent
from nilbs.geometry.kinematics import (
    bone_order,
    forward_kinematics,
    interpolate_poses,
    local_rotations,
    rms_rotation,
    smooth_random_rotations,
)
from nilbs.geometry.rotations import interpolate_transforms
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays

if TYPE_CHECKING:
    from nilbs.characters.clips import BoneMap
    from nilbs.io.motion import LocalMotion

FPS = 24  # frames a second of a motion that does not tell its times


def _unknown() -> np.ndarray:
    return np.zeros(0)


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

    Raises
    ------
    ValueError
        If sizes disagree, a number is not finite or times decrease.
    """

    B: np.ndarray
    frames: np.ndarray
    source: str
    times: np.ndarray = field(default_factory=_unknown)
    skeleton: Skeleton | None = None

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
        together; transforms that the skeleton's rotations cannot make are taken bone by bone.

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
        if s == 0:
            return self.B[k]
        if self.skeleton is None:
            return interpolate_transforms(self.B[k], self.B[k + 1], s)
        return interpolate_poses(self.skeleton.C, self.skeleton.BE, self.skeleton.P, self.B[k], self.B[k + 1], s)

    def take(self, n: int) -> "Motion":
        """Motion of n evenly spaced frames, the first and the last among them; all, where there are fewer.

        Raises
        ------
        ValueError
            If n is not positive.
        """
        if n < 1:
            raise ValueError(f"a motion needs at least one frame, got {n}")
        if n >= len(self):
            return self
        chosen = np.round(np.linspace(0, len(self) - 1, n)).astype(np.int64)
        return Motion(self.B[chosen], self.frames[chosen], self.source, self.times[chosen], self.skeleton)

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
    if frames < 1:
        raise ValueError(f"a motion needs at least one frame, got {frames}")
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
    bone_map: "BoneMap | None" = None,
    report: Report | None = None,
) -> Motion:
    """Read a motion, and put it on a character if it was made for another.

    Parameters
    ----------
    path : path
        Transforms of the character's bones (`.dmat`), local motions by their names (`.json`), or a file with a skeleton
        of its own: `.bvh`, `.glb`, `.gltf`, `.fbx`. Where that has the character's names and joints its transforms are
        taken as they are; else its motion is put on the character, see `nilbs.geometry.retargeting.retarget`.
    character : Character or Skeleton
        Whose bones move.
    clip : str, optional
        Name of the motion, in a file with several; the first by default.
    bone_map : mapping or path, optional
        For bones of the character, by name, the bones of the file that they follow, or the JSON file that says so, see
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
    from nilbs.characters.clips import chosen_clip, clip_transforms
    from nilbs.io.errors import FileFormatError, check_suffix
    from nilbs.io.registry import MOTIONS, OWN_MOTIONS

    report = report or silent
    skeleton = character if isinstance(character, Skeleton) else character.skeleton
    path = Path(path)
    suffix = check_suffix(path, *MOTIONS)
    if suffix in OWN_MOTIONS:
        if clip is not None or bone_map is not None:
            what = "clip" if clip is not None else "bone map"
            raise FileFormatError(
                path, f"a {suffix} file moves the character's own bones: there is no {what} to choose"
            )
        B, times = _own_transforms(path, suffix, skeleton)
        source = path.name
    else:
        found = chosen_clip(path, clip, report)
        B, times = clip_transforms(path, found, skeleton, bone_map, report), found.times
        source = path.name if clip is None else f"{path.name}, {found.name}"
    bad = np.argwhere(~np.isfinite(B).all(axis=(-1, -2)))
    if len(bad):
        raise FileFormatError(
            path, f"frame {bad[0][0]} moves bone {skeleton.names[bad[0][1]]!r} farther than numbers go"
        )
    return Motion(B, np.arange(len(B)), source, times, skeleton)


def _own_transforms(path: Path, suffix: str, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Transforms of a file without a skeleton, and its times; no times where it does not tell."""
    from nilbs.characters.clips import in_plane
    from nilbs.io.errors import FileFormatError
    from nilbs.io.motion import read_motion_json, read_transforms

    if suffix == ".json":
        motion = read_motion_json(path, skeleton.names, skeleton.d)
        with np.errstate(over="ignore", invalid="ignore"):
            return _posed(skeleton, motion), _unknown() if motion.times is None else motion.times
    B = read_transforms(path)
    if B.shape[1] != len(skeleton.BE):
        raise FileFormatError(path, f"moves {B.shape[1]} bones, but the rig has {len(skeleton.BE)}")
    return in_plane(path, B) if skeleton.d == 2 else B, _unknown()


def _posed(skeleton: Skeleton, motion: "LocalMotion") -> np.ndarray:
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
