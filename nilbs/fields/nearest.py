"""Inverse skinning with the weights of the nearest posed vertex: the plainest rival, with nothing learned."""

import numpy as np

from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.occupancy import occupancy
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning


class NearestVertex:
    """The inverse map (eq. 6) in one pose, with weights that are copied instead of predicted.

    Parameters
    ----------
    V, F, W : arrays
        Rest vertices (n, d) in mesh units, facets (m, d) and skinning weights (n, b).
    B : (b, d+1, d+1) float array
        Pose, rest to posed.
    """

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray, B: np.ndarray) -> None:
        from scipy.spatial import cKDTree

        self.V, self.F, self.W, self.B = V, F, W, B
        self.tree = cKDTree(linear_blend_skinning(V, W, B))
        # Where a blend has no inverse the point goes so far away that it is surely outside.
        self.nowhere = V.max(axis=0) + 10 * np.ptp(V, axis=0).max()

    def rest_points(self, x: np.ndarray) -> np.ndarray:
        """Rest images (n, d) of posed points."""
        _, vertex = self.tree.query(x)
        x_rest = inverse_linear_blend_skinning(x, self.W[vertex], self.B)
        return np.where(np.isfinite(x_rest), x_rest, self.nowhere)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Whether points (n, d) are inside."""
        return occupancy(self.V, self.F, self.rest_points(x))

    def extract_on(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Surface of the rest images' signed distance on a grid: vertices (k, d) and facets (m', d)."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            distance = signed_distance(self.V, self.F, self.rest_points(x))
            return distance, distance

        return field_surface(levels, grid)
