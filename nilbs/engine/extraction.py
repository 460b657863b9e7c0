"""The surface of a field that lies near the posed skin, at the cost of the nodes around it."""

import numpy as np

from nilbs.engine.blocks import Blocks, Levels, near
from nilbs.engine.marching_cubes import Crossings, crossings
from nilbs.engine.surface_tree import PosedSurface
from nilbs.geometry.grids import Grid
from nilbs.geometry.polishing import on_zero_set
from nilbs.geometry.surface import Surface

# Vertices that are polished together.
BATCH = 2**18
CORNERS = np.argwhere(np.ones((2, 2, 2)))


def surface_near(
    skin: PosedSurface, values: Levels, grid: Grid, *, reach: float, tolerance: float | None = None
) -> Surface:
    """Surface of a field on a grid in space, queried in blocks of cells near the skin and where it leads from there.

    Parameters
    ----------
    skin : PosedSurface
    values : function of (n, 3) points
        Returns levels (n,), negative inside.
    grid : Grid
    reach : float
        A length: every piece of the surface comes this near to the skin somewhere. One that does not may be missing.
    tolerance : float, optional
        A length: how far vertices may be from the field's zero set. By default they lie where levels that are
        interpolated between nodes are zero.

    Returns
    -------
    surface : Surface
        Vertices and triangles, those of `nilbs.geometry.extraction.field_surface` with stride 1 in another order.

    Raises
    ------
    ValueError
        If a level is not finite.

    Notes
    -----
    Memory and time grow with the number of cells that the surface crosses.
    """
    blocks = Blocks(values, grid)
    blocks.add(near(skin, grid, reach))
    found = crossings(blocks)
    index = found.index if tolerance is None else _polished(found, blocks, tolerance)
    return Surface(grid.origin + grid.spacing * (index - 1), found.F)


def _polished(found: Crossings, blocks: Blocks, tolerance: float) -> np.ndarray:
    """Vertices (n, 3), in cells, on the zero set, but for those on the border of the grid."""
    grid = blocks.grid

    def level(index: np.ndarray) -> np.ndarray:
        return blocks.values(grid.origin + grid.spacing * (index - 1))

    index, low = found.index.copy(), found.node.astype(np.float64)
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
