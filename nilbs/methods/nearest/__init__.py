"""The plainest baseline: inverse skinning with the weights of the nearest posed vertex, nothing learned."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import Method

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.array_field import ArrayField


@dataclass(frozen=True)
class Nearest(Method):
    """The inverse map (eq. 6) with weights that are copied instead of predicted."""

    name: ClassVar[str] = "nearest"
    summary: ClassVar[str] = "inverse skinning with the weights of the nearest posed vertex"

    def field(self, character: "Character") -> "ArrayField":
        """The field of a character."""
        from nilbs.fields.array_field import ArrayField
        from nilbs.engine.unit_frame import at_rest
        from nilbs.methods.nearest.field import NearestVertex

        return ArrayField(NearestVertex(at_rest(character, character.V), character.F, character.W))
