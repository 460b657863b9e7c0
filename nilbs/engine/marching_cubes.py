"""Marching cubes in blocks of cells: what scikit-image makes of the dense grid, but for order.

In most cells signs alone decide on the triangles. Those of all signs are taken from scikit-image once; a cell in which
values decide, because its corners inside or those outside are not connected along its edges, is left to it.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from nilbs.engine.blocks import NODES, Blocks, block_at, level_at
from nilbs.engine.compiled import PROBLEM, compiled, inlined
from nilbs.geometry.level_sets import lewiner, two_triangles_an_edge

if PROBLEM is None:
    from nilbs.engine.lanes import ones

# Cells that scikit-image gets at once: 16 along each edge, so that single precision holds where vertices are.
PACKED = 16
# An edge of a cell is 3 corner + axis, from its lower corner; of the corners the last axis runs fastest.
EDGES = 24
CORNERS = np.argwhere(np.ones((2, 2, 2)))
# The part of a cell that decisions keep the surface away from a node by.
CLEARANCE = 1e-4


class Crossings(NamedTuple):
    """A surface whose vertices lie on edges of a grid, but for the last ones, which lie inside cells.

    Attributes
    ----------
    node : (n, 3) int array
        The lower end of the edge of each vertex; the first node of the cell of one inside.
    axis : (n,) int array
        The direction of the edge; -1 inside a cell.
    low, high : (n,) float arrays
        Levels at the ends of the edge.
    place : (n, 3) float array
        Where vertices lie, in cells.
    F : (m, 3) int array
        Triangles, oriented outward.
    """

    node: np.ndarray
    axis: np.ndarray
    low: np.ndarray
    high: np.ndarray
    place: np.ndarray
    F: np.ndarray


def crossings(blocks: Blocks) -> Crossings:
    """The surface in blocks; nodes are counted as there."""
    table = _table()
    n = len(blocks.corner)
    first, edges = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.uint64)
    sizes = np.zeros(3, dtype=np.int64)
    _count(blocks.inside, table, first, edges, sizes)
    vertices, triangles, undecided = sizes.tolist()
    node, axis = np.empty((vertices, 3), dtype=np.int32), np.empty(vertices, dtype=np.int8)
    ends, F = np.empty((2, vertices), dtype=np.float32), np.empty((triangles, 3), dtype=np.int64)
    cell, height = np.empty((undecided, 3), dtype=np.int32), np.empty((undecided, 8), dtype=np.float32)
    _write(blocks.corner, blocks.inside, blocks.bricks, table, first, edges, node, axis, ends, F, cell, height)
    low, high = ends.astype(np.float64)
    index = node.astype(np.float64)
    index[np.arange(vertices), axis] += low / (low - high)
    if not undecided:
        return Crossings(node, axis, low, high, index, F)
    clear = CLEARANCE * blocks.grid.spacing
    height = np.where(height < 0, np.minimum(height, -clear), np.maximum(height, clear))
    at, edge, inner, inner_at = _by_values(height)
    lower = cell[at][:, None] + CORNERS[edge // 3 % 8]
    own = np.empty(edge.shape, dtype=np.int64)
    _numbers(lower, edge % 3, blocks.bricks, first, edges, own)
    own = np.where(edge < EDGES, own, vertices + edge - EDGES)
    index = np.concatenate([index, cell[inner_at] + inner])
    # Between cells decided by signs no edge lies on a face from which another one could start.
    used, local = np.unique(own, return_inverse=True)
    bent, own = two_triangles_an_edge(index[used], local.reshape(-1, 3))
    index = np.concatenate([index, bent[len(used) :]])
    used = np.concatenate([used, np.arange(len(index) - len(bent) + len(used), len(index))])
    more = len(index) - vertices
    return Crossings(
        np.concatenate([node, np.floor(index[vertices:]).astype(np.int32)]),
        np.concatenate([axis, np.full(more, -1, dtype=np.int8)]),
        np.concatenate([low, np.zeros(more)]),
        np.concatenate([high, np.zeros(more)]),
        index,
        np.concatenate([F, used[own]]),
    )


class _Table(NamedTuple):
    """Triangles (256, most, 3) of each case, as edges of the cell, and their number (256,); -1 where values decide."""

    edges: np.ndarray
    number: np.ndarray


@cache
def _table() -> _Table:
    from scipy.ndimage import label

    case = np.arange(256)
    inside = (case[:, None] >> np.arange(8)) & 1
    number = np.zeros(256, dtype=np.int64)
    at, edge, _, _ = _by_values(1.0 - 2 * inside)
    start = np.searchsorted(at, case)
    edges = np.zeros((256, np.bincount(at).max(), 3), dtype=np.int64)
    for k in case:
        number[k] = np.count_nonzero(at == k)
        edges[k, : number[k]] = edge[start[k] : start[k] + number[k]]
        if max(label(part)[1] for part in (inside[k].reshape(2, 2, 2), 1 - inside[k].reshape(2, 2, 2))) > 1:
            number[k] = -1
    return _Table(edges, number)


def _by_values(height: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What scikit-image makes of single cells, of the levels (n, 8) at their corners.

    The cell of each triangle, in order, and its corners as edges of that; from `EDGES` on, vertices inside, of which
    places (k, 3) in the cell and cells (k,) follow.
    """
    found = []
    inner_count = 0
    for begin in range(0, len(height), PACKED**3):
        part = height[begin : begin + PACKED**3]
        slot = np.stack(np.unravel_index(np.arange(len(part)), (PACKED,) * 3), axis=1)
        volume = np.ones((2 * PACKED,) * 3)
        volume[tuple(np.moveaxis(2 * slot[:, None] + CORNERS, -1, 0))] = part
        # Cells do not touch: those between are left out.
        mask = np.zeros(volume.shape, dtype=bool)
        mask[tuple(2 * slot.T + 1)] = True
        index, F = lewiner(volume, mask=mask)
        slot = np.floor(index[F[:, 0]] / 2).astype(np.int64)
        at = np.ravel_multi_index(tuple(slot.T), (PACKED,) * 3)
        order = np.argsort(at, kind="stable")
        F, at, slot = F[order], at[order], slot[order]
        place = index[F] - 2 * slot[:, None]
        between = (place > 0) & (place < 1)
        axis = between.argmax(axis=2)
        corner = (place - between * place) @ [4, 2, 1]
        edge = (3 * corner + axis).astype(np.int64)
        is_inner = between.sum(axis=2) > 1
        vertex, where, number = np.unique(F[is_inner], return_index=True, return_inverse=True)
        edge[is_inner] = EDGES + inner_count + number
        inner_count += len(vertex)
        cells = np.broadcast_to(at[:, None], F.shape)
        found.append((begin + at, edge, place[is_inner][where], begin + cells[is_inner][where]))
    at, edge, inner, inner_at = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return at, edge, inner, inner_at


@inlined
def _case(inside, n):  # type: ignore[no-untyped-def]
    """Which corners of cell n of a block are inside, as bits."""
    first = (n >> 2) * 9 + ((n >> 1) & 1) * 3 + (n & 1)
    s = inside >> first
    return (s & 3) | ((s >> 1) & 12) | ((s >> 5) & 48) | ((s >> 6) & 192)


@inlined
def _vertex(bricks, first, edges, i, j, k, axis):  # type: ignore[no-untyped-def]
    """Number of the vertex on an edge."""
    b = block_at(bricks, i, j, k)
    bit = 3 * ((i & 1) * 4 + (j & 1) * 2 + (k & 1)) + axis
    return first[b] + ones(edges[b] & ((np.uint64(1) << np.uint64(bit)) - np.uint64(1)))


@compiled
def _count(inside, table, first, edges, sizes):  # type: ignore[no-untyped-def]
    """Write where the vertices of each block begin and which of its own edges have one; add up what there is."""
    for b in range(inside.shape[0]):
        s = inside[b]
        first[b], edges[b] = sizes[0], 0
        if s == 0 or s == (1 << NODES) - 1:
            continue
        for n in range(8):
            bit = (n >> 2) * 9 + ((n >> 1) & 1) * 3 + (n & 1)
            step = 9
            for axis in range(3):
                if ((s >> bit) ^ (s >> (bit + step))) & 1:
                    edges[b] |= np.uint64(1) << np.uint64(3 * n + axis)
                    sizes[0] += 1
                step //= 3
            number = table.number[_case(s, n)]
            if number < 0:
                sizes[2] += 1
            else:
                sizes[1] += number


@compiled
def _write(corner, inside, bricks, table, first, edges, node, axis, ends, F, cell, height):  # type: ignore[no-untyped-def]
    """Write vertices, triangles, and cells in which values decide."""
    v = m = u = 0
    for b in range(inside.shape[0]):
        s = inside[b]
        if s == 0 or s == (1 << NODES) - 1:
            continue
        for n in range(8):
            i, j, k = corner[b, 0] + (n >> 2), corner[b, 1] + ((n >> 1) & 1), corner[b, 2] + (n & 1)
            for a in range(3):
                if (edges[b] >> np.uint64(3 * n + a)) & np.uint64(1):
                    node[v, 0], node[v, 1], node[v, 2], axis[v] = i, j, k, a
                    ends[0, v] = level_at(bricks, i, j, k)
                    ends[1, v] = level_at(bricks, i + (a == 0), j + (a == 1), k + (a == 2))
                    v += 1
            case = _case(s, n)
            for t in range(table.number[case]):
                for r in range(3):
                    e = table.edges[case, t, r]
                    c = e // 3
                    F[m, r] = _vertex(bricks, first, edges, i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1), e - 3 * c)
                m += 1
            if table.number[case] < 0:
                cell[u, 0], cell[u, 1], cell[u, 2] = i, j, k
                for c in range(8):
                    height[u, c] = level_at(bricks, i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1))
                u += 1


@compiled
def _numbers(node, axis, bricks, first, edges, number):  # type: ignore[no-untyped-def]
    """Write the numbers of vertices on edges; of those that are none, anything."""
    for m in range(node.shape[0]):
        for r in range(3):
            number[m, r] = _vertex(bricks, first, edges, node[m, r, 0], node[m, r, 1], node[m, r, 2], axis[m, r])
