"""The rest pose on grids: signed distance that is exact at the skin, and weights that go on beyond it."""

import numpy as np

from nilbs.geometry.distance import closest_points, signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_values, volume_interpolation
from nilbs.geometry.validation import arrays

# Nodes that are asked for at once; bounds the memory of a grid of any size.
CHUNK = 2**19
# The coarsest grid has at least this many cells along its shortest edge.
COARSEST = 4


def distance_grid(V: np.ndarray, F: np.ndarray, grid: Grid) -> np.ndarray:
    """Signed distance of a surface at the nodes of a grid: exact near the surface, interpolated away from it.

    Parameters
    ----------
    V : (n, d) float array
        Vertices, in mesh units.
    F : (m, d) int array
        Facets.
    grid : Grid

    Returns
    -------
    distance : float array of shape grid.shape
        In mesh units, negative inside. Exact within two diagonals of a cell; elsewhere the sign is right, and the value
        is linear between nodes of the coarser grid that was exact there.

    Raises
    ------
    ValueError
        If V and F do not fit each other.

    Notes
    -----
    Every other node is found first, by the same rule; distance changes at most as fast as position, so a node that is
    far from the surface by interpolation is far from it.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> distance_grid(*square, Grid([-1, 0.5], 0.5, (4, 2)))[:, 0]
    array([ 1. ,  0.5,  0. , -0.5])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    shape = np.array(grid.shape)
    if (shape - 1).min() <= 2 * COARSEST:
        return _exact(V, F, grid, np.arange(grid.size)).reshape(grid.shape)
    coarse = Grid(grid.origin, 2 * grid.spacing, tuple(shape // 2 + 1))
    distance = _refined(distance_grid(V, F, coarse), grid.shape)
    near = np.flatnonzero(np.abs(distance) < 2 * coarse.spacing * np.sqrt(len(shape)))
    distance.ravel()[near] = _exact(V, F, grid, near)
    return distance


def distance_bricks(V: np.ndarray, F: np.ndarray, grid: Grid, *, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance on a grid whose cells are divided where the surface may cross them.

    Parameters
    ----------
    V : (n, d) float array
        Vertices, in mesh units.
    F : (m, d) int array
        Facets.
    grid : Grid
        The coarse grid.
    parts : int
        How many parts the edge of a cell is divided in; the nodes of a divided cell are a brick.

    Returns
    -------
    values : (s,) float array
        In mesh units, negative inside: what `distance_grid` gives at the nodes of the grid, and after it, brick by
        brick, exact values at the (parts + 1)^d nodes of each; the last axis runs fastest in both.
    brick : int32 array of the shape of the grid's cells
        Where in `values` a cell's brick begins; -1 for a cell that is not divided.

    Raises
    ------
    ValueError
        If V and F do not fit each other.

    Notes
    -----
    Distance changes at most as fast as position, so that the surface crosses no cell with a corner farther from it than
    a diagonal.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> values, brick = distance_bricks(*square, Grid([-0.5, 0.4], 0.2, (6, 2)), parts=2)
    >>> brick.ravel()
    array([-1, -1, 12, -1, -1], dtype=int32)
    >>> values[[12, 15, 18]].round(3) + 0.0
    array([ 0.1,  0. , -0.1])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    coarse = distance_grid(V, F, grid)
    d, cells = coarse.ndim, np.array(grid.shape) - 1
    corners = (coarse[tuple(slice(o, o + n) for o, n in zip(c, cells, strict=True))] for c in np.ndindex(*(2,) * d))
    farthest = np.maximum.reduce([np.abs(corner) for corner in corners])
    chosen = np.argwhere(farthest <= grid.spacing * np.sqrt(d))
    fine = Grid(grid.origin, grid.spacing / parts, tuple(parts * cells + 1))
    within = np.argwhere(np.ones((parts + 1,) * d, dtype=bool))
    node = np.ravel_multi_index(tuple((parts * chosen[:, None] + within).reshape(-1, d).T), fine.shape)
    # Bricks side by side share their nodes.
    known, which = np.unique(node, return_inverse=True)
    brick = np.full(cells, -1, dtype=np.int32)
    brick[tuple(chosen.T)] = coarse.size + len(within) * np.arange(len(chosen))
    return np.concatenate([coarse.ravel(), _exact(V, F, fine, known)[which]]), brick


def weight_grid(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray,
    V_volume: np.ndarray,
    T: np.ndarray,
    W_volume: np.ndarray,
    grid: Grid,
    *,
    band: float,
    depth: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Skinning weights at the nodes of a grid: inside the body and in a band around it.

    Parameters
    ----------
    V, F, W : arrays
        Rest surface and its weights, (k, d), (m, d) and (k, b).
    V_volume, T, W_volume : arrays
        Volume mesh and its weights, (k', d), (t, d+1) and (k', b).
    grid : Grid
    band : float
        Width of the band, in mesh units.
    depth : float
        How far weights go on beyond the skin as they come to it, in mesh units.

    Returns
    -------
    node : (s,) int array
        Nodes in the body or in the band, as indices among `Grid.points`; at least one.
    W_node : (s, b) float array
        Rows sum to one. Beyond the skin they may leave [0, 1].

    Raises
    ------
    ValueError
        If the sizes disagree.

    Notes
    -----
    A point beyond the skin, at p + s n for its closest place p, has 2 W(p) - W(p - s n): so weights have no kink at the
    skin, which interpolation on the grid would smear over both sides. Farther than `depth` nothing changes any more.
    """
    V, F, W = arrays(V=(V, "n d"), F=(F, "m d", int), W=(W, "n b"))
    distance = distance_grid(V, F, grid).ravel()
    node = np.flatnonzero(distance < band)
    if not len(node):
        node = np.array([int(distance.argmin())])
    points = grid.origin + grid.spacing * np.stack(np.unravel_index(node, grid.shape), axis=1)
    W_node = np.empty((len(node), W.shape[1]))
    for start in range(0, len(node), CHUNK):
        part = slice(start, start + CHUNK)
        W_node[part] = _weights(V, F, W, V_volume, T, W_volume, points[part], distance[node[part]] < 0, depth)
    return node, W_node / W_node.sum(axis=1, keepdims=True)


def _weights(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray,
    V_volume: np.ndarray,
    T: np.ndarray,
    W_volume: np.ndarray,
    x: np.ndarray,
    inside: np.ndarray,
    depth: float,
) -> np.ndarray:
    found = np.empty((len(x), W.shape[1]))
    found[inside] = volume_interpolation(V_volume, T, W_volume, x[inside])
    outer = x[~inside]
    away, facet, skin = closest_points(V, F, outer)
    # The mirror image of the point in the skin, no deeper than `depth`.
    mirrored = skin - (outer - skin) * (np.minimum(away, depth) / np.maximum(away, 1e-300))[:, None]
    found[~inside] = 2 * facet_values(V, F, W, skin, facet) - volume_interpolation(V_volume, T, W_volume, mirrored)
    return found


def _exact(V: np.ndarray, F: np.ndarray, grid: Grid, node: np.ndarray) -> np.ndarray:
    distance = np.empty(len(node))
    for start in range(0, len(node), CHUNK):
        part = slice(start, start + CHUNK)
        index = np.stack(np.unravel_index(node[part], grid.shape), axis=1)
        distance[part] = signed_distance(V, F, grid.origin + grid.spacing * index)
    return distance


def _refined(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values at every other node, linear in between."""
    for axis, size in enumerate(shape):
        index = np.arange(size)
        first = values.take(index // 2, axis=axis)
        second = values.take((index + 1) // 2, axis=axis)
        values = (first + second) / 2
    return values
