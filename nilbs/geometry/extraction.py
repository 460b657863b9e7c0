"""Posed surfaces from a field, without a query at every node of a fine grid."""

from collections.abc import Callable

import numpy as np

from nilbs.geometry.grids import Grid, cell_corners
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.surface import Surface

# A block of cells is refined if the rest distance at one of its corners is below this many block diagonals.
# Distance changes at most as fast as position at rest; the margin is for stretch and for the blend's own slope.
MARGIN = 1.5


def field_surface(
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]], grid: Grid, *, stride: int = 4
) -> Surface:
    """Surface of a field on a grid, queried at coarse nodes first.

    Parameters
    ----------
    values : function of (n, d) points
        Returns two (n,) arrays: the level, negative inside, and a bound on the distance of the surface. With None in
        place of the second only blocks with both signs and their neighbours are refined.
    grid : Grid
        The grid of the surface.
    stride : int
        Edge of a block in cells; with 1 every node is queried.

    Returns
    -------
    surface : Surface
        ``U, F = surface``: vertices (n, d), in mesh units, and facets (m, d), oriented outward.

    Raises
    ------
    ValueError
        If a level is not finite.

    Examples
    --------
    >>> def disk(x):
    ...     distance = np.linalg.norm(x, axis=1) - 1
    ...     return distance, distance
    >>> U, F = field_surface(disk, Grid.cube([[-1, -1], [1, 1]], 32))
    >>> np.linalg.norm(U, axis=1).round(2).min(), len(U) == len(F)
    (np.float64(1.0), True)
    """
    levels, _ = node_levels(values, grid, stride=stride)
    return Surface(*isosurface(levels, grid))


def node_levels(
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]], grid: Grid, *, stride: int
) -> tuple[np.ndarray, int]:
    """Levels at all nodes, exact near the surface and of the right sign elsewhere; and how many nodes were queried.

    The parameters are those of `field_surface`.

    Examples
    --------
    >>> def disk(x):
    ...     distance = np.linalg.norm(x, axis=1) - 1
    ...     return distance, distance
    >>> levels, queries = node_levels(disk, Grid.cube([[-1, -1], [1, 1]], 64), stride=8)
    >>> levels.shape, queries < levels.size
    ((65, 65), True)
    """
    shape = np.array(grid.shape)
    blocks = -(-(shape - 1) // stride)
    coarse = np.minimum(np.argwhere(np.ones(blocks + 1, dtype=bool)) * stride, shape - 1)
    level, distance = values(grid.origin + grid.spacing * coarse)
    level = level.reshape(blocks + 1)
    levels = np.empty(grid.shape)
    # Far from the surface only the sign matters: every node takes the level of its block's first corner.
    nodes = np.ix_(*(np.arange(n) // stride for n in shape))
    levels[...] = level[nodes]
    near = _any_corner(level < 0) & _any_corner(level >= 0)
    if distance is None:
        # Loading this takes some 0.3 s, and most meshes need no wrap.
        from scipy.ndimage import binary_dilation

        near = binary_dilation(near, np.ones((3,) * near.ndim))
    else:
        near |= _any_corner(np.abs(distance).reshape(level.shape) < MARGIN * stride * grid.spacing * np.sqrt(near.ndim))
    fine = np.zeros(grid.shape, dtype=bool)
    for axis_offsets in np.ndindex(*(2,) * len(shape)):
        # A node on the border of two blocks belongs to both.
        index = np.ix_(
            *(
                np.clip((np.arange(n) - offset) // stride, 0, b - 1)
                for n, b, offset in zip(shape, blocks, axis_offsets, strict=True)
            )
        )
        fine |= near[index]
    near_nodes = np.argwhere(fine)
    levels[fine] = values(grid.origin + grid.spacing * near_nodes)[0]
    return levels, len(coarse) + len(near_nodes)


def _any_corner(marked: np.ndarray) -> np.ndarray:
    """Blocks with a corner that is marked."""
    return np.logical_or.reduce(cell_corners(marked, marked.ndim))
