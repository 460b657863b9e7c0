"""A baseline of your own: every bone carries a ball, and the body is the union of the balls.

Importing this file is all that it takes: `nilbs.fit(character, motion, "balls")` trains it, and models, scores and
files find it by its name. In a package of your own, an entry point of the group `nilbs.methods` that names the class
lets the command line find it too: `nilbs train hero.glb --method balls --radius 0.05 -o hero.nilbs`.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from nilbs.characters.character import Character
from nilbs.engine.unit_frame import first_joints
from nilbs.fields.field import Field
from nilbs.methods.base import TrainedMethod, setting


@dataclass(frozen=True)
class Balls(TrainedMethod):
    """Its fields are its settings; lengths are fractions of the body's longest edge."""

    name: ClassVar[str] = "balls"
    summary: ClassVar[str] = "a ball at every bone, with learned centre and radius"

    radius: float = setting(0.1, "radius of every ball at the start")

    def field(self, character: Character) -> Field:
        """What is trained: one ball at the first joint of every bone."""
        return BallField(torch.as_tensor(first_joints(character)).float(), self.radius)


class BallField(Field):
    """Union of balls that move with their bones; points and poses are in units of the body."""

    def __init__(self, centers: Tensor, radius: float) -> None:
        super().__init__()
        self.centers = nn.Parameter(centers)
        self.radii = nn.Parameter(torch.full((len(centers),), radius))

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy, positive inside the deepest ball."""
        d = x.shape[-1]
        posed = (B[..., :d, :d] @ self.centers[..., None])[..., 0] + B[..., :d, d]
        distance = (x[:, :, None] - posed[:, None]).norm(dim=-1) - self.radii
        return -distance.amin(dim=-1) / 0.01
