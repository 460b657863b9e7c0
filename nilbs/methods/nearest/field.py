"""Inverse skinning with the weights of the nearest posed vertex, on arrays."""

import numpy as np
from scipy.spatial import cKDTree

from nilbs.engine.array_engine import ArrayAnswers
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning


class NearestVertex:
    """Signed distances at canonical points by the weights of the nearest posed vertex.

    The inverse of the blend of these weights maps the posed point to its canonical point, whose exact signed distance
    is the answer. Where a blend has no inverse the canonical point lies so far away that it is surely outside.
    """

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray) -> None:
        self.V, self.F, self.W = V, F, W

    def __call__(self, B: np.ndarray) -> ArrayAnswers:
        """Distances and canonical points in a pose."""
        tree = cKDTree(linear_blend_skinning(self.V, self.W, B))
        nowhere = self.V.max(axis=0) + 10 * np.ptp(self.V, axis=0).max()

        def answers(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            _, vertex = tree.query(x)
            x_rest = inverse_linear_blend_skinning(x, self.W[vertex], B)
            x_rest = np.where(np.isfinite(x_rest), x_rest, nowhere)
            return signed_distance(self.V, self.F, x_rest), x_rest

        return answers
