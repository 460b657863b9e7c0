"""Closest places on the triangles of a tree that was fitted to a pose: `nilbs.engine.surface_tree` makes it.

Boxes and triangles are compared in float32, and all triangles that may be closest are kept, by more than float32
rounds; these are compared in float64. So the closest triangle is that of the smallest distance in float64, and among
equals that of the smallest index, in whatever order boxes are opened.
"""

from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import PROBLEM, allocating, compiled, in_pieces, inlined

if PROBLEM is None:
    from nilbs.engine.lanes import bits, both, choose, lane, larger, load, lowest, smaller, smallest, spread, store

# Several numbers in one register; nilbs.engine.lanes has the type.
Lanes = Any

# Points that a thread works on at a time.
PIECE = 2048
# By how much more than the smallest distance found that of a box or a triangle may be, against rounding; relative to
# the size of the body and the point's distance.
SLACK = 3e-6
# Points further away, in units of half the body, are treated like infinite ones; box distances stay finite up to FAR.
TOO_FAR, FAR = 1e150, 1e18
# More boxes than ever wait to be opened: seven a level, and levels grow eightfold. As many triangles may be closest
# before they are compared.
WAITING = 128


class ClosestPoints(NamedTuple):
    """Closest places on a surface.

    Attributes
    ----------
    distance : (n,) float array
        Unsigned distance, in mesh units; inf where there is no place.
    facet : (n,) int array
        The facet that holds the place; -1 where there is none.
    point, barycentric : (n, d) float arrays
        The place, in mesh units, and its weights of the facet's corners; NaN where there is none.
    """

    distance: np.ndarray
    facet: np.ndarray
    point: np.ndarray
    barycentric: np.ndarray


class Fitted(NamedTuple):
    """Boxes (nodes, 6, 8), lower corners first, triangles (leaves, 21, 8), and vertices as (vertex - centre) * scale.

    Of a triangle abc: a, b - a, c - a, the gradients of the barycentric coordinates of b and c, the unit normal, and
    one over the squared lengths of ab, ac and bc.
    """

    boxes: np.ndarray
    triangles: np.ndarray
    corners: np.ndarray
    facets: np.ndarray
    offset: int
    vertices: np.ndarray
    centre: np.ndarray
    scale: float


class _Room(NamedTuple):
    """What a search writes on the way: boxes that wait to be opened, triangles that may be closest, and four pairs."""

    squares: np.ndarray
    waiting: np.ndarray
    candidate_squares: np.ndarray
    candidates: np.ndarray
    four: np.ndarray  # points with triangles
    places: np.ndarray
    pairs: np.ndarray  # (2, 4) their numbers

    @classmethod
    def new(cls) -> Self:
        """An empty one."""
        squares, waiting = np.empty((2, WAITING), dtype=np.float32), np.empty((2, WAITING), dtype=np.int64)
        places, pairs = np.empty((1, 3, 4)), np.empty((2, 4), dtype=np.int64)
        return cls(squares[0], waiting[0], squares[1], waiting[1], np.zeros((1, 12, 4)), places, pairs)


def closest_places(fitted: Fitted, x: np.ndarray, *, within: float, coordinates: int) -> ClosestPoints:
    """Closest places to points (n, d), on all threads, with so many of their coordinates: d or 0."""
    n = len(x)
    if not len(fitted.facets):
        nowhere = np.full((n, coordinates), np.nan)
        return ClosestPoints(np.full(n, np.inf), np.full(n, -1), nowhere, nowhere.copy())
    # About as many cells as points: more cost more than they save.
    power = min(max(-(-n.bit_length() // 3), 1), 6)
    cells, order, there = np.empty(n, np.int32), np.empty(n, np.int64), np.empty((n, 3))
    in_pieces(partial(_cells, fitted.centre, fitted.scale, power, x, cells), n, piece=PIECE)
    _order(fitted.centre, fitted.scale, x, cells, 8**power, order, there)
    found = ClosestPoints(np.empty(n), np.empty(n, np.int64), *np.empty((2, n, coordinates)))

    def search(begin: int, end: int) -> None:
        _search(fitted, there, order, float(within), _Room.new(), found, begin, end)

    in_pieces(search, n, piece=PIECE)
    return found


@allocating
def _cells(
    centre: np.ndarray, scale: float, power: int, x: np.ndarray, cells: np.ndarray, begin: int, end: int
) -> None:
    """Each point's cell of a grid of 2^power in each direction around the body, along a Z-order curve."""
    side = 1 << power
    spaced = np.zeros(side, np.int64)  # the bits of a number, with two zeros after each
    for k in range(side):
        for bit in range(power):
            spaced[k] |= ((k >> bit) & 1) << (3 * bit)
    for i in range(begin, end):
        cell = 0
        for r in range(x.shape[1]):
            value = ((x[i, r] - centre[r]) * scale + 1) * (0.5 * side)
            # A number that is none lands in the first cell.
            cell |= spaced[int(min(value, side - 1.0)) if value > 0 else 0] << r
        cells[i] = cell


@allocating
def _order(
    centre: np.ndarray, scale: float, x: np.ndarray, cells: np.ndarray, count: int, order: np.ndarray, there: np.ndarray
) -> None:
    """Points in the order of their cells, and in units of half the box."""
    d = x.shape[1]
    first = np.zeros(count + 1, np.int64)
    for cell in cells:
        first[cell + 1] += 1
    for k in range(count):
        first[k + 1] += first[k]
    for i, cell in enumerate(cells):
        at = first[cell]
        order[at] = i
        first[cell] += 1
        for r in range(3):
            there[at, r] = (x[i, r] - centre[r]) * scale if r < d else 0.0


@compiled
def _search(
    fitted: Fitted, x: np.ndarray, order: np.ndarray, within: float, room: _Room, found: ClosestPoints, begin: int,
    end: int,
) -> None:  # fmt: skip
    """Closest places to points in this order; pairs of points and triangles are compared four at a time."""
    pairs, four, candidates = room.pairs, room.four, room.candidates
    limit = within * fitted.scale
    leaf, count = -1, 0
    for j in range(begin, end):
        i = order[j]
        found.facet[i], found.distance[i] = -1, np.inf
        X, Y, Z = x[j, 0], x[j, 1], x[j, 2]
        waiting, best = 0, np.float32(limit * limit)
        if abs(X) + abs(Y) + abs(Z) < TOO_FAR:  # a NaN is not less
            waiting = 1
            room.squares[0], room.waiting[0] = 0, 0
            if leaf >= 0:
                waiting = 2
                room.squares[1], room.waiting[1] = 0, len(fitted.boxes) + leaf
        first, opened = leaf, False
        while waiting > 0:
            # Until all boxes have been opened, or there is no room for more triangles.
            waiting, kept, best, leaf = _open(fitted, X, Y, Z, best, first, opened, leaf, waiting, room)
            opened = True
            bound = _bound(best, abs(X) + abs(Y) + abs(Z))
            for c in range(kept):
                if room.candidate_squares[c] > bound:
                    continue
                slot = candidates[c]
                pairs[0, count], pairs[1, count] = i, slot
                for corner in range(3):
                    vertex = fitted.corners[slot >> 3, corner, slot & 7]
                    for r in range(3):
                        four[0, 3 * corner + r, count] = fitted.vertices[vertex, r]
                four[0, 9, count], four[0, 10, count], four[0, 11, count] = X, Y, Z
                count += 1
                if count == 4:
                    _compare(fitted, room, 4, limit, found)
                    count = 0
    _compare(fitted, room, count, limit, found)
    for j in range(begin, end):
        i = order[j]
        if found.facet[i] < 0:
            for r in range(found.point.shape[1]):
                found.point[i, r] = found.barycentric[i, r] = np.nan


@inlined
def _compare(fitted: Fitted, room: _Room, count: int, limit: float, found: ClosestPoints) -> None:
    """Write the places of pairs that are closer than what was found before, or as close and of a smaller index."""
    four, places, d = room.four, room.places, found.point.shape[1]
    v, w, squared = _closest_of_four(four, 0, load(four, 0, 9), load(four, 0, 10), load(four, 0, 11))
    store(places, 0, 0, v)
    store(places, 0, 1, w)
    store(places, 0, 2, squared)
    for k in range(count):
        i, slot = room.pairs[0, k], room.pairs[1, k]
        length, facet = np.sqrt(places[0, 2, k]), fitted.facets[slot >> 3, slot & 7]
        distance = length / fitted.scale
        closer = distance < found.distance[i] or (distance == found.distance[i] and facet < found.facet[i])
        if not (closer and length <= limit):
            continue
        v_k, w_k = places[0, 0, k], places[0, 1, k]
        u_k = 1 - v_k - w_k
        found.distance[i], found.facet[i] = distance, facet
        if d == 0:
            continue
        found.barycentric[i, 0] = u_k
        found.barycentric[i, 1] = v_k if d == 3 else v_k + w_k
        if d == 3:
            found.barycentric[i, 2] = w_k
        for r in range(d):
            value = u_k * four[0, r, k] + v_k * four[0, r + 3, k] + w_k * four[0, r + 6, k]
            found.point[i, r] = fitted.centre[r] + value / fitted.scale


@inlined
def _open(
    fitted: Fitted, x: float, y: float, z: float, best: np.float32, first: int, opened: bool, leaf: int, count: int,
    room: _Room,
) -> tuple[int, int, np.float32, int]:  # fmt: skip
    """Open waiting boxes, and write the triangles that may be closest to a point.

    Returns how many boxes wait still, how many triangles there are, the smallest squared distance, and its leaf. Leaf
    `first`, which waits beside the root, is opened once only; it may have been `opened` before.
    """
    boxes, triangles, nodes = fitted.boxes, fitted.triangles, len(fitted.boxes)
    squares, waiting, candidate_squares = room.squares, room.waiting, room.candidate_squares
    X, Y, Z = _near(x), _near(y), _near(z)
    furthest = abs(x) + abs(y) + abs(z)
    bound, kept = _bound(best, furthest), 0
    while count > 0 and kept <= WAITING - 8:
        count -= 1
        if squares[count] > bound:
            continue
        i = waiting[count]
        if i < nodes:
            distances = _box_distances(boxes, i, X, Y, Z)
            near = bits(distances <= spread(bound))
            lowest_place = count
            while near:
                k = lowest(near)
                near &= near - 1
                squares[count], waiting[count] = lane(distances, k), 8 * i + k + fitted.offset
                # The nearest is opened first.
                if count > lowest_place and squares[count - 1] < squares[count]:
                    squares[count - 1], squares[count] = squares[count], squares[count - 1]
                    waiting[count - 1], waiting[count] = waiting[count], waiting[count - 1]
                count += 1
            continue
        i -= nodes
        if i == first:
            if opened:
                continue
            opened = True
        squared = _squares_of_eight(triangles, i, X, Y, Z)
        least = smallest(squared)
        if least < best:
            best, leaf = least, i
            bound = _bound(best, furthest)
        near = bits(squared <= spread(bound))
        while near:
            k = lowest(near)
            near &= near - 1
            candidate_squares[kept], room.candidates[kept] = lane(squared, k), 8 * i + k
            kept += 1
    return count, kept, best, leaf


@inlined
def _near(x: float) -> Lanes:
    """A coordinate that is compared with boxes, not so large that its square overflows."""
    return spread(np.float32(min(max(x, -FAR), FAR)))


@inlined
def _bound(squared: np.float32, furthest: float) -> np.float32:
    """A square that exceeds that of any box or triangle with a place as near as this, from a point this far out."""
    length = np.float64(np.sqrt(squared)) + SLACK * (1 + furthest)
    return np.float32(min(length * length + 1e-37, 3e38))


@inlined
def _box_distances(boxes: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distances of a point from the boxes of eight children."""
    zero = spread(np.float32(0))
    a = larger(larger(load(boxes, i, 0) - x, x - load(boxes, i, 3)), zero)
    b = larger(larger(load(boxes, i, 1) - y, y - load(boxes, i, 4)), zero)
    c = larger(larger(load(boxes, i, 2) - z, z - load(boxes, i, 5)), zero)
    return a * a + b * b + c * c


@inlined
def _squares_of_eight(t: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distances of a point from eight triangles.

    Inside a triangle it is the distance from its plane, outside that from an edge: near the border, where rounding
    decides, the two differ by no more than rounding.
    """
    qx, qy, qz = x - load(t, i, 0), y - load(t, i, 1), z - load(t, i, 2)
    ex, ey, ez = load(t, i, 3), load(t, i, 4), load(t, i, 5)
    fx, fy, fz = load(t, i, 6), load(t, i, 7), load(t, i, 8)
    v = _dot(qx, qy, qz, load(t, i, 9), load(t, i, 10), load(t, i, 11))
    w = _dot(qx, qy, qz, load(t, i, 12), load(t, i, 13), load(t, i, 14))
    off = _dot(qx, qy, qz, load(t, i, 15), load(t, i, 16), load(t, i, 17))
    zero, one = spread(np.float32(0)), spread(np.float32(1))
    inside = both(both(zero <= v, zero <= w), v + w <= one)
    squared = _square_of_edge(qx, qy, qz, ex, ey, ez, load(t, i, 18))
    squared = smaller(_square_of_edge(qx, qy, qz, fx, fy, fz, load(t, i, 19)), squared)
    squared = smaller(_square_of_edge(qx - ex, qy - ey, qz - ez, fx - ex, fy - ey, fz - ez, load(t, i, 20)), squared)
    return choose(inside, off * off, squared)


@inlined
def _square_of_edge(qx: Lanes, qy: Lanes, qz: Lanes, ex: Lanes, ey: Lanes, ez: Lanes, inverse: Lanes) -> Lanes:
    """Squared distance of q from the places t e, 0 <= t <= 1."""
    t = _dot(qx, qy, qz, ex, ey, ez) * inverse
    t = smaller(larger(t, spread(np.float32(0))), spread(np.float32(1)))
    rx, ry, rz = qx - t * ex, qy - t * ey, qz - t * ez
    return _dot(rx, ry, rz, rx, ry, rz)


@inlined
def _closest_of_four(triangles: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Closest place a + v (b - a) + w (c - a) of each of four triangles abc: v, w and the squared distance.

    Every place that is compared lies on its triangle, so that a triangle without area is no special case: where the
    division by its normal's square means nothing, one of its edges is closest.
    """
    ax, ay, az = load(triangles, i, 0), load(triangles, i, 1), load(triangles, i, 2)
    ex, ey, ez = load(triangles, i, 3) - ax, load(triangles, i, 4) - ay, load(triangles, i, 5) - az
    fx, fy, fz = load(triangles, i, 6) - ax, load(triangles, i, 7) - ay, load(triangles, i, 8) - az
    qx, qy, qz = x - ax, y - ay, z - az
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    zero, one = spread(0.0), spread(1.0)
    inverse = one / _dot(nx, ny, nz, nx, ny, nz)
    v = inverse * _dot(qx, qy, qz, fy * nz - fz * ny, fz * nx - fx * nz, fx * ny - fy * nx)
    w = inverse * _dot(qx, qy, qz, ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex)
    rx, ry, rz = qx - v * ex - w * fx, qy - v * ey - w * fy, qz - v * ez - w * fz
    squared = _dot(rx, ry, rz, rx, ry, rz)
    t, other = _closest_of_edge(qx, qy, qz, ex, ey, ez)
    keep = both(both(both(zero <= v, zero <= w), v + w <= one), squared <= other)
    v, w, squared = choose(keep, v, t), choose(keep, w, zero), choose(keep, squared, other)
    t, other = _closest_of_edge(qx, qy, qz, fx, fy, fz)
    keep = squared <= other
    v, w, squared = choose(keep, v, zero), choose(keep, w, t), choose(keep, squared, other)
    t, other = _closest_of_edge(qx - ex, qy - ey, qz - ez, fx - ex, fy - ey, fz - ez)
    keep = squared <= other
    return choose(keep, v, one - t), choose(keep, w, t), choose(keep, squared, other)


@inlined
def _closest_of_edge(qx: Lanes, qy: Lanes, qz: Lanes, ex: Lanes, ey: Lanes, ez: Lanes) -> tuple[Lanes, Lanes]:
    """Closest place t e, 0 <= t <= 1, to q, and the squared distance."""
    t = _dot(qx, qy, qz, ex, ey, ez) / _dot(ex, ey, ez, ex, ey, ez)
    t = smaller(larger(t, spread(0.0)), spread(1.0))
    rx, ry, rz = qx - t * ex, qy - t * ey, qz - t * ez
    return t, _dot(rx, ry, rz, rx, ry, rz)


@inlined
def _dot(ax: Lanes, ay: Lanes, az: Lanes, bx: Lanes, by: Lanes, bz: Lanes) -> Lanes:
    return ax * bx + ay * by + az * bz
