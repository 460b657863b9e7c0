"""Values of vertices anywhere: inside a volume mesh, and on a surface."""

import numpy as np
from scipy.sparse import csr_array

from nilbs.geometry.distance import closest_points
from nilbs.geometry.plane import in_space
from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import boundary_facets


def surface_interpolation(V: np.ndarray, F: np.ndarray, values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values of a surface's vertices at the places of it that are closest to points.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets, at least one; d is 2 or 3.
    values : (n, k) float array
        Values of the vertices.
    x : (p, d) float array
        Points, on the surface or not.

    Returns
    -------
    values : (p, k) float array
        Linear on every facet.

    Raises
    ------
    ValueError
        If the sizes disagree or F is empty.

    Examples
    --------
    >>> surface_interpolation([[0, 0], [4, 0]], [[0, 1]], [[0.0], [1.0]], [[1, 2], [9, 0]]).ravel()
    array([0.25, 1.  ])
    """
    V, F, values, x = arrays(V=(V, "n d"), F=(F, "m d", int), values=(values, "n k"), x=(x, "p d"))
    if not len(F):
        raise ValueError("a surface without facets has no values")
    _, facet, place = closest_points(V, F, x)
    return facet_values(V, F, values, place, facet)


def facet_values(V: np.ndarray, F: np.ndarray, values: np.ndarray, x: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Values (p, k) at points of known facets (p,), linear on every facet; see `surface_interpolation`.

    Examples
    --------
    >>> facet_values([[0, 0], [4, 0]], [[0, 1]], [[0.0], [1.0]], [[1, 0]], [0])
    array([[0.25]])
    """
    V, values = arrays(V=(V, "n d"), values=(values, "n k"))
    return facet_shares(V, F, x, facet) @ values


def facet_shares(V: np.ndarray, F: np.ndarray, x: np.ndarray, facet: np.ndarray) -> csr_array:
    """How much each vertex counts at points of known facets (p,): (p, n), rows sum to one.

    Examples
    --------
    >>> facet_shares([[0, 0], [4, 0]], [[0, 1]], [[1, 0]], [0]).toarray()
    array([[0.75, 0.25]])
    """
    V, F, x, facet = arrays(V=(V, "n d"), F=(F, "m d", int), x=(x, "p d"), facet=(facet, "p", "F"))
    corners = V[F[facet]]
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(0, 2, 1)
    # A facet without area has any coordinates; the small diagonal picks one instead of failing.
    gram += 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(gram.shape[1]) + 1e-300 * np.eye(
        gram.shape[1]
    )
    rest = np.linalg.solve(gram, edges @ (x - corners[:, 0])[:, :, None])[:, :, 0]
    return _shares(np.concatenate([1 - rest.sum(axis=1, keepdims=True), rest], axis=1), F[facet], len(V))


def volume_interpolation(V: np.ndarray, T: np.ndarray, values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values of a volume mesh's vertices at points.

    Parameters
    ----------
    V, T : (n, d) float array and (t, d+1) int array
        Vertices and elements: triangles or tetrahedra, at least one.
    values : (n, k) float array
        Values of the vertices.
    x : (p, d) float array
        Points.

    Returns
    -------
    values : (p, k) float array
        Linear in every element; a point outside has the value of the closest place of the mesh.

    Raises
    ------
    ValueError
        If the sizes disagree or T is empty.

    Examples
    --------
    >>> V, T = [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]
    >>> volume_interpolation(V, T, [[0.0], [1.0], [0.0]], [[0.5, 0.25], [3, 0]]).round(12).ravel()
    array([0.5, 1. ])
    """
    V, values = arrays(V=(V, "n d"), values=(values, "n k"))
    return volume_shares(V, T, x) @ values


def volume_shares(V: np.ndarray, T: np.ndarray, x: np.ndarray) -> csr_array:
    """How much each vertex of a volume mesh counts at points: (p, n), rows sum to one; see `volume_interpolation`.

    Examples
    --------
    >>> V, T = [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]
    >>> volume_shares(V, T, [[0.25, 0.25]]).toarray()
    array([[0.5 , 0.25, 0.25]])
    """
    V, T, x = arrays(V=(V, "n d"), T=(T, "t d+1", "V"), x=(x, "p d"))
    if not len(T):
        raise ValueError("a volume mesh without elements has no values")
    if V.shape[1] == 2:
        # In the plane the elements are a surface of their own, whose closest place is the point itself where it is in.
        return _surface_shares(in_space(V), T, in_space(x))
    import igl

    tree = igl.AABB()
    tree.init(V, T)
    element = igl.in_element(V, T, x, tree)
    inside = element >= 0
    corners = np.zeros((len(x), 4), dtype=np.int64)
    corners[inside] = T[element[inside]]
    barycentric = np.zeros((len(x), 4))
    barycentric[inside] = igl.barycentric_coordinates(x[inside], *(V[corners[inside, i]] for i in range(4)))
    if not inside.all():
        surface = _surface_shares(V, boundary_facets(T), x[~inside])
        corners[~inside, :3], barycentric[~inside, :3] = surface.indices.reshape(-1, 3), surface.data.reshape(-1, 3)
    return _shares(barycentric, corners, len(V))


def _surface_shares(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> csr_array:
    """How much each vertex counts at the places of a surface that are closest to points."""
    _, facet, place = closest_points(V, F, x)
    return facet_shares(V, F, place, facet)


def _shares(barycentric: np.ndarray, corners: np.ndarray, n: int) -> csr_array:
    """Shares (p, n) of corners (p, k): rounding never leaves the range of a convex blend."""
    barycentric = np.maximum(barycentric, 0)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    p, k = corners.shape
    return csr_array((barycentric.ravel(), corners.ravel(), np.arange(p + 1) * k), shape=(p, n))
