"""Query points in the unit frame, sorted into a grid, so that those of a row of its cells lie side by side."""

from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import compiled, in_pieces

# About so many points share a cell, and the most cells along an edge.
SHARE, FINEST = 4, 128
# Points that a thread moves at once, and how many follow the last one, so that whole registers can be loaded.
PIECE, BEYOND = 16_384, 8


class SortedPoints(NamedTuple):
    """Points in a box, by the cells of a grid, the last axis running fastest."""

    x: np.ndarray  # (n + BEYOND,) coordinates
    y: np.ndarray
    z: np.ndarray
    number: np.ndarray  # (n,) of each point in the query
    first: np.ndarray  # (cells + 1,) where the points of each cell begin
    shape: tuple[int, int, int]
    origin: np.ndarray  # (3,)
    scale: np.float32  # cells per length

    @classmethod
    def of(cls, x: np.ndarray, to_unit: np.ndarray, low: np.ndarray, high: np.ndarray) -> Self:
        """Those of the points (n, d) that the transform (d, d+1) moves into the box from low (3,) to high (3,)."""
        n, extent = len(x), (high - low).tolist()
        edge = _edge(extent, max(n / SHARE, 1))
        shape = (int(extent[0] / edge) + 1, int(extent[1] / edge) + 1, int(extent[2] / edge) + 1)
        x, to_unit = np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(to_unit, dtype=np.float64)
        place, cell = np.empty((n, 3), dtype=np.float32), np.empty(n, dtype=np.int32)
        scale = np.float32(1 / edge)
        in_pieces(lambda begin, end: _placed(x, to_unit, low, scale, shape, begin, end, place, cell), n, piece=PIECE)
        first, number = np.zeros(shape[0] * shape[1] * shape[2] + 2, dtype=np.int32), np.empty(n, dtype=np.int32)
        there = np.zeros((3, n + BEYOND), dtype=np.float32)
        count = _sort(place, cell, first, number, there)
        return cls(there[0], there[1], there[2], number[:count], first[:-1], shape, low, scale)


def _edge(extent: list[float], cells: float) -> float:
    """The edge of so many cells that fill a box, which may be flat."""
    a, b, c = sorted(extent, reverse=True)
    edges = a / cells, (a * b / cells) ** (1 / 2), (a * b * c / cells) ** (1 / 3)
    return max(*edges, a / FINEST, 1e-6)


@compiled
def _placed(x, move, low, scale, shape, begin, end, place, cell):  # type: ignore[no-untyped-def]
    """Write points in the unit frame and the cells that they lie in, -1 outside all."""
    d = x.shape[1]
    for i in range(begin, end):
        place[i, 2] = np.float32(0)
        for r in range(d):
            v = move[r, d]
            for j in range(d):
                v += move[r, j] * x[i, j]
            place[i, r] = np.float32(v)
        f0, f1, f2 = (place[i, 0] - low[0]) * scale, (place[i, 1] - low[1]) * scale, (place[i, 2] - low[2]) * scale
        inside = f0 >= 0 and f1 >= 0 and f2 >= 0 and f0 < shape[0] and f1 < shape[1] and f2 < shape[2]
        cell[i] = (int(f0) * shape[1] + int(f1)) * shape[2] + int(f2) if inside else -1


@compiled
def _sort(place, cell, first, number, there):  # type: ignore[no-untyped-def]
    """Write points by cells, and where those of each cell begin; return how many lie in cells."""
    for i in range(cell.shape[0]):
        if cell[i] >= 0:
            first[cell[i] + 2] += 1
    for c in range(2, first.shape[0]):
        first[c] += first[c - 1]
    for i in range(cell.shape[0]):
        if cell[i] >= 0:
            at = first[cell[i] + 1]
            first[cell[i] + 1] += 1
            number[at] = i
            for r in range(3):
                there[r, at] = place[i, r]
    return first[first.shape[0] - 1]
