"""Root search on the forward map, compiled: one loop for each point, from every part of the body that lies there.

It computes what `nilbs.fields.search.SearchField` does by the mapping "search", in single precision, and differs in
where searches start: `nilbs.engine.lattice` instead of `nilbs.fields.overlap`.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

import numpy as np

from nilbs.engine.answer import Answer
from nilbs.engine.compiled import PROBLEM, compiled, in_pieces, inlined, threads
from nilbs.engine.distances import Distances, rest_distance
from nilbs.engine.lattice import Images, Lattice
from nilbs.engine.sorted_points import SortedPoints
from nilbs.engine.weights import Weights, columns, counted, forward, transforms

if PROBLEM is None:
    from nilbs.engine.lanes import bits, both, larger, load_at, lowest, spread, store

# Lengths are in units of the body's longest edge, as in `nilbs.fields.newton`.
ROOT = 1e-3  # a larger residual is no root
STEP = 0.1  # the longest step
SHORTER = 0.3  # a step that increases the residual is repeated, this much shorter
ITERATIONS = 6
# After a step this short from a residual below this the next would be below the precision: it is not computed.
SHORT, CLOSE = 4e-4, 4e-4
# A smaller determinant is held at this.
SMALLEST = 1e-4
# In edges of the cell: a start this close to a root finds it again, and how far from the centre a start may lie.
SAME, ASIDE = 0.4, 0.6
# The most starts of a point: those whose cells it lies deepest in.
MOST = 32
# Points that a thread takes at once: at most, and at least.
PIECE, LEAST = 2048, 256


@dataclass(frozen=True)
class SearchEngine:
    """What a search reads in every pose.

    Attributes
    ----------
    weights : Weights
    distances : Distances
    lattice : Lattice
    d : int
    width : float
        Of the step by which occupancy is read from distance.
    """

    weights: Weights
    distances: Distances
    lattice: Lattice
    d: int
    width: float
    has_distance: ClassVar[bool] = True
    has_canonical_points: ClassVar[bool] = True
    near_skin: ClassVar[bool] = True  # the surface, so that it can be searched from there

    @classmethod
    def of(cls, weights: Weights, distances: Distances, *, d: int, width: float) -> Self:
        """The engine of a character."""
        return cls(weights, distances, Lattice.of(weights, distances), d, width)

    def __call__(self, B: np.ndarray) -> "PosedSearch":
        """The engine in a pose (b, d+1, d+1) of the unit frame."""
        return PosedSearch(self, B)


class PosedSearch:
    """A search in one pose.

    Attributes
    ----------
    images_of_cells : Images
        The lattice in the pose.
    queries, evaluations : int
        Points queried so far, and look-ups of the forward map for them.
    """

    def __init__(self, engine: SearchEngine, B: np.ndarray) -> None:
        self.engine = engine
        pose = transforms(B)
        self.images_of_cells, self._B = Images.of(engine.lattice, pose), columns(counted(pose))
        self.queries = self.evaluations = 0

    def __call__(self, x: np.ndarray, to_unit: np.ndarray) -> Answer[np.ndarray]:
        """The answer at points (n, d), which the transform (d, d+1) moves into the unit frame.

        A point without a canonical point is infinitely far outside, and its canonical point is nan.
        """
        n = len(x)
        distance = np.full(n, np.inf, dtype=np.float32)
        x_rest = np.full((n, 3), np.nan, dtype=np.float32)
        self.search(x, to_unit, _search, distance, x_rest)
        return Answer(distance, distance, x_rest[:, : self.engine.d], self.engine.width)

    def search(self, x: np.ndarray, to_unit: np.ndarray, function: Callable[..., int], *more: np.ndarray) -> None:
        """Call a compiled function, which returns look-ups, for pieces of the points that lie in images of cells.

        Its arguments are those of `_search`, with `more` in the place of what that writes.
        """
        e, cells = self.engine, self.images_of_cells.cell
        points = SortedPoints.of(x, to_unit, self.images_of_cells.low, self.images_of_cells.high)
        count = len(points.number)
        piece = min(max(-(-count // threads()), LEAST), PIECE)
        looks = np.zeros(-(-count // piece), dtype=np.int64)

        def work(begin: int, end: int) -> None:
            looks[begin // piece] = function(
                points, begin, end, kept.room, e.weights, e.distances, e.lattice, cells, self._B, *more
            )

        in_pieces(work, count, piece=piece)
        self.queries += len(x)
        self.evaluations += int(looks.sum())

    def images(self, x_rest: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d) under the forward map, all in the unit frame."""
        n, d = x_rest.shape
        place, found = np.zeros((n, 3), dtype=np.float32), np.empty((n, 3), dtype=np.float32)
        place[:, :d] = x_rest
        weights = self.engine.weights

        def move(begin: int, end: int) -> None:
            _images(place, begin, end, kept.room.slots, weights, self._B, found)

        in_pieces(move, n, piece=PIECE)
        return found[:, :d]


class _Room(NamedTuple):
    """What a search writes on the way: the starts of its points, the roots of one, and lanes."""

    starts: np.ndarray
    cell: np.ndarray
    depth: np.ndarray
    at: np.ndarray
    roots: np.ndarray
    slots: np.ndarray


class _Kept(threading.local):
    """The room of each thread."""

    def __init__(self) -> None:
        self.room = _Room(
            np.empty(PIECE, dtype=np.int32),
            np.empty((PIECE, MOST), dtype=np.int32),
            np.empty((PIECE, MOST), dtype=np.float32),
            np.empty((PIECE, MOST, 3), dtype=np.float32),
            np.empty((MOST, 3), dtype=np.float32),
            np.empty((1, 4, 8), dtype=np.float32),
        )


kept = _Kept()


@compiled
def _images(place, begin, end, slots, weights, B, found):  # type: ignore[no-untyped-def]
    """Write the images of rest points."""
    for i in range(begin, end):
        x = forward(place[i, 0], place[i, 1], place[i, 2], weights, B, slots)
        found[i, 0], found[i, 1], found[i, 2] = x[0], x[1], x[2]


@compiled
def _search(points, begin, end, room, weights, distances, lattice, cells, B, distance, x_rest):  # type: ignore[no-untyped-def]
    """Search the roots of points; write the smallest distance at one and where it is, and return the look-ups."""
    n = end - begin
    find_starts(points, begin, end, lattice, cells, room)
    count, cell, at, roots, slots = room.starts, room.cell, room.at, room.roots, room.slots
    looks = 0
    for s in range(n):
        i = points.number[begin + s]
        p0, p1, p2 = points.x[begin + s], points.y[begin + s], points.z[begin + s]
        found = 0
        best = np.float32(np.inf)
        for j in range(count[s]):
            q0, q1, q2, c = at[s, j, 0], at[s, j, 1], at[s, j, 2], cell[s, j]
            if known_root(q0, q1, q2, np.float32(SAME) * lattice.edge[c, 0], roots, found):
                continue
            residual, r0, r1, r2, turned, evaluations = newton(p0, p1, p2, q0, q1, q2, weights, B, slots)
            looks += evaluations
            if residual < np.float32(ROOT):
                if not turned:  # near a root at which space is turned inside out lie others
                    roots[found, 0], roots[found, 1], roots[found, 2] = r0, r1, r2
                    found += 1
                v = rest_distance(r0, r1, r2, distances)
                if v < best:
                    best = v
                    x_rest[i, 0], x_rest[i, 1], x_rest[i, 2] = r0, r1, r2
                    if v < 0:
                        break
        distance[i] = best
    return looks


@inlined
def find_starts(points, begin, end, lattice, cells, room):  # type: ignore[no-untyped-def]
    """Write the cells whose images hold each point, the deepest first, with a rest place in each, and their number."""
    count, cell, depth, at, slots = room.starts, room.cell, room.depth, room.at, room.slots
    count[: end - begin] = 0
    n0, n1, n2 = points.shape
    scale, o0, o1, o2 = points.scale, points.origin[0], points.origin[1], points.origin[2]
    # The pieces of points are slabs of the grid.
    first0 = last0 = 0
    for i in range(n0):
        first0 = i if points.first[i * n1 * n2] <= begin else first0
        last0 = i if points.first[i * n1 * n2] < end else last0
    zero, aside = spread(np.float32(0)), np.float32(ASIDE)
    for c in range(cells.shape[0]):
        i0, i1 = max(int((cells[c, 0] - o0) * scale), first0), min(int((cells[c, 3] - o0) * scale), last0)
        if i0 > i1:
            continue
        j0, j1 = int((cells[c, 1] - o1) * scale), min(int((cells[c, 4] - o1) * scale), n1 - 1)
        k0, k1 = int((cells[c, 2] - o2) * scale), min(int((cells[c, 5] - o2) * scale), n2 - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                row = (i * n1 + j) * n2
                s, e = max(points.first[row + k0], begin), min(points.first[row + k1 + 1], end)
                while s < e:
                    x0, x1, x2 = load_at(points.x, s), load_at(points.y, s), load_at(points.z, s)
                    below = both(both(spread(cells[c, 0]) <= x0, spread(cells[c, 1]) <= x1), spread(cells[c, 2]) <= x2)
                    above = both(both(x0 <= spread(cells[c, 3]), x1 <= spread(cells[c, 4])), x2 <= spread(cells[c, 5]))
                    inside = both(below, above)
                    if not bits(inside):
                        s += 8
                        continue
                    d0, d1, d2 = x0 - spread(cells[c, 6]), x1 - spread(cells[c, 7]), x2 - spread(cells[c, 8])
                    u0 = spread(cells[c, 9]) * d0 + spread(cells[c, 10]) * d1 + spread(cells[c, 11]) * d2
                    u1 = spread(cells[c, 12]) * d0 + spread(cells[c, 13]) * d1 + spread(cells[c, 14]) * d2
                    u2 = spread(cells[c, 15]) * d0 + spread(cells[c, 16]) * d1 + spread(cells[c, 17]) * d2
                    v0, v1, v2 = larger(u0, zero - u0), larger(u1, zero - u1), larger(u2, zero - u2)
                    reached = both(
                        both(v0 <= spread(cells[c, 18]), v1 <= spread(cells[c, 19])), v2 <= spread(cells[c, 20])
                    )
                    left = bits(both(inside, reached)) & ((1 << min(e - s, 8)) - 1)
                    if left:
                        store(slots, 0, 0, u0)
                        store(slots, 0, 1, u1)
                        store(slots, 0, 2, u2)
                        store(slots, 0, 3, larger(larger(v0, v1), v2))
                    while left:
                        k = lowest(left)
                        left &= left - 1
                        here = s + k - begin
                        v = slots[0, 3, k]
                        if cells[c, 18] == np.float32(np.inf):  # flat: after those that certainly hold the point
                            v = np.float32(0.5)
                        m = count[here]
                        if m == MOST:
                            if not v < depth[here, m - 1]:
                                continue
                            m -= 1
                        count[here] = m + 1
                        # Cells come in order, so that of two as deep the earlier stays before the later.
                        while m > 0 and depth[here, m - 1] > v:
                            cell[here, m], depth[here, m] = cell[here, m - 1], depth[here, m - 1]
                            for r in range(3):
                                at[here, m, r] = at[here, m - 1, r]
                            m -= 1
                        cell[here, m], depth[here, m] = c, v
                        for r in range(3):
                            aside_by = min(max(slots[0, r, k], -aside), aside)
                            at[here, m, r] = lattice.center[c, r] + lattice.edge[c, r] * aside_by
                    s += 8


@inlined
def known_root(q0, q1, q2, same, roots, found):  # type: ignore[no-untyped-def]
    """Whether one of the roots found is as near to a place as `same`."""
    for k in range(found):
        d0, d1, d2 = q0 - roots[k, 0], q1 - roots[k, 1], q2 - roots[k, 2]
        if d0 * d0 + d1 * d1 + d2 * d2 < same * same:
            return True
    return False


@inlined
def newton(p0, p1, p2, r0, r1, r2, weights, B, slots):  # type: ignore[no-untyped-def]
    """Residual and place of the best point met, whether space is turned inside out there, and look-ups.

    See `nilbs.fields.newton.newton`.
    """
    s0 = s1 = s2 = np.float32(0)
    least = np.float32(np.inf)
    turned = False
    evaluations = 0
    for _ in range(ITERATIONS + 1):
        q0, q1, q2 = r0 + s0, r1 + s1, r2 + s2
        x0, x1, x2, a00, a01, a02, a10, a11, a12, a20, a21, a22 = forward(q0, q1, q2, weights, B, slots)
        evaluations += 1
        m0, m1, m2 = p0 - x0, p1 - x1, p2 - x2
        residual = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        if not residual < least:
            s0 *= np.float32(SHORTER)
            s1 *= np.float32(SHORTER)
            s2 *= np.float32(SHORTER)
            continue
        least, r0, r1, r2 = residual, q0, q1, q2
        c0, c1, c2 = a11 * a22 - a12 * a21, a02 * a21 - a01 * a22, a01 * a12 - a02 * a11
        det = a00 * c0 + a10 * c1 + a20 * c2
        turned = det < 0
        if abs(det) < np.float32(SMALLEST):
            det = -np.float32(SMALLEST) if turned else np.float32(SMALLEST)
        f = np.float32(1) / det
        s0 = f * (c0 * m0 + c1 * m1 + c2 * m2)
        s1 = f * ((a12 * a20 - a10 * a22) * m0 + (a00 * a22 - a02 * a20) * m1 + (a02 * a10 - a00 * a12) * m2)
        s2 = f * ((a10 * a21 - a11 * a20) * m0 + (a01 * a20 - a00 * a21) * m1 + (a00 * a11 - a01 * a10) * m2)
        length = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        if not length < np.float32(np.inf):  # a derivative beyond the precision: there is no next step
            break
        if length > np.float32(STEP):
            f = np.float32(STEP) / length
            s0 *= f
            s1 *= f
            s2 *= f
        elif residual < np.float32(CLOSE) and length < np.float32(SHORT):
            return residual, r0 + s0, r1 + s1, r2 + s2, turned, evaluations
    return least, r0, r1, r2, turned, evaluations
