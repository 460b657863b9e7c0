"""What a training sees: a character in motion, and points of it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.engine.unit_frame import UnitFrame, at_rest
from nilbs.fields.samples import OccupancySamples, RestSamples, occupancy_samples, surface_samples, volume_samples
from nilbs.geometry.kinematics import forward_kinematics, random_rotations

# The most labelled points of a training, which bounds its memory for motions of any length.
MOST_LABELLED = 10_000_000
# Canonical points whose weights are given.
REST_POINTS = 200_000
# Poses that are drawn beside those of the motion.
RANDOM_POSES = 4096
# Separates the draws before the first step from those of the steps.
_STREAM = 2**32 - 1


@dataclass(frozen=True)
class Scene:
    """A character in motion, in the unit frame, as losses take it.

    Attributes
    ----------
    character : Character
    motion : Motion
    frame : UnitFrame
        Of all poses of the motion.
    poses : (t, b, d+1, d+1) tensor
        The motion's frames in the unit frame, in the field's precision and on its device.
    rng : numpy.random.Generator
        Random number generator of what is drawn before the first step.
    progress : bool
        Whether to show a progress bar while frames are labelled.
    """

    character: Character
    motion: Motion
    frame: UnitFrame
    poses: Tensor
    rng: np.random.Generator
    progress: bool = False

    @classmethod
    def of(cls, character: Character, motion: Motion, like: Tensor, *, seed: int, progress: bool = False) -> Self:
        """The scene of a motion; `like` has the field's precision and device."""
        frame = UnitFrame(character, torch.from_numpy(np.array(motion.B)))
        return cls(character, motion, frame, frame.B.to(like), np.random.default_rng([seed, _STREAM]), progress)

    def labelled_points(self, n: int, *, noise: float) -> OccupancySamples:
        """N labelled points of each frame, drawn in the world as scores draw them; noise in L, 0 for uniform ones."""
        from nilbs.geometry.progress import progress_bar

        c = self.character
        frames = progress_bar(self.motion.B, desc="labelling", unit="frame", shown=self.progress)
        n = max(1, min(n, MOST_LABELLED // len(self.motion)))
        samples = occupancy_samples(c.V, c.F, c.W, frames, n=n, noise=noise * c.L or None, rng=self.rng)
        x_unit = self.frame.points(torch.from_numpy(samples.x)).numpy()
        return OccupancySamples(x_unit.astype(np.float32), samples.inside)

    def volume_points(self, *, shell: float) -> RestSamples:
        """Points of the rest volume and of a shell around the surface, with their weights."""
        c = self.character
        V, V_volume = at_rest(c, c.V), at_rest(c, c.V_volume)
        return volume_samples(V, c.F, c.W, V_volume, c.T, c.W_volume, n=REST_POINTS, shell=shell, rng=self.rng)

    def surface_points(self) -> RestSamples:
        """Vertices of the rest surface with their weights; a flat mesh has others inside."""
        on = np.unique(self.character.F)
        return surface_samples(at_rest(self.character, self.character.V[on]), self.character.W[on])

    def random_poses(self, std: float) -> Tensor:
        """Random poses (k, b, d+1, d+1) in the unit frame: every bone but the roots turns from its rest pose.

        The standard deviation of a pose's angles, in radians, lies between a fifth of `std` and `std`.
        """
        (C, BE, P), d = self.unit_bones(), self.character.d
        theta = random_rotations(P, d, RANDOM_POSES, std=1.0, rng=self.rng)
        theta *= self.rng.uniform(std / 5, std, (RANDOM_POSES, 1, 1))
        return torch.as_tensor(forward_kinematics(C, BE, P, theta)).to(self.poses)

    def unit_bones(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """C, BE and P of the skeleton in the unit frame."""
        skeleton = self.character.skeleton
        return at_rest(self.character, skeleton.C), skeleton.BE, skeleton.P
