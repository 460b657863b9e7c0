"""Mesh linear blend skinning: the truth that scores compare with."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.array_method import ArrayMethod

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from nilbs.characters.character import Character
    from nilbs.engine.array_engine import ArrayAnswers


@dataclass(frozen=True)
class MeshSkinning(ArrayMethod):
    """The mesh, posed by linear blend skinning (eq. 1); its distance is that of the posed mesh."""

    name: ClassVar[str] = "mesh-lbs"
    summary: ClassVar[str] = "the posed mesh itself, the truth that scores compare with"
    canonical_points: ClassVar[bool] = False

    def in_pose(self, character: "Character") -> "Callable[[np.ndarray], ArrayAnswers]":
        """The method of a character."""
        from nilbs.engine.unit_frame import at_rest
        from nilbs.methods.mesh_lbs.field import MeshInPose

        return MeshInPose(at_rest(character, character.V), character.F, character.W)
