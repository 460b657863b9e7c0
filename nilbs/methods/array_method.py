"""Baselines with nothing to learn: a function of poses and points, in numpy."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import Method

if TYPE_CHECKING:
    import numpy as np

    from nilbs.characters.character import Character
    from nilbs.engine.array_engine import ArrayAnswers, ArrayEngine
    from nilbs.engine.rest_state import RestState
    from nilbs.fields.array_field import ArrayField


@dataclass(frozen=True)
class ArrayMethod(Method):
    """A method that is queried without torch; a subclass has `in_pose`.

    Attributes
    ----------
    canonical_points : bool
        Whether its answers have them.
    """

    canonical_points: ClassVar[bool] = True

    def in_pose(self, character: "Character") -> "Callable[[np.ndarray], ArrayAnswers]":
        """The method of a character: a pose (b, d+1, d+1) of the unit frame -> its answers at points (n, d)."""
        raise NotImplementedError

    def engine(self, character: "Character", rest: "RestState", mapping: str | None = None) -> "ArrayEngine":
        """What answers without torch."""
        from nilbs.engine.array_engine import ArrayEngine

        return ArrayEngine(self.in_pose(character), canonical_points=self.canonical_points)

    def field(self, character: "Character") -> "ArrayField":
        """The same as a field."""
        from nilbs.engine.rest_state import RestState
        from nilbs.fields.array_field import ArrayField

        return ArrayField(self.engine(character, RestState()))
