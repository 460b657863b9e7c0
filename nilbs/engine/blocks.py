"""Levels at the nodes of a grid, in blocks of cells near a surface only.

A block has two cells along each edge. Levels are kept in bricks of eight nodes along each edge, which exist where there
are blocks, so that memory grows as the surface does. The grid has one more layer of nodes on every side, which is
outside, as `nilbs.geometry.level_sets.isosurface` has it; there, nodes are counted from that layer.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from nilbs.engine.compiled import PROBLEM, allocating, compiled, in_pieces, inlined
from nilbs.geometry.grids import Grid

if PROBLEM is None:
    from nilbs.engine.lanes import ones

# Posed points (n, d) -> levels (n,), negative inside.
Levels = Callable[[np.ndarray], np.ndarray]
# Cells along the edge of a block.
CELLS = 2
# Blocks whose nodes are queried together, and that a thread takes at once.
BATCH, PIECE = 2**15, 2**12
# Two vectors whose angle has a smaller sine span no plane.
DEGENERATE = 1e-10
# The nodes of a block are bits, the last axis running fastest: those of all, and of its faces, by axis and side.
NODES = 27
_NODE = 1 << np.arange(NODES).reshape(3, 3, 3)
FACES = np.array([[_NODE.take(side, axis).sum() for side in (0, 2)] for axis in range(3)], dtype=np.int64)


class Bricks(NamedTuple):
    """Where the levels of nodes and the numbers of blocks are."""

    number: np.ndarray  # (n_1, n_2, n_3) number of each brick, -1 for none
    level: np.ndarray  # (bricks, 8, 8, 8), nan where unknown
    block: np.ndarray  # (bricks, 4, 4, 4) number of each block, -1 for none


class Blocks:
    """Blocks around a field's surface, with the levels of their nodes.

    Attributes
    ----------
    bricks : Bricks
    corner : (n, 3) int array
        The first node of each block.
    inside : (n,) int array
        Which nodes of each block are inside, as bits.
    """

    def __init__(self, values: Levels, grid: Grid) -> None:
        self.values, self.grid = values, grid
        shape = (np.array(grid.shape) + 2) // 8 + 1
        # Nodes beyond the grid have the level of the nearest of its own, but are outside and further.
        beyond = [np.clip(np.arange(-1, 8 * n - 1), 0, size - 1) for n, size in zip(shape, grid.shape, strict=True)]
        self._axes = tuple(o + grid.spacing * i for o, i in zip(grid.origin, beyond, strict=True))
        self._count = 0
        self.bricks = Bricks(
            np.full(shape, -1, dtype=np.int32),
            np.empty((0, 8, 8, 8), dtype=np.float32),
            np.empty((0, 4, 4, 4), dtype=np.int32),
        )
        self.corner = np.empty((0, 3), dtype=np.int64)
        self.inside = np.empty(0, dtype=np.int64)

    def add(self, corner: np.ndarray) -> None:
        """Add blocks, given by their first nodes, and all others that the surface crosses into from there."""
        while len(corner):
            self._add(corner)
            first = len(self.corner) - len(corner)
            neighbours = np.empty((6 * len(corner), 3), dtype=np.int64)
            count = _crossed_into(self.corner, self.inside, first, self.bricks, FACES, neighbours)
            corner = np.unique(neighbours[:count], axis=0)

    def levels(self, node: np.ndarray) -> np.ndarray:
        """Levels (...) at nodes (..., 3) of blocks."""
        i, j, k = np.moveaxis(node, -1, 0)
        return self.bricks.level[self.bricks.number[i >> 3, j >> 3, k >> 3], i & 7, j & 7, k & 7].astype(np.float64)

    def _add(self, corner: np.ndarray) -> None:
        before, first = self._count, len(self.corner)
        self._count = _claim(corner, self.bricks.number, before)
        level, block = (_with_room(array, before, self._count) for array in self.bricks[1:])
        level[before : self._count], block[before : self._count] = np.nan, -1
        self.bricks = self.bricks._replace(level=level, block=block)
        self.corner = np.concatenate([self.corner, corner])
        self.inside = np.concatenate([self.inside, np.empty(len(corner), dtype=np.int64)])
        for begin in range(0, len(corner), BATCH):
            part = corner[begin : begin + BATCH]
            node = np.empty((NODES * len(part), 3), dtype=np.int32)
            node = node[: _unknown(part, first + begin, self.bricks, node)]
            x = np.empty((len(node), 3))
            _places(node, self._axes, x)
            levels = self.values(x)
            if not np.isfinite(levels).all():
                raise ValueError(f"levels must be finite, got {levels[~np.isfinite(levels)][0]}")
            _fill(node, np.array(self.grid.shape), levels, self.bricks)
            in_pieces(partial(_insides, part, self.bricks, self.inside[first + begin :]), len(part), piece=PIECE)


def near(U: np.ndarray, F: np.ndarray, grid: Grid, reach: float) -> np.ndarray:
    """First nodes (n, 3) of the blocks whose centre is within reach of a surface, and of few others.

    A shorter reach than half a block's diagonal counts as that: the ball around the block holds a place.
    """
    shape = (np.array(grid.shape) + CELLS) // CELLS
    marks = np.zeros((*shape[:2], shape[2] // 64 + 1), dtype=np.uint64)
    # In edges of a block; the centre of block 0 is the first node of the grid.
    edge = CELLS * grid.spacing
    _mark((U - grid.origin) / edge, F, max(3**0.5 / 2, reach / edge), shape, marks)
    corner = np.empty((_marked(marks, np.empty((0, 3), dtype=np.int64)), 3), dtype=np.int64)
    _marked(marks, corner)
    return corner


@allocating
def _mark(U, F, reach, shape, marks):  # type: ignore[no-untyped-def]
    """Mark, one bit each, the whole numbers within reach of triangles' planes that are not beyond edges by more."""
    low, high, normal, x = np.empty(3, np.int64), np.empty(3, np.int64), np.zeros(3), np.empty(3)
    beyond = np.zeros((3, 3))  # unit normals of the edges
    for f in range(F.shape[0]):
        for r in range(3):
            least = min(U[F[f, 0], r], U[F[f, 1], r], U[F[f, 2], r])
            most = max(U[F[f, 0], r], U[F[f, 1], r], U[F[f, 2], r])
            low[r] = max(math.ceil(max(least - reach, 0.0)), 0)
            high[r] = math.floor(min(most + reach, shape[r] - 1.0))
        edges = U[F[f, 1]] - U[F[f, 0]], U[F[f, 2]] - U[F[f, 1]], U[F[f, 0]] - U[F[f, 2]]
        if not _unit_normal(edges[0], edges[1], normal):
            # Without area it lies in any plane through its longest edge.
            longest = edges[0]
            for e in range(1, 3):
                if (edges[e] ** 2).sum() > (longest**2).sum():
                    longest = edges[e]
            x[:] = 0
            x[np.argmin(np.abs(longest))] = 1
            _unit_normal(longest, x, normal)
        for e in range(3):
            _unit_normal(edges[e], normal, beyond[e])
        # Along the axis nearest to the normal few places lie near the plane.
        inner = np.argmax(np.abs(normal))
        first, second = (inner + 1) % 3, (inner + 2) % 3
        p = U[F[f, 0]]
        for i in range(low[first], high[first] + 1):
            for j in range(low[second], high[second] + 1):
                begin, end = low[inner], high[inner]
                if normal[inner] != 0:
                    off = normal[first] * (i - p[first]) + normal[second] * (j - p[second])
                    middle, half = p[inner] - off / normal[inner], reach / abs(normal[inner])
                    begin, end = max(begin, math.ceil(middle - half)), min(end, math.floor(middle + half))
                for k in range(begin, end + 1):
                    x[first], x[second], x[inner] = i, j, k
                    out = False
                    for e in range(3):
                        m, q = beyond[e], F[f, e]
                        out |= m[0] * (x[0] - U[q, 0]) + m[1] * (x[1] - U[q, 1]) + m[2] * (x[2] - U[q, 2]) > reach
                    if not out:
                        z = int(x[2])
                        marks[int(x[0]), int(x[1]), z >> 6] |= np.uint64(1) << np.uint64(z & 63)


@inlined
def _unit_normal(a, b, normal):  # type: ignore[no-untyped-def]
    """Write the unit vector across two, or zero if rounding decides on it; return whether it is not."""
    n0, n1, n2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    a_squared, b_squared = a[0] ** 2 + a[1] ** 2 + a[2] ** 2, b[0] ** 2 + b[1] ** 2 + b[2] ** 2
    known = length > DEGENERATE * math.sqrt(a_squared * b_squared)
    f = 1 / length if known else 0.0
    normal[0], normal[1], normal[2] = f * n0, f * n1, f * n2
    return known


@compiled
def _marked(marks, corner):  # type: ignore[no-untyped-def]
    """Write the first nodes of marked blocks, as far as there is room, and return how many there are."""
    count = 0
    for i in range(marks.shape[0]):
        for j in range(marks.shape[1]):
            for w in range(marks.shape[2]):
                word = marks[i, j, w]
                while word:
                    k = 64 * w + ones((word & (~word + np.uint64(1))) - np.uint64(1))
                    word &= word - np.uint64(1)
                    if count < corner.shape[0]:
                        corner[count, 0], corner[count, 1], corner[count, 2] = CELLS * i, CELLS * j, CELLS * k
                    count += 1
    return count


def _with_room(array: np.ndarray, used: int, count: int) -> np.ndarray:
    """The array, or a copy in a larger one."""
    if count <= len(array):
        return array
    larger = np.empty((max(count + 64, 2 * used), *array.shape[1:]), dtype=array.dtype)
    larger[:used] = array[:used]
    return larger


@inlined
def level_at(bricks, i, j, k):  # type: ignore[no-untyped-def]
    """Level at a node."""
    return bricks.level[bricks.number[i >> 3, j >> 3, k >> 3], i & 7, j & 7, k & 7]


@inlined
def block_at(bricks, i, j, k):  # type: ignore[no-untyped-def]
    """Number of the block that a node is the first corner of, or one of whose other seven lower corners; or -1."""
    brick = bricks.number[i >> 3, j >> 3, k >> 3]
    return np.int64(bricks.block[brick, (i >> 1) & 3, (j >> 1) & 3, (k >> 1) & 3]) if brick >= 0 else -1


@compiled
def _claim(corner, number, count):  # type: ignore[no-untyped-def]
    """Number the bricks that hold nodes of blocks; return how many there are."""
    for b in range(corner.shape[0]):
        for n in range(8):
            i, j, k = corner[b, 0] + (n >> 2) * 2, corner[b, 1] + ((n >> 1) & 1) * 2, corner[b, 2] + (n & 1) * 2
            if number[i >> 3, j >> 3, k >> 3] < 0:
                number[i >> 3, j >> 3, k >> 3] = count
                count += 1
    return count


@compiled
def _unknown(corner, first, bricks, node):  # type: ignore[no-untyped-def]
    """Number blocks, write their nodes without a level and return how many there are."""
    count = 0
    for b in range(corner.shape[0]):
        c0, c1, c2 = corner[b, 0], corner[b, 1], corner[b, 2]
        bricks.block[bricks.number[c0 >> 3, c1 >> 3, c2 >> 3], (c0 >> 1) & 3, (c1 >> 1) & 3, (c2 >> 1) & 3] = first + b
        for n in range(NODES):
            i, j, k = c0 + n // 9, c1 + n // 3 % 3, c2 + n % 3
            brick = bricks.number[i >> 3, j >> 3, k >> 3]
            if np.isnan(bricks.level[brick, i & 7, j & 7, k & 7]):
                bricks.level[brick, i & 7, j & 7, k & 7] = np.inf
                node[count, 0], node[count, 1], node[count, 2] = i, j, k
                count += 1
    return count


@compiled
def _places(node, axes, x):  # type: ignore[no-untyped-def]
    """Write the places of nodes."""
    for n in range(node.shape[0]):
        x[n, 0], x[n, 1], x[n, 2] = axes[0][node[n, 0]], axes[1][node[n, 1]], axes[2][node[n, 2]]


@compiled
def _fill(node, shape, levels, bricks):  # type: ignore[no-untyped-def]
    """Write levels at nodes."""
    for n in range(node.shape[0]):
        i, j, k = node[n, 0], node[n, 1], node[n, 2]
        within = 0 < i <= shape[0] and 0 < j <= shape[1] and 0 < k <= shape[2]
        level = levels[n] if within else 1e3 * abs(levels[n])
        bricks.level[bricks.number[i >> 3, j >> 3, k >> 3], i & 7, j & 7, k & 7] = level


@compiled
def _insides(corner, bricks, inside, begin, end):  # type: ignore[no-untyped-def]
    """Write which nodes of blocks are inside."""
    for b in range(begin, end):
        inside[b] = 0
        for n in range(NODES):
            if level_at(bricks, corner[b, 0] + n // 9, corner[b, 1] + n // 3 % 3, corner[b, 2] + n % 3) < 0:
                inside[b] |= 1 << n


@compiled
def _crossed_into(corner, inside, first, bricks, faces, found):  # type: ignore[no-untyped-def]
    """Write the blocks that are none yet beyond faces that the surface crosses; return how many there are."""
    count = 0
    for b in range(first, corner.shape[0]):
        for axis in range(3):
            for side in range(2):
                face = faces[axis, side]
                if inside[b] & face == 0 or inside[b] & face == face:
                    continue
                step = 4 * side - 2
                i = corner[b, 0] + (step if axis == 0 else 0)
                j = corner[b, 1] + (step if axis == 1 else 0)
                k = corner[b, 2] + (step if axis == 2 else 0)
                if block_at(bricks, i, j, k) < 0:
                    found[count, 0], found[count, 1], found[count, 2] = i, j, k
                    count += 1
    return count
