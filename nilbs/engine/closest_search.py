"""Closest places on the triangles of a tree that was fitted to a pose: `nilbs.engine.surface_tree` makes it.

Points are sorted, and those that are close are searched as a group: boxes are opened for all of them at once.

Boxes and triangles are compared in float32, and all triangles that may be closest are kept, by more than float32
rounds; these are compared in float64. So the closest triangle is that of the smallest distance in float64, and among
equals that of the smallest index, in whatever order boxes are opened.
"""

from functools import partial
from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import PROBLEM, allocating, compiled, in_pieces, inlined
from nilbs.engine.triangle_distances import box_distances, closest_of_four, distances_of_box, squares_of_eight

if PROBLEM is None:
    from nilbs.engine.lanes import bits, lane, largest, load, lowest, smallest, spread, store

# Points that a thread works on at a time.
PIECE = 2048
# Points that are searched together if they are close; as many as there are lanes.
GROUP = 8
# They are if the edge of their box is at most so many times that of a leaf's.
APART = 2
# By how much more than the smallest distance found that of a box or a triangle may be, against rounding; relative to
# the size of the body and the point's distance.
SLACK = 3e-6
# Points further away, in units of half the body, are treated like infinite ones; box distances stay finite up to FAR.
TOO_FAR, FAR = 1e150, 1e18
# More boxes than ever wait to be opened: seven a level, and levels grow eightfold. As many triangles may be closest
# before they are compared.
WAITING = 256


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
    candidates: np.ndarray  # (2, WAITING) points of the group with triangles
    distance: np.ndarray  # (PIECE,) of each point, and its facet
    facet: np.ndarray
    here: np.ndarray  # (8, 3) a group's points
    group: np.ndarray  # (1, 5, 8) their coordinates, the squares that others must not exceed, and the smallest
    four: np.ndarray  # points with triangles
    places: np.ndarray
    pairs: np.ndarray  # (2, 4) their numbers

    @classmethod
    def new(cls) -> Self:
        """An empty one."""
        squares, waiting = np.empty((2, WAITING), dtype=np.float32), np.empty((3, WAITING), dtype=np.int64)
        group = np.zeros((1, 5, GROUP), dtype=np.float32)
        group[0, 3] = -1  # nothing is near points that are no members
        return cls(
            squares[0], waiting[0], squares[1], waiting[1:], np.empty(PIECE), np.empty(PIECE, np.int64),
            np.zeros((GROUP, 3)), group, np.zeros((1, 12, 4)), np.empty((1, 3, 4)), np.empty((2, 4), np.int64),
        )  # fmt: skip


def closest_places(fitted: Fitted, x: np.ndarray, *, within: float, coordinates: int) -> ClosestPoints:
    """Closest places to points (n, d), on all threads, with so many of their coordinates: d or 0."""
    n = len(x)
    if not len(fitted.facets):
        nowhere = np.full((n, coordinates), np.nan)
        return ClosestPoints(np.full(n, np.inf), np.full(n, -1), nowhere, nowhere.copy())
    # About as many cells as points: more cost more than they save.
    power = min(max(-(-n.bit_length() // 3), 1), 6)
    cells, order = np.empty(n, np.int32), np.empty(n, np.int32)
    in_pieces(partial(_cells, fitted.centre, fitted.scale, power, x, cells), n, piece=PIECE)
    _order(cells, 8**power, order)
    found = ClosestPoints(np.empty(n), np.empty(n, np.int64), *np.empty((2, n, coordinates)))

    def search(begin: int, end: int) -> None:
        _search(fitted, x, order[begin:end], float(within), _Room.new(), found)

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
def _order(cells: np.ndarray, count: int, order: np.ndarray) -> None:
    """Write the points in the order of their cells."""
    first = np.zeros(count + 1, np.int32)
    for cell in cells:
        first[cell + 1] += 1
    for k in range(count):
        first[k + 1] += first[k]
    for i, cell in enumerate(cells):
        order[first[cell]] = i
        first[cell] += 1


@compiled
def _search(fitted: Fitted, x: np.ndarray, order: np.ndarray, within: float, room: _Room, found: ClosestPoints) -> None:
    """Closest places to points in this order; pairs of points and triangles are compared four at a time."""
    limit = within * fitted.scale
    leaf = count = 0
    for first in range(0, len(order), GROUP):
        members = 0
        for k in range(min(GROUP, len(order) - first)):
            i = order[first + k]
            room.facet[first + k], room.distance[first + k] = -1, np.inf
            for r in range(x.shape[1]):
                room.here[k, r] = (x[i, r] - fitted.centre[r]) * fitted.scale
            if abs(room.here[k, 0]) + abs(room.here[k, 1]) + abs(room.here[k, 2]) < TOO_FAR:  # a NaN is not less
                members |= 1 << k
                for r in range(3):
                    # Not so large that its square overflows.
                    room.group[0, r, k] = np.float32(min(max(room.here[k, r], -FAR), FAR))
        together = _are_close(fitted, room.group, members, leaf)
        while members:
            group = members if together else members & -members
            members ^= group
            leaf, count = _search_group(fitted, order, limit, room, found, first, group, leaf, count)
    _compare(fitted, order, room, count, limit, found)
    for j in range(len(order)):
        i = order[j]
        found.distance[i], found.facet[i] = room.distance[j], room.facet[j]
        if room.facet[j] < 0:
            for r in range(found.point.shape[1]):
                found.point[i, r] = found.barycentric[i, r] = np.nan


@inlined
def _are_close(fitted: Fitted, group: np.ndarray, members: int, leaf: int) -> bool:
    """Whether members of a group of points lie in a box that is not much larger than that of a leaf."""
    child = len(fitted.boxes) + leaf - fitted.offset
    apart = size = np.float32(0)
    for r in range(3):
        low, high = np.float32(FAR), np.float32(-FAR)
        for k in range(GROUP):
            if (members >> k) & 1:
                low, high = min(low, group[0, r, k]), max(high, group[0, r, k])
        apart = max(apart, high - low)
        size = max(size, fitted.boxes[child >> 3, r + 3, child & 7] - fitted.boxes[child >> 3, r, child & 7])
    return bool(apart <= APART * size)


@inlined
def _search_group(
    fitted: Fitted, order: np.ndarray, limit: float, room: _Room, found: ClosestPoints, first: int, members: int,
    leaf: int, count: int,
) -> tuple[int, int]:  # fmt: skip
    """Search the places of members, bits, of the group that begins at a point; `count` pairs wait to be compared."""
    group, pairs, four, candidates = room.group, room.pairs, room.four, room.candidates
    rest = members
    while rest:
        k = lowest(rest)
        rest &= rest - 1
        group[0, 4, k] = min(limit * limit, 3e38)
        group[0, 3, k] = _bound(group[0, 4, k], _extent(group, k))
    # The leaf that was closest before gives the first bounds.
    room.squares[0], room.waiting[0] = 0, 0
    room.squares[1], room.waiting[1] = 0, len(fitted.boxes) + leaf
    start, opened, waiting = leaf, False, 2
    while waiting > 0:
        # Until all boxes have been opened, or there is no room for more triangles.
        waiting, kept, leaf = _open(fitted, members, start, opened, leaf, waiting, room)
        opened = True
        for c in range(kept):
            k, slot = candidates[0, c], candidates[1, c]
            if room.candidate_squares[c] > group[0, 3, k]:
                continue
            pairs[0, count], pairs[1, count] = first + k, slot
            for r in range(3):
                four[0, 9 + r, count] = room.here[k, r]
                for corner in range(3):
                    four[0, 3 * corner + r, count] = fitted.vertices[fitted.corners[slot >> 3, corner, slot & 7], r]
            count += 1
            if count == 4:
                _compare(fitted, order, room, 4, limit, found)
                count = 0
    while members:
        group[0, 3, lowest(members)] = -1
        members &= members - 1
    return leaf, count


@inlined
def _compare(fitted: Fitted, order: np.ndarray, room: _Room, count: int, limit: float, found: ClosestPoints) -> None:
    """Write the places of pairs that are closer than what was found before, or as close and of a smaller index."""
    four, places, d = room.four, room.places, found.point.shape[1]
    v, w, squared = closest_of_four(four, 0, load(four, 0, 9), load(four, 0, 10), load(four, 0, 11))
    store(places, 0, 0, v)
    store(places, 0, 1, w)
    store(places, 0, 2, squared)
    for k in range(count):
        j, slot = room.pairs[0, k], room.pairs[1, k]
        length, facet = np.sqrt(places[0, 2, k]), fitted.facets[slot >> 3, slot & 7]
        distance = length / fitted.scale
        closer = distance < room.distance[j] or (distance == room.distance[j] and facet < room.facet[j])
        if not (closer and length <= limit):
            continue
        room.distance[j], room.facet[j] = distance, facet
        if d == 0:
            continue
        i = order[j]
        v_k, w_k = places[0, 0, k], places[0, 1, k]
        u_k = 1 - v_k - w_k
        found.barycentric[i, 0] = u_k
        found.barycentric[i, 1] = v_k if d == 3 else v_k + w_k
        if d == 3:
            found.barycentric[i, 2] = w_k
        for r in range(d):
            value = u_k * four[0, r, k] + v_k * four[0, r + 3, k] + w_k * four[0, r + 6, k]
            found.point[i, r] = fitted.centre[r] + value / fitted.scale


@inlined
def _open(
    fitted: Fitted, members: int, start: int, opened: bool, leaf: int, count: int, room: _Room
) -> tuple[int, int, int]:
    """Open waiting boxes, and write the triangles that may be closest to members of a group of points.

    Returns how many boxes wait still, how many triangles there are, and the last leaf that held a closer one. Leaf
    `start`, which waits beside the root, is opened once only; it may have been `opened` before.
    """
    boxes, nodes = fitted.boxes, len(fitted.boxes)
    squares, waiting, candidate_squares, group = room.squares, room.waiting, room.candidate_squares, room.group
    kept = 0
    X, Y, Z = load(group, 0, 0), load(group, 0, 1), load(group, 0, 2)
    low = group[0, 0, lowest(members)], group[0, 1, lowest(members)], group[0, 2, lowest(members)]
    high, rest = low, members
    while rest:
        k = lowest(rest)
        rest &= rest - 1
        x, y, z = group[0, 0, k], group[0, 1, k], group[0, 2, k]
        low = min(low[0], x), min(low[1], y), min(low[2], z)
        high = max(high[0], x), max(high[1], y), max(high[2], z)
    low_x, low_y, low_z = spread(low[0]), spread(low[1]), spread(low[2])
    high_x, high_y, high_z = spread(high[0]), spread(high[1]), spread(high[2])
    bound = largest(load(group, 0, 3))
    while count > 0 and kept <= WAITING - 8 * GROUP:
        count -= 1
        if squares[count] > bound:
            continue
        i = waiting[count]
        if i < nodes:
            distances = box_distances(boxes, i, low_x, low_y, low_z, high_x, high_y, high_z)
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
        if i == start:
            if opened:
                continue
            opened = True
        near = bits(distances_of_box(boxes, nodes + i - fitted.offset, X, Y, Z) <= load(group, 0, 3))
        while near:
            p = lowest(near)
            near &= near - 1
            squared = squares_of_eight(
                fitted.triangles, i, spread(group[0, 0, p]), spread(group[0, 1, p]), spread(group[0, 2, p])
            )
            least = smallest(squared)
            if least < group[0, 4, p]:
                group[0, 4, p], leaf = least, i
                group[0, 3, p] = _bound(least, _extent(group, p))
            below = bits(squared <= spread(group[0, 3, p]))
            while below:
                k = lowest(below)
                below &= below - 1
                candidate_squares[kept] = lane(squared, k)
                room.candidates[0, kept], room.candidates[1, kept] = p, 8 * i + k
                kept += 1
        bound = largest(load(group, 0, 3))
    return count, kept, leaf


@inlined
def _extent(group: np.ndarray, k: int) -> float:
    """How far out a point of a group is."""
    return abs(group[0, 0, k]) + abs(group[0, 1, k]) + abs(group[0, 2, k])


@inlined
def _bound(squared: np.float32, furthest: float) -> np.float32:
    """A square that exceeds that of any box or triangle with a place as near as this, from a point this far out."""
    length = np.float64(np.sqrt(squared)) + SLACK * (1 + furthest)
    return np.float32(min(length * length + 1e-37, 3e38))
