"""Level sets of values on a grid: marching squares and marching cubes behind one signature."""

import numpy as np

from nilbs.geometry.grids import Grid
from nilbs.geometry.validation import arrays

# How near to a node, in cells, the surface may pass. Marching cubes returns single-precision positions: the limit keeps
# the vertices around one node apart on grids of up to some 500 cells, and moves a smooth surface no further.
_CLEARANCE = 1e-4


def isosurface(values: np.ndarray, grid: Grid, *, level: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface around the region where values lie below a level.

    Parameters
    ----------
    values : float array of shape grid.shape, or (grid.size,)
        Values at the grid's nodes, such as signed distance. For a field that is larger inside (a probability's logit),
        pass its negative and the negative level.
    grid : Grid
        Where the values were taken.
    level : float, optional
        Values below it are inside; values equal to it are outside.

    Returns
    -------
    V : (n, d) float array
        Vertices, in mesh units; d is the grid's.
    F : (m, d) int array
        Facets: triangles counter-clockwise seen from outside, or edges with the inside on their left.

    Raises
    ------
    ValueError
        If the values do not fit the grid or are not finite.

    Notes
    -----
    Outside the grid everything counts as outside, so a region that reaches the border is cut off there (within a
    thousandth of a cell) and the surface is closed. No value below the level: empty arrays.

    In 3D topologically consistent marching cubes [1]_, in 2D marching squares, both of scikit-image.

    References
    ----------
    .. [1] Lewiner, Lopes, Vieira, Tavares, Efficient Implementation of Marching Cubes' Cases with Topological
       Guarantees, 2003, doi:10.1080/10867651.2003.10487582.

    Examples
    --------
    >>> import numpy as np
    >>> grid = Grid([-2.0, -2.0], 1.0, (5, 5))
    >>> V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.5, grid)
    >>> V[F[:, 0]].tolist()
    [[0.0, 0.5], [-0.5, 0.0], [0.0, -0.5], [0.5, 0.0]]
    """
    flat, (level,) = arrays(values=(np.ravel(values), "n"), level=([level], "1"))
    if np.shape(values) not in (grid.shape, (grid.size,)):
        raise ValueError(f"values must be {grid.shape} or ({grid.size},) like the grid, got {np.shape(values)}")
    d = len(grid.shape)
    height = flat.reshape(grid.shape) - level
    if not (height < 0).any():
        return np.empty((0, d)), np.empty((0, d), dtype=np.int64)
    height = _clear_of_nodes(_surrounded(height))
    index, F = _marching_squares(height) if d == 2 else two_triangles_an_edge(*lewiner(height))
    return grid.origin + grid.spacing * (index - 1), F


def _surrounded(height: np.ndarray) -> np.ndarray:
    """One more layer of nodes on every side, outside by a thousand times the height beside it."""
    padded = 1e3 * np.abs(np.pad(height, 1, mode="edge"))
    padded[(slice(1, -1),) * height.ndim] = height
    return padded


def _clear_of_nodes(height: np.ndarray) -> np.ndarray:
    """Heights of the same sign, none so small beside a neighbour's that the surface meets the node."""
    sign = np.where(height < 0, -1.0, 1.0)
    size = np.abs(height)
    size = np.maximum(size, 1e-30 * size.max())
    while True:
        least = size.copy()
        for axis in range(height.ndim):
            here, there = np.moveaxis(least, axis, 0), _CLEARANCE * np.moveaxis(size, axis, 0)
            np.maximum(here[1:], there[:-1], out=here[1:])
            np.maximum(here[:-1], there[1:], out=here[:-1])
        # What was raised may now stand above its own neighbours; every round reaches values 1e4 times smaller.
        if np.array_equal(least, size):
            return sign * size
        size = least


def _marching_squares(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from skimage.measure import find_contours

    # Every contour is closed, because the border is outside: its last point repeats its first.
    loops = [contour[:-1] for contour in find_contours(height, 0.0, positive_orientation="low")]
    sizes = np.array([len(loop) for loop in loops])
    ends = np.cumsum(sizes)
    start = np.arange(ends[-1])
    after = start + 1
    after[ends - 1] = ends - sizes
    return np.concatenate(loops), np.stack([start, after], axis=1)


def lewiner(height: np.ndarray, *, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3), in cells, and triangles (m, 3) around negative heights at the nodes of a grid, by scikit-image.

    With a mask of nodes, in those cells only whose last node is in it.

    Examples
    --------
    >>> index, F = lewiner(np.where(np.arange(27).reshape(3, 3, 3) == 13, -1.0, 1.0))
    >>> index.shape, F.shape
    ((6, 3), (8, 3))
    """
    from skimage.measure import marching_cubes

    # scikit-image decides ambiguous cells in single precision, by products to which it adds, or compares, an absolute
    # 1e-7. At this scale that decides nothing; at a small one neighbours disagree and edges get four triangles. A
    # power of two leaves the digits as they are, so that a part of a grid is decided as the whole.
    height = np.ldexp(height, 50 - np.frexp(np.abs(height).max())[1]).astype(np.float32)
    index, F, _, _ = marching_cubes(height, 0.0, gradient_direction="descent", mask=mask)
    return index.astype(np.float64), F.astype(np.int64)


def two_triangles_an_edge(index: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with every edge between two triangles.

    Once in millions of cells two neighbours, each closed up by itself, both lay a diagonal across the square between
    them, and four triangles meet there. One cell's diagonal is bent at a new vertex, a little into that cell.
    """
    while True:
        tail, head = F.ravel(), np.roll(F, -1, axis=1).ravel()
        edge, count = np.unique(tail * len(index) + head, return_counts=True)
        if count.max() == 1:
            return index, F
        a, b = divmod(edge[count.argmax()], len(index))
        # The triangles on either side of the edge, first those of the first cell; the last two are the last cell's.
        cell = np.floor(index[F].mean(axis=1)).astype(np.int64)
        order = np.lexsort(cell.T)
        pair = []
        for start, end in ((a, b), (b, a)):
            triangle, corner = np.nonzero((F[order] == start) & (np.roll(F[order], -1, axis=1) == end))
            pair.append((order[triangle[-1]], start, end, F[order[triangle[-1]], corner[-1] - 1]))
        middle, beside = index[[a, b]].mean(axis=0), index[[across for *_, across in pair]].mean(axis=0)
        new = len(index)
        index = np.vstack([index, middle + 1e-3 * (beside - middle)])
        for triangle, start, end, across in pair:
            F[triangle] = start, new, across
            F = np.vstack([F, [new, end, across]])
