"""Mesh linear blend skinning: the truth that scores compare with, as a method and in one pose."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface
from nilbs.geometry.winding import occupancy
from nilbs.methods.base import Method

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.array_field import ArrayAnswers, ArrayField


@dataclass(frozen=True)
class MeshSkinning(Method):
    """The mesh, posed by linear blend skinning (eq. 1); its distance is that of the posed mesh."""

    name: ClassVar[str] = "mesh-lbs"
    summary: ClassVar[str] = "the posed mesh itself, the truth that scores compare with"

    def field(self, character: "Character") -> "ArrayField":
        """The field of a character."""
        from nilbs.fields.array_field import ArrayField
        from nilbs.fields.unit_frame import at_rest

        V, F, W = at_rest(character, character.V), character.F, character.W

        def in_pose(B: np.ndarray) -> "ArrayAnswers":
            U = linear_blend_skinning(V, W, B)
            return lambda x: (signed_distance(U, F, x), np.full(x.shape, np.nan))

        return ArrayField(in_pose, canonical_points=False)


class PosedMesh:
    """A posed mesh that is queried as a posed model is.

    A posed mesh may overlap itself; its winding number is 2 there, and the point counts as inside.
    """

    def __init__(self, U: np.ndarray, F: np.ndarray) -> None:
        self.U, self.F = U, F

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Whether points (n, d) are inside: absolute generalized winding number above one half."""
        return occupancy(self.U, self.F, x)

    def extract_on(self, grid: Grid) -> Surface:
        """Surface of the mesh's own signed distance on a grid: vertices (k, d) and facets (m', d)."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            distance = signed_distance(self.U, self.F, x)
            return distance, distance

        return field_surface(levels, grid)
