"""Where searches start: cells of the rest pose, moved by a pose and sorted into a grid around the posed body.

A cell is small enough that its image is nearly a parallelepiped, so that the inverse of one linear map takes a posed
point close to its canonical points. A point that lies in the image of no cell is far outside the body.
"""

from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import compiled
from nilbs.engine.distances import Distances, rest_distance
from nilbs.engine.weights import Weights
from nilbs.geometry.weight_blocks import ONE

# Cells this close to the body have starts, in units of its longest edge.
SHELL = 0.015
# Cells are divided where weights in them are farther from multilinear than this.
BENT = 0.3
# How far the image of a cell may reach beyond what its corners say: times their deviation from the linear map, and in
# edges of the cell.
STRETCH, MARGIN = 1.5, 0.1
# Of the cube around the image of a cell: a smaller volume is flat; and so is a cell whose image is shorter.
FLAT, SHORT = 1e-6, 1e-9
# In edges of a grid's cells: a wider box is kept in a coarser grid.
WIDE = 3.0
# The most cells of the finest grid around the posed body along an edge, and how many times it is coarsened.
FINEST, LEVELS = 128, 8
# Places of members are counted in 32 bits.
MOST_MEMBERS = 2**31 - 1


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
        return cls(
            (weights.origin + weights.spacing * at).astype(np.float32),
            np.concatenate([[0], ends]).astype(np.int32),
            weights.bone[entry + np.repeat(weights.first[block], bones)],
            weight,
            which.reshape(-1, 8).astype(np.int32),
            (weights.origin + weights.spacing * (place + size / 2)).astype(np.float32),
            (weights.spacing * size).astype(np.float32),
        )


class Starts(NamedTuple):
    """A lattice in a pose.

    Cells are kept in grids of doubled edges, each in the finest whose cells are not much smaller than its image.
    """

    box: np.ndarray  # (c, 6) lowest and highest corner of a box around the image of each cell
    image: np.ndarray  # (c, 15) its centre; the linear map (3, 3) from there into edges of the cell; its reach in them
    origin: np.ndarray  # (3,) of all grids
    edge: np.ndarray  # (l,) of the cells of each grid
    shape: np.ndarray  # (l, 3)
    base: np.ndarray  # (l + 1,) where the cells of each grid begin in `first`
    first: np.ndarray  # where the members of a grid's cell begin
    member: np.ndarray  # cells of the lattice
    reached: np.ndarray  # whether a cell of the finest grid, or one of a coarser grid around it, has members

    @classmethod
    def of(cls, lattice: Lattice, B: np.ndarray) -> Self:
        """The starts in a pose (b, 12)."""
        count = len(lattice.corner)
        x = np.empty((len(lattice.node), 3), dtype=np.float32)
        box, image = np.empty((count, 6), dtype=np.float32), np.empty((count, 15), dtype=np.float32)
        origin, extent = np.zeros(3, dtype=np.float32), np.zeros(3, dtype=np.float32)
        _images(lattice, B, x, box, image, origin, extent)
        finest = max(float(lattice.edge[:, 0].max(initial=0)), float(extent.max()) / FINEST, 1e-6)
        edge = (finest * 2.0 ** np.arange(LEVELS)).astype(np.float32)
        shape = (extent / edge[:, None]).astype(np.int64) + 1
        base = np.concatenate([[0], np.cumsum(shape.prod(axis=1))])
        first, level = np.zeros(base[-1] + 2, dtype=np.int32), np.empty(count, dtype=np.int32)
        reached = np.zeros(base[1], dtype=np.bool_)
        starts = cls(box, image, origin, edge, shape, base, first, np.empty(0, dtype=np.int32), reached)
        members = _count(starts, level, first)
        if members > MOST_MEMBERS:
            raise ValueError(f"the grids of rest weights have too many cells: {count}")
        member = np.empty(members, dtype=np.int32)
        _fill(starts, level, first, member)
        return starts._replace(member=member)


@compiled
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
def _images(lattice, B, x, box, image, origin, extent):  # type: ignore[no-untyped-def]
    """Pose the corners, and write the box and the linear map of every cell, and the box of all."""
    for i in range(x.shape[0]):
        p0, p1, p2 = lattice.node[i, 0], lattice.node[i, 1], lattice.node[i, 2]
        x[i, 0] = x[i, 1] = x[i, 2] = np.float32(0)
        for s in range(lattice.first[i], lattice.first[i + 1]):
            b, w = lattice.bone[s], lattice.weight[s]
            x[i, 0] += w * (B[b, 0] * p0 + B[b, 1] * p1 + B[b, 2] * p2 + B[b, 3])
            x[i, 1] += w * (B[b, 4] * p0 + B[b, 5] * p1 + B[b, 6] * p2 + B[b, 7])
            x[i, 2] += w * (B[b, 8] * p0 + B[b, 9] * p1 + B[b, 10] * p2 + B[b, 11])
    e = np.empty((3, 3), dtype=np.float32)
    for c in range(box.shape[0]):
        widest = np.float32(0)
        for r in range(3):
            low = high = x[lattice.corner[c, 0], r]
            total = along0 = along1 = along2 = np.float32(0)
            for j in range(8):
                v = x[lattice.corner[c, j], r]
                low, high = min(low, v), max(high, v)
                total += v
                along0 += v if j & 4 else -v
                along1 += v if j & 2 else -v
                along2 += v if j & 1 else -v
            image[c, r] = total / np.float32(8)
            e[r, 0], e[r, 1], e[r, 2] = along0 / np.float32(4), along1 / np.float32(4), along2 / np.float32(4)
            box[c, r], box[c, 3 + r] = low, high
            widest = max(widest, high - low)
        _invert(lattice, x, c, e, widest, image)
        for r in range(3):
            # The box of the corners, grown, and where it is smaller the box of the parallelepiped that the image fills.
            grow = np.float32(MARGIN) * (box[c, 3 + r] - box[c, r]) + np.float32(MARGIN / 2) * widest
            box[c, r] -= grow
            box[c, 3 + r] += grow
            if image[c, 12] > 0:
                far = abs(e[r, 0]) * image[c, 12] + abs(e[r, 1]) * image[c, 13] + abs(e[r, 2]) * image[c, 14]
                box[c, r] = max(box[c, r], image[c, r] - far)
                box[c, 3 + r] = min(box[c, 3 + r], image[c, r] + far)
            if c == 0 or box[c, r] < origin[r]:
                origin[r] = box[c, r]
            if c == 0 or box[c, 3 + r] > extent[r]:
                extent[r] = box[c, 3 + r]
    for r in range(3):
        extent[r] -= origin[r]


@compiled
def _invert(lattice, x, c, e, widest, image):  # type: ignore[no-untyped-def]
    """Write the inverse of a cell's linear map and how far its image reaches; of a flat cell there is none: -1."""
    c0 = e[1, 1] * e[2, 2] - e[1, 2] * e[2, 1]
    c1 = e[0, 2] * e[2, 1] - e[0, 1] * e[2, 2]
    c2 = e[0, 1] * e[1, 2] - e[0, 2] * e[1, 1]
    det = e[0, 0] * c0 + e[1, 0] * c1 + e[2, 0] * c2
    m = image[c, 3:12]
    reach = image[c, 12:15]
    if not (abs(det) > np.float32(FLAT) * widest * widest * widest and widest > np.float32(SHORT)):
        m[:] = np.float32(0)
        reach[:] = np.float32(-1)
        return
    f = np.float32(1) / det
    m[0], m[1], m[2] = f * c0, f * c1, f * c2
    m[3] = f * (e[1, 2] * e[2, 0] - e[1, 0] * e[2, 2])
    m[4] = f * (e[0, 0] * e[2, 2] - e[0, 2] * e[2, 0])
    m[5] = f * (e[0, 2] * e[1, 0] - e[0, 0] * e[1, 2])
    m[6] = f * (e[1, 0] * e[2, 1] - e[1, 1] * e[2, 0])
    m[7] = f * (e[0, 1] * e[2, 0] - e[0, 0] * e[2, 1])
    m[8] = f * (e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0])
    reach[:] = np.float32(0)
    for j in range(8):
        node = lattice.corner[c, j]
        d0, d1, d2 = x[node, 0] - image[c, 0], x[node, 1] - image[c, 1], x[node, 2] - image[c, 2]
        for r in range(3):
            reach[r] = max(reach[r], abs(m[3 * r] * d0 + m[3 * r + 1] * d1 + m[3 * r + 2] * d2))
    for r in range(3):
        half = np.float32(0.5)
        reach[r] = half + np.float32(STRETCH) * max(reach[r] - half, np.float32(0)) + np.float32(MARGIN)


@compiled
def _range(starts, c, level, r):  # type: ignore[no-untyped-def]
    """First and last cell of a grid along an axis that the box of a cell of the lattice meets."""
    inverse = np.float32(1) / starts.edge[level]
    last = starts.shape[level, r] - 1
    low = int((starts.box[c, r] - starts.origin[r]) * inverse)
    return low, min(int((starts.box[c, 3 + r] - starts.origin[r]) * inverse), last)


@compiled
def _count(starts, level, first):  # type: ignore[no-untyped-def]
    """Choose the grid of every cell, write where members of grid cells begin, one further on, and return their sum."""
    for c in range(level.shape[0]):
        b = starts.box[c]
        widest = max(b[3] - b[0], max(b[4] - b[1], b[5] - b[2]))
        level[c] = 0
        while level[c] < starts.edge.shape[0] - 1 and np.float32(WIDE) * starts.edge[level[c]] < widest:
            level[c] += 1
        g = level[c]
        (i0, i1), (j0, j1), (k0, k1) = _range(starts, c, g, 0), _range(starts, c, g, 1), _range(starts, c, g, 2)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                at = starts.base[g] + (i * starts.shape[g, 1] + j) * starts.shape[g, 2]
                for k in range(k0, k1 + 1):
                    first[at + k + 2] += 1
    total = 0
    for i in range(first.shape[0]):
        total += first[i]
        first[i] = total
    return total


@compiled
def _fill(starts, level, first, member):  # type: ignore[no-untyped-def]
    """Write the members of all grid cells, move every beginning back to its own place, and mark what is reached."""
    for c in range(level.shape[0]):
        g = level[c]
        (i0, i1), (j0, j1), (k0, k1) = _range(starts, c, g, 0), _range(starts, c, g, 1), _range(starts, c, g, 2)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                at = starts.base[g] + (i * starts.shape[g, 1] + j) * starts.shape[g, 2]
                for k in range(k0, k1 + 1):
                    member[first[at + k + 1]] = c
                    first[at + k + 1] += 1
    for g in range(starts.edge.shape[0]):
        if first[starts.base[g]] == first[starts.base[g + 1]]:
            continue
        for i in range(starts.shape[0, 0]):
            for j in range(starts.shape[0, 1]):
                at = (i * starts.shape[0, 1] + j) * starts.shape[0, 2]
                above = starts.base[g] + ((i >> g) * starts.shape[g, 1] + (j >> g)) * starts.shape[g, 2]
                for k in range(starts.shape[0, 2]):
                    inside = above + (k >> g)
                    starts.reached[at + k] |= first[inside + 1] > first[inside]
