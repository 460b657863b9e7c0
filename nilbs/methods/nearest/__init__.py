"""The plainest baseline: inverse skinning with the weights of the nearest posed vertex, nothing learned."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.array_method import ArrayMethod

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from nilbs.characters.character import Character
    from nilbs.engine.array_engine import ArrayAnswers


@dataclass(frozen=True)
class Nearest(ArrayMethod):
    """The inverse map (eq. 6) with weights that are copied instead of predicted."""

    name: ClassVar[str] = "nearest"
    summary: ClassVar[str] = "inverse skinning with the weights of the nearest posed vertex"

    def in_pose(self, character: "Character") -> "Callable[[np.ndarray], ArrayAnswers]":
        """The method of a character."""
        from nilbs.engine.unit_frame import at_rest
        from nilbs.methods.nearest.field import NearestVertex

        return NearestVertex(at_rest(character, character.V), character.F, character.W)
