"""The rest pose on grids: signed distance that is exact at the surface, and weights that continue beyond it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from nilbs.geometry.distance import closest_points
from nilbs.geometry.grids import Grid, cell_corners
from nilbs.geometry.interpolation import facet_values, volume_interpolation
from nilbs.geometry.topology import group_labels, ridges
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import occupancy

# Nodes that are evaluated at once.
CHUNK = 2**19
# The coarsest grid has at least this many cells along its shortest edge.
COARSEST = 4


def distance_grid(V: np.ndarray, F: np.ndarray, grid: Grid) -> np.ndarray:
    """Signed distance at the nodes of a grid: exact within two diagonals of a cell of the surface.

    Elsewhere the sign is right, and the value is linear between nodes of the coarser grid that was exact there.

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


class Bricks(NamedTuple):
    """Values on a grid whose cells are divided, and the cells of those again.

    `values` (s,) are those of the grid's nodes, then of each brick's, division by division; the last axis runs fastest.
    `brick`, of the shape of the grid's cells, numbers the bricks of the first division, and `finer` (c,) those of the
    next divisions for the cells of every brick but the last ones; -1 is a cell that is not divided.
    """

    values: np.ndarray
    brick: np.ndarray
    finer: np.ndarray


def distance_bricks(
    V: np.ndarray, F: np.ndarray, grid: Grid, *, parts: Sequence[int], tolerance: float, relative: float
) -> Bricks:
    """Signed distance on a grid that is divided at the surface, and again where that is not enough.

    The edge of a cell is divided in parts[0] parts, of those cells that need it in parts[1] and so on; the (parts +
    1)^d nodes of a divided cell are a brick. A cell of a brick is divided if linear interpolation, by the second
    differences in the brick, misses the distance by more than `tolerance` plus `relative` times that distance.

    Notes
    -----
    Distance changes at most as fast as position, so that the surface crosses no cell with a corner farther from it than
    a diagonal. All cells that it may cross are divided once. Whether that is enough depends on how much distance bends,
    as it does at edges and around and within what is thin.

    Linear interpolation between exact values of a convex function is too large: by an eighth of the second difference
    along each axis halfway between nodes, and by a twelfth on average. Values at nodes of bricks are that much too
    small instead, but for those of cells that are divided further, and interpolation is right on average: the body is
    neither too thin nor too thick.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> bricks = distance_bricks(*square, Grid([-0.5, 0.4], 0.2, (6, 2)), parts=[2], tolerance=0.0, relative=0.0)
    >>> bricks.brick.ravel()
    array([-1, -1,  0, -1, -1], dtype=int32)
    >>> bricks.values[[12, 15, 18]].round(3) + 0.0
    array([ 0.1,  0. , -0.1])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    if min(parts, default=2) < 2:
        raise ValueError(f"parts must be at least 2, got {list(parts)}")
    coarse = distance_grid(V, F, grid)
    d, cells = coarse.ndim, np.array(grid.shape) - 1
    farthest = np.maximum.reduce([np.abs(corner) for corner in cell_corners(coarse, d)])
    chosen = np.argwhere(farthest <= grid.spacing * np.sqrt(d))
    brick = _numbered(farthest.shape, chosen) if len(parts) else np.full(cells, -1, dtype=np.int32)
    values, finer = [coarse.ravel()], [np.empty(0, dtype=np.int32)]
    for division, part in enumerate(parts, 1):
        grid = Grid(grid.origin, grid.spacing / part, tuple(part * cells + 1))
        cells = part * cells
        within = np.argwhere(np.ones((part + 1,) * d, dtype=bool))
        node = np.ravel_multi_index(tuple((part * chosen[:, None] + within).reshape(-1, d).T), grid.shape)
        # Bricks side by side share their nodes.
        known, which = np.unique(node, return_inverse=True)
        exact = _exact(V, F, grid, known)
        nodes = exact[which].reshape(-1, *(part + 1,) * d)
        bends = _bends(nodes, d)
        missed = np.mean(cell_corners(np.abs(bends).sum(axis=0), d), axis=0) / 8
        again = missed > tolerance + relative * np.abs(np.mean(cell_corners(nodes, d), axis=0))
        again &= division < len(parts)
        cells_at, read_at = np.zeros(nodes.shape), np.zeros(nodes.shape)
        for all_cells, read_cells in zip(cell_corners(cells_at, d), cell_corners(read_at, d), strict=True):
            all_cells += 1
            read_cells += ~again
        bend = np.bincount(which, bends.sum(axis=0).ravel()) / np.bincount(which)
        bend *= np.bincount(which, read_at.ravel()) / np.bincount(which, cells_at.ravel())
        values.append((exact - bend / 12)[which])
        if division < len(parts):
            divided = np.argwhere(again)
            finer.append(_numbered(again.shape, divided).ravel())
            chosen = part * chosen[divided[:, 0]] + divided[:, 1:]
    return Bricks(np.concatenate(values), brick, np.concatenate(finer))


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
    """Nodes (s,) of a grid in the body and in a band around it, and their weights (s, b), whose rows sum to one.

    The surface V, F has weights W, the volume mesh V_volume, T has W_volume. `band` is the width of the band; beyond
    `depth` from the surface weights do not change any more. Outside the body weights may leave [0, 1].

    Notes
    -----
    A point outside, at p + s n for its closest place p, has 2 W(p) - W(p - s n): so weights have no kink at the
    skin, which interpolation on the grid would smear over both sides. Farther than `depth` nothing changes any more.
    """
    V, F, W = arrays(V=(V, "n d"), F=(F, "m d", int), W=(W, "n b"))
    distance = distance_grid(V, F, grid).ravel()
    node = np.flatnonzero(distance < band)
    if not len(node):
        node = np.array([int(distance.argmin())])
    W_node = np.empty((len(node), W.shape[1]))
    for start in range(0, len(node), CHUNK):
        part = slice(start, start + CHUNK)
        x, inside, found = grid.nodes(node[part]), distance[node[part]] < 0, W_node[part]
        found[inside] = volume_interpolation(V_volume, T, W_volume, x[inside])
        outer = x[~inside]
        away, facet, closest = closest_points(V, F, outer)
        # The point mirrored in the surface, no deeper than `depth`.
        mirrored = closest - (outer - closest) * (np.minimum(away, depth) / np.maximum(away, 1e-300))[:, None]
        found[~inside] = 2 * facet_values(V, F, W, closest, facet) - volume_interpolation(
            V_volume, T, W_volume, mirrored
        )
    return node, W_node / W_node.sum(axis=1, keepdims=True)


def _bends(values: np.ndarray, d: int) -> np.ndarray:
    """Second differences at every node, along one axis after the other of the last d, which are the grid's."""
    bends = np.empty((d, *values.shape))
    for k, axis in enumerate(range(-d, 0)):
        inner = np.diff(values, 2, axis=axis)
        np.concatenate([inner.take([0], axis=axis), inner, inner.take([-1], axis=axis)], axis=axis, out=bends[k])
    return bends


def _numbered(shape: tuple[int, ...], chosen: np.ndarray) -> np.ndarray:
    """Numbers of chosen places (k, d) of an array, in their order, and -1 elsewhere."""
    number = np.full(shape, -1, dtype=np.int32)
    number[tuple(chosen.T)] = np.arange(len(chosen))
    return number


def _exact(V: np.ndarray, F: np.ndarray, grid: Grid, node: np.ndarray) -> np.ndarray:
    """Signed distance at nodes of a grid, given as ascending indices among all."""
    length = _at_nodes(lambda x: closest_points(V, F, x)[0], grid, node)
    side = _sides(F, grid, node, length)
    # All nodes of a side lie where the one farthest from the surface lies.
    order = np.lexsort((length, side))
    farthest = order[np.diff(side[order], append=-1) != 0]
    inside = _at_nodes(lambda x: occupancy(V, F, x), grid, node[farthest]) > 0
    return np.where(inside[side], -length, length)


def _sides(F: np.ndarray, grid: Grid, node: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Number nodes so that those of one number lie on the same side of a surface.

    Two neighbours that are together farther from a closed surface than from each other have no surface between them.
    Through an open one inside and outside hang together, and every node has a number of its own.
    """
    meeting = ridges(F)
    if np.bincount(meeting.ridge.ravel(), meeting.sign.ravel()).any():
        return np.arange(len(node))
    pairs = []
    for axis, size in enumerate(grid.shape):
        stride = int(np.prod(grid.shape[axis + 1 :]))
        first = np.flatnonzero(node // stride % size < size - 1)
        second = np.searchsorted(node, node[first] + stride)
        there = np.flatnonzero(node[np.minimum(second, len(node) - 1)] == node[first] + stride)
        first, second = first[there], second[there]
        # With room for rounding: one wrong pair would turn the whole body.
        apart = length[first] + length[second] > 1.01 * grid.spacing
        pairs.append(np.stack([first[apart], second[apart]]))
    first, second = np.concatenate(pairs, axis=1)
    return group_labels(first, second, len(node))


def _at_nodes(function: Callable[[np.ndarray], np.ndarray], grid: Grid, node: np.ndarray) -> np.ndarray:
    """Values of a function at nodes of a grid, some at once."""
    values = np.empty(len(node))
    for start in range(0, len(node), CHUNK):
        part = slice(start, start + CHUNK)
        values[part] = function(grid.nodes(node[part]))
    return values


def _refined(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values at every other node, linear in between."""
    for axis, size in enumerate(shape):
        index = np.arange(size)
        first = values.take(index // 2, axis=axis)
        second = values.take((index + 1) // 2, axis=axis)
        values = (first + second) / 2
    return values
