"""Facets of a surface: edges in two dimensions, triangles in three."""

import numpy as np

from nilbs.geometry.topology import group_labels, ridges
from nilbs.geometry.validation import arrays, check_indices


def facet_areas(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Area of every triangle, or length of every edge.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.

    Returns
    -------
    area : (m,) float array
        In mesh units to the power d - 1.

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Examples
    --------
    >>> facet_areas([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    array([3.])
    >>> facet_areas([[0, 0], [3, 4]], [[0, 1]])
    array([5.])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    normal = _scaled_normals(V, F)
    return np.linalg.norm(normal, axis=1) / (V.shape[1] - 1)


def facet_normals(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Outward unit normal of every facet.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets; d is 2 or 3. Facets are triangles counter-clockwise seen from outside, or edges with the
        inside on their left.

    Returns
    -------
    normal : (m, d) float array
        Unit vectors; zero where a facet has no area.

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Examples
    --------
    >>> facet_normals([[0, 0], [2, 0]], [[0, 1]])
    array([[ 0., -1.]])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    normal = _scaled_normals(V, F)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0) + 0.0


def components(F: np.ndarray, n: int) -> int:
    """Count of connected pieces of a surface.

    Parameters
    ----------
    F : (m, d) int array
        Facets, indices into n vertices; d is 2 or 3.
    n : int
        Number of vertices.

    Returns
    -------
    count : int
        Two facets that share a vertex are in one piece. A vertex that no facet uses is no piece.

    Raises
    ------
    ValueError
        If the shape is wrong or F indexes a missing vertex.

    Examples
    --------
    >>> components([[0, 1], [1, 2], [3, 4]], 6)
    2
    """
    (F,) = arrays(F=(F, "m d", int))
    if not len(F):
        return 0
    check_indices("F", F, n, "vertices")
    label = group_labels(np.repeat(F[:, 0], F.shape[1] - 1), F[:, 1:].ravel(), n)
    return len(np.unique(label[F[:, 0]]))


def seamless(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Facets that share vertices across seams: each corner is the first vertex of facets at its place.

    Parameters
    ----------
    V : (n, d) float array
        Vertices; d is 2 or 3. Those with equal coordinates stand at one place.
    F : (m, k) int array
        Facets, or other elements, indices into V.

    Returns
    -------
    F : (m, k) int array
        The same elements in the same order, indices into the same V.

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Examples
    --------
    >>> V = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> seamless(V, [[0, 1, 2], [3, 4, 5]]).tolist()
    [[0, 1, 2], [1, 4, 2]]
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m k", "V"))
    used = np.unique(F)
    _, first, place = np.unique(V[used] + 0.0, axis=0, return_index=True, return_inverse=True)  # turns -0.0 into 0.0
    joined = np.arange(len(V))
    joined[used] = used[first[place.ravel()]]
    return joined[F]


def is_watertight(F: np.ndarray) -> bool:
    """Whether a surface is closed, manifold along its edges and consistently oriented.

    Parameters
    ----------
    F : (m, d) int array
        Facets, vertex indices; d is 2 or 3.

    Returns
    -------
    watertight : bool
        In 3D: every edge of a triangle runs once in each direction. In 2D: every vertex ends one edge and starts one.
        Vertices count as the same by index, not by place. No facets at all leave no hole: True.

    Raises
    ------
    ValueError
        If the shape is wrong or an index is negative.

    Examples
    --------
    >>> is_watertight([[0, 1], [1, 2], [2, 0]])
    True
    >>> is_watertight([[0, 1, 2]])
    False
    """
    (F,) = arrays(F=(F, "m d", int))
    if not len(F):
        return True
    check_indices("F", F, int(F.max()) + 1, "vertices")
    meeting = ridges(F)
    balance = np.bincount(meeting.ridge.ravel(), meeting.sign.ravel())
    repeated = (np.diff(np.sort(F, axis=1), axis=1) == 0).any()
    return bool((meeting.count == 2).all() and not balance.any() and not repeated)


def _scaled_normals(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Outward normals, as long as an edge or as twice a triangle's area."""
    if V.shape[1] == 2:
        edge = V[F[:, 1]] - V[F[:, 0]]
        return np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    return np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
