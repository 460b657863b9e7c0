"""Volume elements: triangles in the plane and tetrahedra in space, by the same functions."""

import math

import numpy as np

from nilbs.geometry.validation import arrays


def element_volumes(V: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Signed areas of triangles (2D) or volumes of tetrahedra (3D).

    Parameters
    ----------
    V, T : (n, d) float array and (t, d+1) int array
        Vertices, in mesh units, and elements: triangles or tetrahedra.

    Returns
    -------
    volumes : (t,) float array
        Positive for counter-clockwise triangles and for tetrahedra whose first three vertices turn counter-clockwise
        when seen from the fourth; in mesh units to the power d.

    Raises
    ------
    ValueError
        If V and T disagree on d, or T indexes a vertex that does not exist.

    Examples
    --------
    >>> element_volumes([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    array([0.5])
    """
    V, T = arrays(V=(V, "n d"), T=(T, "t d+1", "V"))
    return np.linalg.det(V[T[:, 1:]] - V[T[:, :1]]) / math.factorial(V.shape[1])


def boundary_facets(T: np.ndarray) -> np.ndarray:
    """Facets that belong to one element only: the outline of triangles, the surface of tetrahedra.

    Parameters
    ----------
    T : (t, 3) or (t, 4) int array
        Positively oriented elements.

    Returns
    -------
    F : (m, 2) or (m, 3) int array
        Edges with the inside to their left, or triangles that turn counter-clockwise when seen from outside.

    Raises
    ------
    ValueError
        If T holds neither triangles nor tetrahedra.

    Examples
    --------
    >>> boundary_facets([[0, 1, 2], [2, 1, 3]]).tolist()
    [[0, 1], [2, 0], [1, 3], [3, 2]]
    """
    (T,) = arrays(T=(T, "t d+1", int))
    if T.shape[1] == 3:
        sides = np.array([[0, 1], [1, 2], [2, 0]])
    else:
        sides = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    F = T[:, sides].reshape(-1, T.shape[1] - 1)
    corners = np.sort(F, axis=1)
    order = np.lexsort(corners.T)
    differs = np.ones(len(F) + 1, dtype=bool)  # from the facet before, in this order
    differs[1:-1] = (np.diff(corners[order], axis=0) != 0).any(axis=1)
    return F[np.sort(order[differs[:-1] & differs[1:]])]
