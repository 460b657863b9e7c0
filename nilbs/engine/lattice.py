"""Where searches start: cells of the rest pose, moved by a pose.

A cell is small enough that its image is nearly a parallelepiped, so that the inverse of one linear map takes a posed
point close to its canonical points. A point that lies in the image of no cell is far outside the body.
"""

from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import PROBLEM, allocating, compiled, in_pieces, inlined
from nilbs.engine.distances import Distances, rest_distance
from nilbs.engine.weights import Weights, columns
from nilbs.geometry.weight_blocks import ONE

if PROBLEM is None:
    from nilbs.engine.lanes import halves, lane, larger, load, smaller, spread, store, swapped

ZERO = np.float32(0)
# Corners and cells that a thread moves at a time.
PIECE = 16_384
# Cells this close to the body have starts, in units of its longest edge.
SHELL = 0.015
# Cells are divided where weights in them are farther from multilinear than this.
BENT = 0.45
# How far the image of a cell may reach beyond what its corners say: times their deviation from the linear map, and in
# edges of the cell.
STRETCH, MARGIN = 1.5, 0.1
# Of the cube around the image of a cell: a smaller volume is flat; and so is a cell whose image is shorter.
FLAT, SHORT = 1e-6, 1e-9


class Lattice(NamedTuple):
    """Cells (c) of the rest pose around the body, and the weights of their corners."""

    node: np.ndarray  # (n, 3) rest places of the corners
    first: np.ndarray  # (n + 1,) where the bones of a corner begin
    bone: np.ndarray
    weight: np.ndarray
    corner: np.ndarray  # (c, 8) nodes of each cell, the last axis running fastest
    center: np.ndarray  # (c, 3)
    edge: np.ndarray  # (c, 3)

    @classmethod
    def of(cls, weights: Weights, distances: Distances) -> Self:
        """Cells of all blocks that reach the body or come close to it, divided where weights bend."""
        m = np.array(weights.cells)
        none = np.empty((0, 3), dtype=np.int32)
        count = _divided(weights, distances, none, none, none[:, 0])
        place, size, block = np.empty((count, 3), np.int32), np.empty((count, 3), np.int32), np.empty(count, np.int32)
        _divided(weights, distances, place, size, block)
        corner = place[:, None] + size[:, None] * np.array(list(np.ndindex(2, 2, 2)))
        shape = corner.reshape(-1, 3).max(axis=0, initial=0) + 1
        flat = np.ravel_multi_index(tuple(corner.reshape(-1, 3).T), tuple(shape))
        _, one, which = np.unique(flat, return_index=True, return_inverse=True)
        at, block = corner.reshape(-1, 3)[one], block[one // 8]
        n0, n1, n2 = (at - weights.place[block]).T
        within = (n0 * (m[1] + 1) + n1) * (m[2] + 1) + n2
        bones = np.diff(weights.first)[block]
        ends = np.cumsum(bones)
        entry = np.arange(bones.sum()) - np.repeat(ends - bones, bones)
        nodes = (m + 1).prod()
        weight = weights.weight[entry + np.repeat(nodes * weights.first[block] + within * bones, bones)]
        # Outside the body weights may leave [0, 1], which would throw corners far away.
        weight = np.maximum(weight, 0).astype(np.float32)
        weight /= np.repeat(np.add.reduceat(weight, ends - bones), bones)
        kept = weight > 0
        return cls(
            (weights.origin + weights.spacing * at).astype(np.float32),
            np.append(0, np.cumsum(kept)[ends - 1]).astype(np.int32),
            weights.bone[entry + np.repeat(weights.first[block], bones)][kept],
            weight[kept],
            which.reshape(-1, 8).astype(np.int32),
            (weights.origin + weights.spacing * (place + size / 2)).astype(np.float32),
            (weights.spacing * size).astype(np.float32),
        )


class Images(NamedTuple):
    """The cells of a lattice in a pose."""

    # (c, 21) of each cell: lowest and highest corner of a box around its image; its centre; the linear map (3, 3) from
    # there into edges of the cell, zero if the image is flat; its reach in them, infinite if it is flat.
    cell: np.ndarray
    low: np.ndarray  # (3,) lowest and highest corner of a box around all
    high: np.ndarray

    @classmethod
    def of(cls, lattice: Lattice, B: np.ndarray) -> Self:
        """The cells in a pose (b, 12); a box around none is a point."""
        cells, corners = len(lattice.corner), len(lattice.node)
        if not cells:
            return cls(np.empty((0, 21), dtype=np.float32), *np.zeros((2, 3), dtype=np.float32))
        x, lanes = np.empty((corners, 1, 8), dtype=np.float32), columns(B)
        in_pieces(lambda begin, end: _pose(lattice, lanes, begin, end, x), corners, piece=PIECE)
        cell, boxes = np.empty((cells, 21), dtype=np.float32), np.empty((-(-cells // PIECE), 2, 8), dtype=np.float32)

        def move(begin: int, end: int) -> None:
            slots = np.empty((1, 7, 8), dtype=np.float32)
            _images(lattice, x, begin, end, cell, boxes, begin // PIECE, slots)

        in_pieces(move, cells, piece=PIECE)
        return cls(cell, boxes[:, 0, :3].min(axis=0), boxes[:, 1, :3].max(axis=0))


@allocating
def _divided(weights, distances, place, size, block):  # type: ignore[no-untyped-def]
    """Write the cells of blocks, halved where weights bend, as far as there is room, and return their number."""
    m0, m1, m2 = weights.cells
    count = 0
    done = np.empty((m0, m1, m2), dtype=np.bool_)
    for number in range(weights.place.shape[0]):
        done[:] = False
        edge = m0
        while edge >= 1:
            e2 = min(edge, m2)
            for i in range(0, m0, edge):
                for j in range(0, m1, edge):
                    for k in range(0, m2, e2):
                        if done[i, j, k]:
                            continue
                        far = not _is_close(weights, distances, number, i, j, k, edge, e2)
                        if not far and edge > 1 and _bend(weights, number, i, j, k, edge, e2) > BENT:
                            continue
                        done[i : i + edge, j : j + edge, k : k + e2] = True
                        if far:
                            continue
                        if count < block.shape[0]:
                            place[count, 0] = weights.place[number, 0] + i
                            place[count, 1] = weights.place[number, 1] + j
                            place[count, 2] = weights.place[number, 2] + k
                            size[count, 0], size[count, 1], size[count, 2] = edge, edge, e2
                            block[count] = number
                        count += 1
            edge //= 2
    return count


@compiled
def _is_close(weights, distances, block, i, j, k, edge, e2):  # type: ignore[no-untyped-def]
    """Whether a part of a block comes closer to the body than `SHELL`; distance changes as fast as place at most."""
    h, half = weights.spacing, np.float32(0.5)
    p0 = weights.origin[0] + h * (np.float32(weights.place[block, 0] + i) + half * np.float32(edge))
    p1 = weights.origin[1] + h * (np.float32(weights.place[block, 1] + j) + half * np.float32(edge))
    p2 = weights.origin[2] + h * (np.float32(weights.place[block, 2] + k) + half * np.float32(e2))
    diagonal = h * np.sqrt(np.float32(edge * edge + edge * edge + e2 * e2))
    return rest_distance(p0, p1, p2, distances) < half * diagonal + np.float32(SHELL)


@compiled
def _bend(weights, block, i, j, k, edge, e2):  # type: ignore[no-untyped-def]
    """How far the weights in a part of a block are from multilinear: the largest half sum of differences."""
    m0, m1, m2 = weights.cells
    bones = weights.first[block + 1] - weights.first[block]
    begin = weights.first[block] * ((m0 + 1) * (m1 + 1) * (m2 + 1))
    worst = np.float32(0)
    for a in range(edge + 1):
        for b in range(edge + 1):
            for c in range(e2 + 1):
                off = np.float32(0)
                for bone in range(bones):
                    found = np.float32(0)
                    for corner in range(8):
                        p, q, r = corner >> 2, (corner >> 1) & 1, corner & 1
                        share = np.float32((a if p else edge - a) * (b if q else edge - b) * (c if r else e2 - c))
                        node = ((i + p * edge) * (m1 + 1) + j + q * edge) * (m2 + 1) + k + r * e2
                        found += share * max(weights.weight[begin + node * bones + bone], 0)
                    node = ((i + a) * (m1 + 1) + j + b) * (m2 + 1) + k + c
                    off += abs(
                        found / np.float32(edge * edge * e2) - max(weights.weight[begin + node * bones + bone], 0)
                    )
                worst = max(worst, off)
    return worst / np.float32(2 * ONE)


@compiled
def _pose(lattice, B, begin, end, x):  # type: ignore[no-untyped-def]
    """Write the images of corners in lanes."""
    for i in range(begin, end):
        sum0 = sum1 = spread(ZERO)
        for s in range(lattice.first[i], lattice.first[i + 1]):
            b, w = lattice.bone[s], spread(lattice.weight[s])
            sum0 += w * load(B, b, 0)
            sum1 += w * load(B, b, 1)
        p0, p1, p2 = lattice.node[i, 0], lattice.node[i, 1], lattice.node[i, 2]
        found = sum0 * halves(p0, p1) + sum1 * halves(p2, np.float32(1))
        store(x, i, 0, found + swapped(found))


@compiled
def _images(lattice, x, begin, end, cell, boxes, part, found):  # type: ignore[no-untyped-def]
    """Write the box and the linear map of cells from their corners, and in boxes[part] the box of all."""
    low_of_all, high_of_all = spread(np.float32(np.inf)), spread(np.float32(-np.inf))
    half, quarter, eighth = spread(np.float32(0.5)), spread(np.float32(0.25)), spread(np.float32(0.125))
    zero = spread(ZERO)
    for c in range(begin, end):
        low = high = total = load(x, lattice.corner[c, 0], 0)
        along0 = along1 = along2 = zero - total
        for j in range(1, 8):
            v = load(x, lattice.corner[c, j], 0)
            low, high, total = smaller(low, v), larger(high, v), total + v
            along0 = along0 + v if j & 4 else along0 - v
            along1 = along1 + v if j & 2 else along1 - v
            along2 = along2 + v if j & 1 else along2 - v
        center, e0, e1, e2 = eighth * total, quarter * along0, quarter * along1, quarter * along2
        store(found, 0, 0, e0)
        store(found, 0, 1, e1)
        store(found, 0, 2, e2)
        store(found, 0, 3, center)
        extent = high - low
        widest = max(lane(extent, 0), max(lane(extent, 1), lane(extent, 2)))
        solid = _invert(found, widest)
        # The box of the corners, grown, and where it is smaller the box of the parallelepiped that the image fills.
        grow = spread(np.float32(MARGIN)) * extent + spread(np.float32(MARGIN / 2) * widest)
        low, high = low - grow, high + grow
        if solid:
            m0, m1, m2 = load(found, 0, 4), load(found, 0, 5), load(found, 0, 6)
            reach = zero
            for j in range(8):
                node = lattice.corner[c, j]
                off = load(x, node, 0) - center
                u = m0 * spread(lane(off, 0)) + m1 * spread(lane(off, 1)) + m2 * spread(lane(off, 2))
                reach = larger(reach, larger(u, zero - u))
            reach = half + spread(np.float32(STRETCH)) * larger(reach - half, zero) + spread(np.float32(MARGIN))
            far = larger(e0, zero - e0) * spread(lane(reach, 0))
            far += larger(e1, zero - e1) * spread(lane(reach, 1))
            far += larger(e2, zero - e2) * spread(lane(reach, 2))
            low, high = larger(low, center - far), smaller(high, center + far)
        else:
            reach = spread(np.float32(np.inf))
        low_of_all, high_of_all = smaller(low_of_all, low), larger(high_of_all, high)
        store(found, 0, 0, low)
        store(found, 0, 1, high)
        store(found, 0, 2, reach)
        for r in range(3):
            cell[c, r], cell[c, 3 + r], cell[c, 6 + r] = found[0, 0, r], found[0, 1, r], found[0, 3, r]
            cell[c, 9 + 3 * r], cell[c, 10 + 3 * r], cell[c, 11 + 3 * r] = (
                found[0, 4, r],
                found[0, 5, r],
                found[0, 6, r],
            )
            cell[c, 18 + r] = found[0, 2, r]
    store(boxes, part, 0, low_of_all)
    store(boxes, part, 1, high_of_all)


@inlined
def _invert(found, widest):  # type: ignore[no-untyped-def]
    """Write the columns of the inverse of a cell's linear map, zero if it is flat; return whether it is not."""
    a00, a10, a20 = found[0, 0, 0], found[0, 0, 1], found[0, 0, 2]
    a01, a11, a21 = found[0, 1, 0], found[0, 1, 1], found[0, 1, 2]
    a02, a12, a22 = found[0, 2, 0], found[0, 2, 1], found[0, 2, 2]
    c0, c1, c2 = a11 * a22 - a12 * a21, a02 * a21 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c0 + a10 * c1 + a20 * c2
    solid = abs(det) > np.float32(FLAT) * widest * widest * widest and widest > np.float32(SHORT)
    f = np.float32(1) / det if solid else ZERO
    found[0, 4, 0], found[0, 5, 0], found[0, 6, 0] = f * c0, f * c1, f * c2
    found[0, 4, 1] = f * (a12 * a20 - a10 * a22)
    found[0, 5, 1] = f * (a00 * a22 - a02 * a20)
    found[0, 6, 1] = f * (a02 * a10 - a00 * a12)
    found[0, 4, 2] = f * (a10 * a21 - a11 * a20)
    found[0, 5, 2] = f * (a01 * a20 - a00 * a21)
    found[0, 6, 2] = f * (a00 * a11 - a01 * a10)
    return solid
