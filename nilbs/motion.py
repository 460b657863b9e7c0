"""Motions: a sequence of poses, with the frames that they were taken from."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nilbs.character import Character
from nilbs.geometry.kinematics import forward_kinematics, local_rotations, smooth_random_rotations
from nilbs.geometry.validation import arrays


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
    """

    B: np.ndarray
    frames: np.ndarray
    source: str

    def __post_init__(self) -> None:
        arrays(B=(self.B, "t b d+1 d+1"), frames=(self.frames, "t", int))

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
        return Motion(self.B[chosen], self.frames[chosen], self.source)

    def rms_rotation(self, character: Character) -> float | None:
        """Root mean square of the local rotation angles of all bones but the roots, in radians.

        None where the transforms have no local rotations (a bone is scaled, a joint comes apart) or every bone is a
        root.
        """
        try:
            theta, _ = local_rotations(character.C, character.BE, character.P, self.B)
        except ValueError:
            return None
        turned = theta[:, character.P >= 0]
        return float(np.sqrt((turned**2).sum(axis=-1).mean())) if turned.size else None


def random_motion(character: Character, *, frames: int = 100, amplitude: float = 0.4, seed: int = 0) -> Motion:
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
    """
    if frames < 1:
        raise ValueError(f"a motion needs at least one frame, got {frames}")
    rng = np.random.default_rng(seed)
    theta = smooth_random_rotations(character.P, character.d, frames, amplitude=amplitude, rng=rng)
    B = forward_kinematics(character.C, character.BE, character.P, theta)
    return Motion(B, np.arange(frames), f"random, amplitude {amplitude:g} rad rms, {frames} frames, seed {seed}")


def read_motion(path: str | Path, character: Character) -> Motion:
    """Read the motion of a character: transforms (`.dmat`) or local rotations by bone name (`.json`).

    Parameters
    ----------
    path : path
        Its suffix tells the format.
    character : Character
        Whose bones move.

    Returns
    -------
    motion : Motion

    Raises
    ------
    FileFormatError
        If the file cannot be read as a motion.
    ValueError
        If it moves another number of bones, or moves a flat character out of its plane.
    OSError
        If it cannot be opened.
    """
    from nilbs.io.errors import FileFormatError
    from nilbs.io.motion import read_motion_json, read_transforms

    path = Path(path)
    if path.suffix.lower() == ".json":
        theta, root_translation = read_motion_json(path, character.names, character.d)
        B = forward_kinematics(character.C, character.BE, character.P, theta, root_translation=root_translation)
    elif path.suffix.lower() == ".dmat":
        B = read_transforms(path)
        if B.shape[1] != len(character.BE):
            raise FileFormatError(path, f"moves {B.shape[1]} bones, but the rig has {len(character.BE)}")
        if character.d == 2:
            B = _in_plane(path, B)
    else:
        raise FileFormatError(path, f"a motion is a .json or a .dmat file, not {path.suffix or 'without suffix'}")
    return Motion(B, np.arange(len(B)), path.name)


def _in_plane(path: Path, B: np.ndarray) -> np.ndarray:
    from nilbs.io.errors import FileFormatError

    across = np.abs(B[..., 2, [0, 1, 3]]).max(axis=-1) + np.abs(B[..., :2, 2]).max(axis=-1)
    if (across > 1e-6 * np.abs(B).max()).any():
        frame, bone = np.argwhere(across > 1e-6 * np.abs(B).max())[0]
        raise FileFormatError(path, f"frame {frame} moves bone {bone} out of the plane of a flat character")
    plane = [0, 1, 3]
    return B[..., plane, :][..., plane]
