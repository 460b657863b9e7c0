"""Mesh linear blend skinning: the truth, and its own surface on a grid, which a field's is compared with."""

import numpy as np

from nilbs.fields.array_field import ArrayAnswers, ArrayField
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface
from nilbs.geometry.winding import occupancy


class MeshLbs:
    """The posed mesh itself, asked as a field is asked.

    A posed mesh may overlap itself; its winding number is 2 there, and the place counts as inside.

    Parameters
    ----------
    U : (n, d) float array
        Posed vertices, in mesh units.
    F : (m, d) int array
        Facets.
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


class MeshLbsField(ArrayField):
    """The mesh, posed by linear blend skinning (eq. 1), behind the interface of every method.

    Its distance is that of the posed mesh, not one at rest, and its rest images are nan.

    Parameters
    ----------
    V, F, W : arrays
        Rest vertices (n, d), facets (m, d) and skinning weights (n, b).
    """

    knows_rest_images = False

    def posed_arrays(self, B: np.ndarray) -> ArrayAnswers:
        """Signed distances to the mesh in a pose (b, d+1, d+1)."""
        U = linear_blend_skinning(self.V, self.W, B)
        return lambda x: (signed_distance(U, self.F, x), np.full(x.shape, np.nan))
