"""Regular grids of nodes with one spacing, in two and three dimensions."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nilbs.geometry.validation import arrays

# Of a grid given by its resolution: more cells than this are a mistake, and would fill the memory.
MOST_CELLS = 2**31


@dataclass(frozen=True)
class Grid:
    """Nodes at ``origin + spacing * index``; the last index runs fastest ("ij" order).

    Parameters
    ----------
    origin : (d,) float array
        The node of index 0, in mesh units; d is 2 or 3.
    spacing : float
        Edge of a cell, in mesh units; positive.
    shape : tuple of d ints
        Number of nodes along each axis, at least 1.

    Raises
    ------
    ValueError
        If d is neither 2 nor 3, the spacing is not positive or the shape does not fit.

    Examples
    --------
    >>> grid = Grid([0.0, 0.0], 0.5, (2, 3))
    >>> grid.points()[:4].tolist()
    [[0.0, 0.0], [0.0, 0.5], [0.0, 1.0], [0.5, 0.0]]
    >>> grid.upper
    array([0.5, 1. ])
    """

    origin: np.ndarray
    spacing: float
    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        (origin,) = arrays(origin=(self.origin, "d"))
        shape = tuple(int(size) for size in self.shape)
        if len(shape) != len(origin) or min(shape) < 1:
            raise ValueError(f"shape must hold d = {len(origin)} positive numbers, got {self.shape}")
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise ValueError(f"spacing must be positive, got {self.spacing}")
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "spacing", float(self.spacing))
        object.__setattr__(self, "shape", shape)

    @classmethod
    def cube(cls, V: np.ndarray, resolution: int, *, scale: float = 1.1) -> "Grid":
        """The cube (in 2D the square) around a bounding box.

        Parameters
        ----------
        V : (n, d) float array
            Points, in mesh units, at least one.
        resolution : int
            Cells along each edge.
        scale : float, optional
            Edge of the cube, in longest edges of the bounding box of V.

        Returns
        -------
        grid : Grid
            Centred on the bounding box.

        Raises
        ------
        ValueError
            If all points coincide, the scale is not positive, or the resolution is not positive or too large.

        Examples
        --------
        >>> Grid.cube([[0, 0], [2, 1]], 4, scale=2.0)
        Grid(origin=array([-1. , -1.5]), spacing=1.0, shape=(5, 5))
        """
        lower, upper, longest = _bounding_box(V)
        _check_resolution(resolution, len(lower))
        edge = scale * longest
        return cls((lower + upper) / 2 - edge / 2, edge / resolution, (resolution + 1,) * len(lower))

    @classmethod
    def box(cls, V: np.ndarray, resolution: int, *, pad: float = 0.05) -> "Grid":
        """The padded bounding box, cut into cubic cells.

        Parameters
        ----------
        V : (n, d) float array
            Points, in mesh units, at least one.
        resolution : int
            Cells along the longest edge of the padded box; shorter edges have fewer, rounded up.
        pad : float, optional
            Margin on every side, in longest edges of the bounding box of V.

        Returns
        -------
        grid : Grid
            Centred on the bounding box; it covers the padded box.

        Raises
        ------
        ValueError
            If all points coincide, pad is negative, or the resolution is not positive or too large.

        Examples
        --------
        >>> Grid.box([[0, 0], [2, 1]], 4, pad=0.0)
        Grid(origin=array([0., 0.]), spacing=0.5, shape=(5, 3))
        """
        lower, upper, longest = _bounding_box(V)
        _check_resolution(resolution, len(lower))
        if pad < 0:
            raise ValueError(f"pad must not be negative, got {pad}")
        spacing = longest * (1 + 2 * pad) / resolution
        edges = upper - lower + 2 * pad * longest
        # Without the tolerance a rounding error in the longest edge would add a cell.
        cells = np.maximum(np.ceil(edges / spacing - 1e-9), 1).astype(int)
        return cls((lower + upper) / 2 - spacing * cells / 2, spacing, tuple(int(count) + 1 for count in cells))

    @property
    def lower(self) -> np.ndarray:
        """The first node (d,), in mesh units."""
        return self.origin

    @property
    def upper(self) -> np.ndarray:
        """The last node (d,), in mesh units."""
        return self.origin + self.spacing * (np.array(self.shape) - 1)

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape))

    def points(self) -> np.ndarray:
        """All nodes (size, d); ``values.reshape(grid.shape)`` gives values at these points their place."""
        return self.nodes(np.arange(self.size))

    def nodes(self, index: np.ndarray) -> np.ndarray:
        """Nodes (s, d) of indices (s,) among :meth:`points`."""
        return self.origin + self.spacing * np.stack(np.unravel_index(index, self.shape), axis=-1)

    def chunks(self, size: int) -> Iterator[tuple[slice, np.ndarray]]:
        """All nodes in pieces of at most `size`, each after its slice among :meth:`points`."""
        if size < 1:
            raise ValueError(f"size must be positive, got {size}")
        for start in range(0, self.size, size):
            stop = min(start + size, self.size)
            yield slice(start, stop), self.nodes(np.arange(start, stop))


def cell_corners(values: np.ndarray, d: int) -> list[np.ndarray]:
    """Values at the first, second and so on corner of every cell, as views; the last d axes are the grid's."""
    sides, leading = (slice(None, -1), slice(1, None)), (slice(None),) * (values.ndim - d)
    return [values[leading + tuple(sides[side] for side in corner)] for corner in np.ndindex(*(2,) * d)]


def _bounding_box(V: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    (V,) = arrays(V=(V, "n d"))
    if not len(V):
        raise ValueError("V is empty: it has no bounding box")
    lower, upper = V.min(axis=0), V.max(axis=0)
    longest = float((upper - lower).max())
    if longest == 0:
        raise ValueError("all points of V coincide: its bounding box has no extent")
    return lower, upper, longest


def _check_resolution(resolution: int, d: int) -> None:
    if not isinstance(resolution, int | np.integer) or not 1 <= resolution <= MOST_CELLS ** (1 / d):
        most = int(MOST_CELLS ** (1 / d))
        raise ValueError(f"resolution must be a whole number from 1 to {most} in {d} dimensions, got {resolution!r}")
