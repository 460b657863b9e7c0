"""Surfaces of fields on grids: polished ones, and those near the posed skin at the cost of the nodes around them."""

from collections.abc import Callable

import numpy as np

from nilbs.engine.blocks import Blocks, Levels, near
from nilbs.engine.marching_cubes import CORNERS, Crossings, crossings
from nilbs.engine.polishing import on_zero_set
from nilbs.geometry.extraction import node_levels
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.surface import Surface

# Vertices that are polished together.
BATCH = 2**18


def surface_near(
    U: np.ndarray, F: np.ndarray, values: Levels, grid: Grid, *, reach: float = 0.0, tolerance: float | None = None
) -> Surface:
    """Surface of a field on a grid in space, queried in blocks of cells near the skin and where it leads from there.

    Parameters
    ----------
    U, F : (n, 3) float array and (m, 3) int array
        The posed skin.
    values : function of (n, 3) points
        Returns levels (n,), negative inside.
    grid : Grid
    reach : float
        A length: how far from the skin blocks are queried in any case.
    tolerance : float, optional
        A length: how far vertices may be from the field's zero set. By default they lie where levels that are
        interpolated between nodes are zero.

    Returns
    -------
    surface : Surface
        Vertices and triangles, those of `dense_surface` with stride 1 in another order.

    Raises
    ------
    ValueError
        If a level is not finite.

    Notes
    -----
    A piece of the surface is found, all of it, if it crosses a block of 2 x 2 x 2 cells whose centre is within reach of
    the skin, or within half the block's diagonal, 1.7 cells. A piece that is nowhere so near is missing. Memory and
    time grow with the number of cells that the surface crosses.
    """
    blocks = Blocks(values, grid)
    blocks.add(near(U, F, grid, reach))
    found = crossings(blocks)
    index = found.place if tolerance is None else _polished(found, blocks, tolerance)
    return Surface(grid.origin + grid.spacing * (index - 1), found.F)


def dense_surface(
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]],
    grid: Grid,
    *,
    stride: int,
    tolerance: float | None = None,
) -> Surface:
    """The same from levels at all nodes, in the plane or in space: the readable twin.

    Parameters and errors are those of `nilbs.geometry.extraction.field_surface`. Vertices inside cells stay.
    """
    levels, _ = node_levels(values, grid, stride=stride)
    V, F = isosurface(levels, grid)
    if tolerance is None:
        return Surface(V, F)
    index = (V - grid.origin) / grid.spacing
    between = np.abs(index - np.round(index))
    along = between == between.max(axis=1, keepdims=True)
    low = np.where(along, np.floor(index), np.round(index)).astype(np.int64)
    high = low + along
    on_edge = (np.sort(between, axis=1)[:, -2] < 1e-5) & (low >= 0).all(axis=1) & (high < grid.shape).all(axis=1)
    low, high = low[on_edge], high[on_edge]
    f, g = (levels[tuple(node.T)] for node in (low, high))
    low, high = (grid.origin + grid.spacing * node for node in (low, high))
    V[on_edge] = on_zero_set(low, high, f, g, lambda x: values(x)[0], tolerance=tolerance)
    return Surface(V, F)


def _polished(found: Crossings, blocks: Blocks, tolerance: float) -> np.ndarray:
    """Vertices (n, 3), in cells, on the zero set, but for those on the border of the grid."""
    grid = blocks.grid

    def level(index: np.ndarray) -> np.ndarray:
        return blocks.values(grid.origin + grid.spacing * (index - 1))

    index, low = found.place.copy(), found.node.astype(np.float64)
    high, f, g = low.copy(), found.low.copy(), found.high.copy()
    first = np.searchsorted(-found.axis, 1)
    high[np.arange(first), found.axis[:first]] += 1
    if first < len(index):
        # A vertex inside a cell moves to the nearest corner on the other side.
        low[first:], f[first:] = index[first:], level(index[first:])
        corner = found.node[first:, None] + CORNERS
        levels = blocks.levels(corner)
        far = np.linalg.norm(corner - index[first:, None], axis=2)
        nearest = np.where((levels < 0) == (f[first:, None] < 0), np.inf, far).argmin(axis=1)[:, None]
        high[first:] = np.take_along_axis(corner, nearest[:, :, None], axis=1)[:, 0]
        g[first:] = np.take_along_axis(levels, nearest, axis=1)[:, 0]
    within = np.flatnonzero(((low >= 1) & (high <= grid.shape)).all(axis=1))
    for begin in range(0, len(within), BATCH):
        v = within[begin : begin + BATCH]
        index[v] = on_zero_set(low[v], high[v], f[v], g[v], level, tolerance=tolerance / grid.spacing)
    return index
