"""How the facets of a surface hang together, in two dimensions and three."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.validation import arrays


@dataclass(frozen=True)
class Ridges:
    """Ridges of facets: the edges of triangles, or the end points of edges.

    Each ridge has its ascending vertices `corners` (r, d-1) and its `count` (r,) of facets; one that repeats a vertex
    may count twice. Every facet has its `ridge` (m, d) and a `sign` (m, d): 1 if it runs along its ridge from the lower
    to the higher vertex, or ends there, else -1. Two facets agree if their signs differ.
    """

    corners: np.ndarray
    ridge: np.ndarray
    sign: np.ndarray
    count: np.ndarray

    def neighbours(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of facets at ridges of exactly two: first, second and whether they agree, (p,) each."""
        d = self.ridge.shape[1]
        order = np.argsort(self.ridge.ravel(), kind="stable")
        start = (np.cumsum(self.count) - self.count)[self.count == 2]
        one, other = order[start], order[start + 1]
        sign = self.sign.ravel()
        return one // d, other // d, sign[one] != sign[other]


def ridges(F: np.ndarray) -> Ridges:
    """Ridges of a surface.

    Examples
    --------
    >>> r = ridges([[0, 1, 2], [0, 2, 3]])
    >>> r.corners[r.count == 2].tolist(), r.neighbours()[2].tolist()
    ([[0, 2]], [True])
    """
    (F,) = arrays(F=(F, "m d", int))
    if F.shape[1] == 2:
        corners, ridge, count = np.unique(F, return_inverse=True, return_counts=True)
        sign = np.broadcast_to([-1, 1], F.shape)
        return Ridges(corners[:, None], ridge.reshape(F.shape), sign, count)
    tail, head = F, F[:, [1, 2, 0]]
    n = int(F.max(initial=0)) + 1
    key, ridge, count = np.unique(
        np.minimum(tail, head) * n + np.maximum(tail, head), return_inverse=True, return_counts=True
    )
    corners = np.stack([key // n, key % n], axis=1)
    return Ridges(corners, ridge.reshape(F.shape), np.where(tail < head, 1, -1), count)


def group_labels(first: np.ndarray, second: np.ndarray, size: int) -> np.ndarray:
    """Labels (size,) of the connected groups of things 0 .. size-1 that pairs (p,), (p,) join.

    Examples
    --------
    >>> group_labels([0, 1], [1, 3], 4).tolist()
    [0, 0, 1, 0]
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not size:
        return np.zeros(0, dtype=np.int64)
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(size, size))
    return connected_components(graph, directed=False)[1].astype(np.int64)
