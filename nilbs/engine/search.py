"""Root search on the forward map, compiled: one loop for each point, from every part of the body that lies there.

It computes what `nilbs.fields.search.SearchField` does by the mapping "search", in single precision, and differs in
where searches start: `nilbs.engine.lattice` instead of `nilbs.fields.overlap`.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from nilbs.engine.answer import Answer
from nilbs.engine.compiled import compiled, in_pieces, inlined
from nilbs.engine.distances import Distances, rest_distance
from nilbs.engine.lattice import Lattice, Starts
from nilbs.engine.weights import Weights, counted, forward, transforms

# Lengths are in units of the body's longest edge, as in `nilbs.fields.newton`.
ROOT = 1e-3  # a larger residual is no root
STEP = 0.1  # the longest step
SHORTER = 0.3  # a step that increases the residual is repeated, this much shorter
ITERATIONS = 6
# After a step this short from a residual below this the next would be below the precision: it is not computed.
SHORT, CLOSE = 1e-3, 1e-4
# A smaller determinant is held at this.
SMALLEST = 1e-4
# In edges of the cell: a start this close to a root finds it again, and how far from the centre a start may lie.
SAME, ASIDE = 0.4, 0.6
# The most starts of a point: those whose cells it lies deepest in.
MOST = 32
# The most cells of the lattice that are looked at for a point.
MEMBERS = 4096
# Points that a thread takes at once.
PIECE = 2048


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
    queries, evaluations : int
        Points queried so far, and look-ups of the forward map for them.
    """

    def __init__(self, engine: SearchEngine, B: np.ndarray) -> None:
        self.engine = engine
        pose = transforms(B)
        self._starts, self._B = Starts.of(engine.lattice, pose), counted(pose)
        self.queries = self.evaluations = 0

    def __call__(self, x: np.ndarray, to_unit: np.ndarray) -> Answer[np.ndarray]:
        """The answer at points (n, d), which the transform (d, d+1) moves into the unit frame.

        A point without a canonical point is infinitely far outside, and its canonical point is nan.
        """
        e, n = self.engine, len(x)
        place, key = np.empty((n, 3), dtype=np.float32), np.empty(n, dtype=np.int32)
        x, to_unit = np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(to_unit, dtype=np.float64)
        in_pieces(lambda begin, end: _placed(x, to_unit, self._starts, begin, end, place, key), n, piece=8 * PIECE)
        order = np.empty(n, dtype=np.int32)
        count = _sorted(key, int(self._starts.base[1]), order)
        distance = np.full(n, np.inf, dtype=np.float32)
        x_rest = np.full((n, 3), np.nan, dtype=np.float32)
        looks = np.zeros(-(-count // PIECE), dtype=np.int64)

        def search(begin: int, end: int) -> None:
            looks[begin // PIECE] = _search(
                place,
                key,
                order,
                begin,
                end,
                e.weights,
                e.distances,
                e.lattice,
                self._starts,
                self._B,
                distance,
                x_rest,
            )

        in_pieces(search, count, piece=PIECE)
        self.queries += n
        self.evaluations += int(looks.sum())
        return Answer(distance, distance, x_rest[:, : e.d], e.width)

    def images(self, x_rest: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d) under the forward map, all in the unit frame."""
        n, d = x_rest.shape
        place, found = np.zeros((n, 3), dtype=np.float32), np.empty((n, 3), dtype=np.float32)
        place[:, :d] = x_rest
        in_pieces(lambda begin, end: _images(place, begin, end, self.engine.weights, self._B, found), n, piece=PIECE)
        return found[:, :d]


@compiled
def _images(place, begin, end, weights, B, found):  # type: ignore[no-untyped-def]
    """Write the images of rest points."""
    for i in range(begin, end):
        x = forward(place[i, 0], place[i, 1], place[i, 2], weights, B)
        found[i, 0], found[i, 1], found[i, 2] = x[0], x[1], x[2]


@compiled
def _placed(x, move, starts, begin, end, place, key):  # type: ignore[no-untyped-def]
    """Write points in the unit frame, and their cells in the finest grid of starts, -1 outside all."""
    d = x.shape[1]
    for i in range(begin, end):
        place[i, 2] = np.float32(0)
        for r in range(d):
            v = move[r, d]
            for j in range(d):
                v += move[r, j] * x[i, j]
            place[i, r] = np.float32(v)
        at = _grid_cell(starts, 0, place[i, 0], place[i, 1], place[i, 2])
        key[i] = at if at >= 0 and starts.reached[at] else -1


@inlined
def _grid_cell(starts, level, p0, p1, p2):  # type: ignore[no-untyped-def]
    """Number of the cell of a grid that a point lies in, or -1."""
    inverse = np.float32(1) / starts.edge[level]
    f0, f1, f2 = (p0 - starts.origin[0]) * inverse, (p1 - starts.origin[1]) * inverse, (p2 - starts.origin[2]) * inverse
    n0, n1, n2 = starts.shape[level, 0], starts.shape[level, 1], starts.shape[level, 2]
    inside = f0 >= 0 and f1 >= 0 and f2 >= 0 and f0 < n0 and f1 < n1 and f2 < n2
    return starts.base[level] + (int(f0) * n1 + int(f1)) * n2 + int(f2) if inside else -1


@compiled
def _sorted(key, cells, order):  # type: ignore[no-untyped-def]
    """Write the points that have a cell by cells, and return their number."""
    first = np.zeros(cells + 1, dtype=np.int32)
    for i in range(key.shape[0]):
        if key[i] >= 0:
            first[key[i] + 1] += 1
    for c in range(cells):
        first[c + 1] += first[c]
    for i in range(key.shape[0]):
        if key[i] >= 0:
            order[first[key[i]]] = i
            first[key[i]] += 1
    return first[cells]


@compiled
def _search(place, key, order, begin, end, weights, distances, lattice, starts, B, distance, x_rest):  # type: ignore[no-untyped-def]
    """Search the roots of points; write the smallest distance at one and where it is, and return the look-ups."""
    cell, depth = np.empty(MOST, dtype=np.int32), np.empty(MOST, dtype=np.float32)
    at = np.empty((MOST, 3), dtype=np.float32)
    roots = np.empty((MOST, 3), dtype=np.float32)
    member, hit = np.empty(MEMBERS, dtype=np.int32), np.empty(MEMBERS, dtype=np.bool_)
    low, high = np.empty((3, MEMBERS), dtype=np.float32), np.empty((3, MEMBERS), dtype=np.float32)
    looks = members = 0
    here = -1
    for which in range(begin, end):
        i = order[which]
        p0, p1, p2 = place[i, 0], place[i, 1], place[i, 2]
        if key[i] != here:  # cells of coarser grids hold whole cells of the finest: what is there is the same
            here = key[i]
            members = _members(p0, p1, p2, starts, member, low, high)
        count = _candidates(p0, p1, p2, lattice, starts, members, member, low, high, hit, cell, depth, at)
        found = 0
        best = np.float32(np.inf)
        for j in range(count):
            if _known(at, j, np.float32(SAME) * lattice.edge[cell[j], 0], roots, found):
                continue
            residual, r0, r1, r2, turned, evaluations = _newton(p0, p1, p2, at[j, 0], at[j, 1], at[j, 2], weights, B)
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
def _members(p0, p1, p2, starts, member, low, high):  # type: ignore[no-untyped-def]
    """Write the cells of the lattice that the grid has where a point lies, and their boxes; return their number."""
    count = 0
    for level in range(starts.edge.shape[0]):
        g = _grid_cell(starts, level, p0, p1, p2)
        if g >= 0:
            for s in range(starts.first[g], min(starts.first[g + 1], starts.first[g] + MEMBERS - count)):
                c = starts.member[s]
                member[count] = c
                for r in range(3):
                    low[r, count], high[r, count] = starts.box[c, r], starts.box[c, 3 + r]
                count += 1
    return count


@inlined
def _candidates(p0, p1, p2, lattice, starts, members, member, low, high, hit, cell, depth, at):  # type: ignore[no-untyped-def]
    """Write the cells whose images hold a point, the deepest first, with a rest place in each; return their number."""
    for s in range(members):  # without branches, so that several are compared at once
        hit[s] = (
            (p0 >= low[0, s])
            & (p1 >= low[1, s])
            & (p2 >= low[2, s])
            & (p0 <= high[0, s])
            & (p1 <= high[1, s])
            & (p2 <= high[2, s])
        )
    count = 0
    aside = np.float32(ASIDE)
    for s in range(members):
        if not hit[s]:
            continue
        c = member[s]
        m = starts.image[c]
        d0, d1, d2 = p0 - m[0], p1 - m[1], p2 - m[2]
        u0 = m[3] * d0 + m[4] * d1 + m[5] * d2
        u1 = m[6] * d0 + m[7] * d1 + m[8] * d2
        u2 = m[9] * d0 + m[10] * d1 + m[11] * d2
        v = max(abs(u0), max(abs(u1), abs(u2)))
        if m[12] < 0:  # flat: after those that certainly hold the point
            v = np.float32(0.5)
        elif abs(u0) > m[12] or abs(u1) > m[13] or abs(u2) > m[14]:
            continue
        if count == MOST:
            if not v < depth[count - 1]:
                continue
            count -= 1
        j = count
        while j > 0 and (depth[j - 1] > v or (depth[j - 1] == v and cell[j - 1] > c)):
            cell[j], depth[j] = cell[j - 1], depth[j - 1]
            at[j, 0], at[j, 1], at[j, 2] = at[j - 1, 0], at[j - 1, 1], at[j - 1, 2]
            j -= 1
        cell[j], depth[j] = c, v
        at[j, 0] = lattice.center[c, 0] + lattice.edge[c, 0] * min(max(u0, -aside), aside)
        at[j, 1] = lattice.center[c, 1] + lattice.edge[c, 1] * min(max(u1, -aside), aside)
        at[j, 2] = lattice.center[c, 2] + lattice.edge[c, 2] * min(max(u2, -aside), aside)
        count += 1
    return count


@inlined
def _known(at, j, same, roots, found):  # type: ignore[no-untyped-def]
    """Whether one of the roots found is as near to a start as `same`."""
    for k in range(found):
        d0, d1, d2 = at[j, 0] - roots[k, 0], at[j, 1] - roots[k, 1], at[j, 2] - roots[k, 2]
        if d0 * d0 + d1 * d1 + d2 * d2 < same * same:
            return True
    return False


@inlined
def _newton(p0, p1, p2, r0, r1, r2, weights, B):  # type: ignore[no-untyped-def]
    """Residual and place of the best point met, whether space is turned inside out there, and look-ups.

    See `nilbs.fields.newton.newton`.
    """
    s0 = s1 = s2 = np.float32(0)
    least = np.float32(np.inf)
    turned = False
    evaluations = 0
    for _ in range(ITERATIONS + 1):
        q0, q1, q2 = r0 + s0, r1 + s1, r2 + s2
        x0, x1, x2, a00, a01, a02, a10, a11, a12, a20, a21, a22 = forward(q0, q1, q2, weights, B)
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
