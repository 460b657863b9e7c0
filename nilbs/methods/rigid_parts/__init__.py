"""Rigid pieces of the rest shape, each moved by its bone: skinning without a blend."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.array_method import ArrayMethod

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from nilbs.characters.character import Character
    from nilbs.engine.array_engine import ArrayAnswers


@dataclass(frozen=True)
class RigidParts(ArrayMethod):
    """The union of rigid parts; nothing is learned, and nothing bends.

    A part is the piece of the rest shape where its bone's weight is largest. Every bone's inverse transform gives a
    candidate for the canonical point; the point is inside if a candidate lies in the shape and in the bone's own part.
    """

    name: ClassVar[str] = "rigid-parts"
    summary: ClassVar[str] = "every bone's rigid inverse, where that bone owns the place"

    def in_pose(self, character: "Character") -> "Callable[[np.ndarray], ArrayAnswers]":
        """The method of a character."""
        from nilbs.engine.unit_frame import at_rest
        from nilbs.methods.rigid_parts.field import RigidPieces

        c = character
        return RigidPieces(at_rest(c, c.V), c.F, c.W, at_rest(c, c.V_volume), c.W_volume)
