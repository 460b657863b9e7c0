"""The posed mesh, on arrays: as a field in any pose, and in one pose as scores query it."""

import numpy as np

from nilbs.engine.array_engine import ArrayAnswers
from nilbs.engine.winding import winding_number
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface


class MeshInPose:
    """Signed distances of the posed mesh; there are no canonical points."""

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray) -> None:
        self.V, self.F, self.W = V, F, W

    def __call__(self, B: np.ndarray) -> ArrayAnswers:
        """Distances in a pose."""
        U = linear_blend_skinning(self.V, self.W, B)
        return lambda x: (signed_distance(U, self.F, x), np.full(x.shape, np.nan))


class PosedMesh:
    """A posed mesh that is queried as a posed model is.

    A posed mesh may overlap itself; its winding number is 2 there, and the point counts as inside.
    """

    def __init__(self, U: np.ndarray, F: np.ndarray) -> None:
        self.U, self.F = U, F

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Whether points (n, d) are inside: absolute generalized winding number above one half."""
        return np.abs(winding_number(self.U, self.F, x)) > 0.5

    def extract_on(self, grid: Grid) -> Surface:
        """Surface of the mesh's own signed distance on a grid: vertices (k, d) and facets (m', d)."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            distance = signed_distance(self.U, self.F, x)
            return distance, distance

        return field_surface(levels, grid)
