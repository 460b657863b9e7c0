"""Mesh linear blend skinning: the truth, and the reference that a field's surface cannot beat on a given grid."""

import numpy as np

from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.occupancy import occupancy


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

    def extract_on(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Surface of the mesh's own signed distance on a grid: vertices (k, d) and facets (m', d)."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            distance = signed_distance(self.U, self.F, x)
            return distance, distance

        return field_surface(levels, grid)
