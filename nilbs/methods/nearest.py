"""Inverse skinning with the weights of the nearest posed vertex: the plainest rival, with nothing learned."""

import numpy as np

from nilbs.fields.array_field import ArrayAnswers, ArrayField
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning


class NearestVertex(ArrayField):
    """The inverse map (eq. 6) with weights that are copied instead of predicted.

    A posed point takes the weights of the nearest posed vertex; the inverse of their blend sends it to its rest image,
    whose exact signed distance is the answer. Where a blend has no inverse the point is sent so far away that it is
    surely outside.

    Parameters
    ----------
    V, F, W : arrays
        Rest vertices (n, d), facets (m, d) and skinning weights (n, b).
    """

    def posed_arrays(self, B: np.ndarray) -> ArrayAnswers:
        """Signed distances and rest images in a pose (b, d+1, d+1)."""
        from scipy.spatial import cKDTree

        tree = cKDTree(linear_blend_skinning(self.V, self.W, B))
        nowhere = self.V.max(axis=0) + 10 * np.ptp(self.V, axis=0).max()

        def answers(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            _, vertex = tree.query(x)
            x_rest = inverse_linear_blend_skinning(x, self.W[vertex], B)
            x_rest = np.where(np.isfinite(x_rest), x_rest, nowhere)
            return signed_distance(self.V, self.F, x_rest), x_rest

        return answers
