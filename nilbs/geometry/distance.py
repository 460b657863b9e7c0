"""Distance from points to a surface: edges in two dimensions, triangles in three."""

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import occupancy


def closest_points(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closest place on a surface to each point.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.
    x : (p, d) float array
        Query points, in mesh units.

    Returns
    -------
    distance : (p,) float array
        Unsigned distance, in mesh units.
    facet : (p,) int array
        Index of a facet that holds the closest place.
    point : (p, d) float array
        The closest place, in mesh units.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex or a number is not finite.

    Notes
    -----
    Without facets there is no closest place: distance inf, facet -1, point NaN.

    Examples
    --------
    >>> distance, facet, point = closest_points([[0, 0], [2, 0]], [[0, 1]], [[1, 3]])
    >>> distance, facet, point
    (array([3.]), array([0]), array([[1., 0.]]))
    """
    V, F, x = arrays(V=(V, "n d"), F=(F, "m d", "V"), x=(x, "p d"))
    if not len(F):
        return np.full(len(x), np.inf), np.full(len(x), -1), np.full(x.shape, np.nan)
    import igl

    # libigl's tree needs three coordinates; edges in the plane z = 0 keep their distances.
    squared, facet, point = igl.point_mesh_squared_distance(in_space(x), in_space(V), np.ascontiguousarray(F))
    return np.sqrt(squared), facet.astype(np.int64), np.ascontiguousarray(point[:, : V.shape[1]])


def signed_distance(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Signed distance from points to a surface, negative inside.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.
    x : (p, d) float array
        Query points, in mesh units.

    Returns
    -------
    distance : (p,) float array
        In mesh units. The length is the distance to the nearest facet; the sign is negative where the absolute
        generalized winding number is above one half. No facets: inf.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex or a number is not finite.

    Notes
    -----
    Where a posed body overlaps itself, facets that lie inside another part of it still count for the length.

    Examples
    --------
    >>> V, F = [[0, 0], [4, 0], [4, 4], [0, 4]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> signed_distance(V, F, [[2, 1], [2, -3]])
    array([-1.,  3.])
    """
    length, _, _ = closest_points(V, F, x)
    return np.where(occupancy(V, F, x), -length, length)
