"""Mesh linear blend skinning: the truth that scores compare with."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import Method

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.array_field import ArrayField


@dataclass(frozen=True)
class MeshSkinning(Method):
    """The mesh, posed by linear blend skinning (eq. 1); its distance is that of the posed mesh."""

    name: ClassVar[str] = "mesh-lbs"
    summary: ClassVar[str] = "the posed mesh itself, the truth that scores compare with"

    def field(self, character: "Character") -> "ArrayField":
        """The field of a character."""
        from nilbs.fields.array_field import ArrayField
        from nilbs.engine.unit_frame import at_rest
        from nilbs.methods.mesh_lbs.field import MeshInPose

        return ArrayField(MeshInPose(at_rest(character, character.V), character.F, character.W), canonical_points=False)
