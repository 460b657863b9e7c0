"""Closest points on a posed surface: a tree of boxes that is built once at rest and fitted to every pose.

A node has eight children, whose boxes are compared with a point at once; a leaf has four triangles. An edge of the
plane is a triangle with two equal corners, in the plane z = 0. Every level is full, so that children are found by
counting: child k of node i is node 8 i + k + offset, and leaves are numbered after the nodes.

The tree works in float64 in units of half the posed box, except for boxes, which are float32 and are given the
benefit of the doubt by more than float32 rounds. So the closest triangle is that of the smallest computed distance,
and among equals that of the smallest index, in whatever order boxes are opened.
"""

from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import PROBLEM, allocating, compiled, in_pieces, inlined
from nilbs.geometry.validation import arrays

if PROBLEM is None:
    from nilbs.engine.lanes import bits, both, choose, lane, larger, load, lowest, smaller, smallest, spread, store

# Several numbers in one register; nilbs.engine.lanes has the type.
Lanes = Any

# Leaves, nodes and points that a thread works on at a time.
PIECE = 2048
# What boxes are moved closer by, against rounding; relative to the size of the body and the point's distance.
SLACK = 5e-7
# Points further away, in units of half the body, are treated like infinite ones; box distances stay finite up to FAR.
TOO_FAR, FAR = 1e150, 1e18
# More boxes than ever wait to be opened: seven a level, and levels grow eightfold.
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


class _Tree(NamedTuple):
    """What all poses share: corners (leaves, 3, 4) as indices of vertices, facets (leaves, 4), vertices in use."""

    corners: np.ndarray
    facets: np.ndarray
    used: np.ndarray
    offset: int


class _Fitted(NamedTuple):
    """Boxes (nodes, 6, 8), lower corners first, and triangles (leaves, 9, 4), as (vertex - centre) * scale."""

    boxes: np.ndarray
    triangles: np.ndarray
    facets: np.ndarray
    offset: int
    centre: np.ndarray
    scale: float


class _Room(NamedTuple):
    """What a search writes on the way: boxes that wait to be opened, and four points with their closest triangles."""

    squares: np.ndarray
    waiting: np.ndarray
    four: np.ndarray
    places: np.ndarray

    @classmethod
    def new(cls) -> Self:
        """An empty one."""
        return cls(
            np.empty(WAITING, dtype=np.float32), np.empty(WAITING, dtype=np.int64), np.zeros((1, 12, 4)),
            np.empty((1, 3, 4)),
        )  # fmt: skip


class SurfaceTree:
    """A surface, prepared for closest points in any pose.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Rest vertices and facets: edges in the plane, triangles in space. The rest shape decides which triangles share
        a box, never the answers.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex or a number is not finite.
    """

    def __init__(self, V: np.ndarray, F: np.ndarray) -> None:
        V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
        self.n, self.d = V.shape
        leaves, offset, self._levels = _shape(-(-len(F) // 4))
        E = np.ascontiguousarray(F if self.d == 3 else F[:, [0, 1, 1]])
        order = np.arange(len(E))
        middles = np.zeros((len(E), 3))
        middles[:, : self.d] = V[E].sum(axis=1)
        _sort_facets(middles, order, leaves)
        corners, facets = np.empty((leaves, 3, 4), np.int32), np.empty((leaves, 4), np.int64)
        _fill(E, order, corners, facets)
        self._tree = _Tree(corners, facets, np.flatnonzero(np.bincount(E.ravel())), offset)

    def posed(self, U: np.ndarray) -> "PosedSurface":
        """The surface in a pose.

        Parameters
        ----------
        U : (n, d) float array
            Posed vertices, in mesh units.

        Raises
        ------
        ValueError
            If U is not (n, d) or a number is not finite.
        """
        (U,) = arrays(U=(U, f"{self.n} {self.d}"))
        U, tree = np.ascontiguousarray(U), self._tree
        leaves, nodes = len(tree.facets), self._levels[-1]
        centre, scale = _frame(U, tree.used)
        boxes, triangles = np.empty((nodes, 6, 8), np.float32), np.empty((leaves, 9, 4))
        fitted = _Fitted(boxes, triangles, tree.facets, tree.offset, centre, scale)
        if leaves:
            boxes[0, :3], boxes[0, 3:] = np.inf, -np.inf  # children that the root lacks
        in_pieces(partial(_fit_leaves, fitted, tree, U), leaves, piece=PIECE)
        for begin, end in zip(self._levels[-2:0:-1], self._levels[:1:-1], strict=True):
            in_pieces(partial(_fit_nodes, fitted, begin), end - begin, piece=PIECE)
        return PosedSurface(fitted, self.d)


class PosedSurface:
    """A surface in a pose; made by `SurfaceTree.posed`. Several threads may use it at once."""

    def __init__(self, fitted: _Fitted, d: int) -> None:
        self._fitted, self._d = fitted, d

    def closest(self, x: np.ndarray, *, within: float = np.inf) -> ClosestPoints:
        """Closest place to each point, on all threads; `nilbs.geometry.distance.closest_points` is the twin.

        Parameters
        ----------
        x : (n, d) float array
            Query points, in mesh units.
        within : float
            Places further away than this are not searched, which is faster.

        Returns
        -------
        places : ClosestPoints
            Each depends on its point and the pose alone. A surface without facets, a point without a place within
            reach and one that is not finite have none.

        Raises
        ------
        ValueError
            If x is not (n, d).

        Notes
        -----
        Points are sorted along a Z-order curve [1]_, so that the next one opens boxes that are in the processor's
        cache; the triangles closest to the previous point give the first bound.

        References
        ----------
        .. [1] Morton, A computer oriented geodetic data base and a new technique in file sequencing, IBM, 1966.
        """
        x = np.ascontiguousarray(x, dtype=np.float64)
        n, d, fitted = len(x), self._d, self._fitted
        if x.ndim != 2 or x.shape[1] != d:
            raise ValueError(f"x must be (n, d) = (n, {d}), got {x.shape}")
        if not len(fitted.facets):
            nowhere = np.full((n, d), np.nan)
            return ClosestPoints(np.full(n, np.inf), np.full(n, -1), nowhere, nowhere.copy())
        # About as many cells as points: more cost more than they save.
        power = min(max(n.bit_length() // 3, 1), 6)
        cells, order = np.empty(n, np.int32), np.empty(n, np.int64)
        in_pieces(partial(_cells, fitted.centre, fitted.scale, power, x, cells), n, piece=PIECE)
        _order(cells, 8**power, order)
        found = ClosestPoints(np.empty(n), np.empty(n, np.int64), np.empty((n, d)), np.empty((n, d)))

        def search(begin: int, end: int) -> None:
            _search(fitted, x, order, float(within), _Room.new(), found, begin, end)

        in_pieces(search, n, piece=PIECE)
        return found


# --------------------------------------------------------------------------------------------------- the tree at rest


def _shape(count: int) -> tuple[int, int, list[int]]:
    """The smallest full tree with so many leaves: its leaves, its offset and where each level of nodes begins and ends.

    Only the root may have fewer than eight children; they are its last.
    """
    below = 1
    while 8 * below < count:
        below *= 8
    children = -(-count // below)
    levels, size = [0, min(count, 1)], children
    while size < children * below:
        levels.append(levels[-1] + size)
        size *= 8
    return children * below, children - 7, levels


@allocating
def _sort_facets(middles: np.ndarray, order: np.ndarray, leaves: int) -> None:
    """Sort facets so that those of leaf i, and those below every node, are neighbours in space.

    Leaf i has those from m i / leaves to m (i + 1) / leaves. Ranges are halved across their longest side.
    """
    m = len(order)
    waiting = [(0, leaves)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        below = 1
        while 8 * below < last - first:
            below *= 8
        middle = first + below * (((last - first) // below + 1) // 2)
        begin, end = m * first // leaves, m * last // leaves
        axis, longest = 0, -1.0
        for r in range(3):
            low = high = middles[begin, r]
            for i in range(begin + 1, end):
                low, high = min(low, middles[i, r]), max(high, middles[i, r])
            if high - low > longest:
                axis, longest = r, high - low
        _select(middles, order, axis, begin, end, m * middle // leaves)
        waiting.append((first, middle))
        waiting.append((middle, last))


@compiled
def _select(middles: np.ndarray, order: np.ndarray, axis: int, begin: int, end: int, rank: int) -> None:
    """Quickselect: the row of this rank along an axis to its place, no greater ones before it, no smaller behind."""
    while end - begin > 1:
        a, b, c = middles[begin, axis], middles[(begin + end) // 2, axis], middles[end - 1, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = begin, end - 1
        while i <= j:
            while middles[i, axis] < pivot:
                i += 1
            while middles[j, axis] > pivot:
                j -= 1
            if i <= j:
                for r in range(3):
                    middles[i, r], middles[j, r] = middles[j, r], middles[i, r]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if rank <= j:
            end = j + 1
        elif rank >= i:
            begin = i
        else:
            return


@allocating
def _fill(E: np.ndarray, order: np.ndarray, corners: np.ndarray, facets: np.ndarray) -> None:
    """Give each leaf its facets, by index; the last one fills what is left of four."""
    m, leaves = len(order), len(facets)
    for i in range(leaves):
        begin, end = m * i // leaves, m * (i + 1) // leaves
        own = np.sort(order[begin:end])
        for k in range(4):
            facets[i, k] = own[min(k, end - begin - 1)]
            for c in range(3):
                corners[i, c, k] = E[facets[i, k], c]


# ---------------------------------------------------------------------------------------------------- fitting to a pose


@allocating
def _frame(U: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre of the box of the vertices in use, and one over half its longest edge."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in used:
        for r in range(U.shape[1]):
            low[r], high[r] = min(low[r], U[i, r]), max(high[r], U[i, r])
    centre, half = np.zeros(3), 0.0
    for r in range(U.shape[1]):
        centre[r] = 0.5 * low[r] + 0.5 * high[r]
        half = max(half, 0.5 * high[r] - 0.5 * low[r])
    return centre, 1 / half if half > 1e-300 else 1.0


@compiled
def _fit_leaves(fitted: _Fitted, tree: _Tree, U: np.ndarray, begin: int, end: int) -> None:
    """Copy the triangles of leaves begin .. end-1, and write their boxes to their parents."""
    nodes, d = len(fitted.boxes), U.shape[1]
    for i in range(begin, end):
        child = nodes + i - fitted.offset
        for r in range(3):
            low, high = np.inf, -np.inf
            for c in range(3):
                for k in range(4):
                    value = (U[tree.corners[i, c, k], r] - fitted.centre[r]) * fitted.scale if r < d else 0.0
                    fitted.triangles[i, 3 * c + r, k] = value
                    low, high = min(low, value), max(high, value)
            fitted.boxes[child >> 3, r, child & 7] = low
            fitted.boxes[child >> 3, r + 3, child & 7] = high


@compiled
def _fit_nodes(fitted: _Fitted, first: int, begin: int, end: int) -> None:
    """Write the boxes of nodes first + begin .. first + end-1 to their parents."""
    boxes = fitted.boxes
    for i in range(first + begin, first + end):
        child = i - fitted.offset
        for r in range(3):
            low, high = boxes[i, r, 0], boxes[i, r + 3, 0]
            for k in range(1, 8):
                low, high = min(low, boxes[i, r, k]), max(high, boxes[i, r + 3, k])
            boxes[child >> 3, r, child & 7] = low
            boxes[child >> 3, r + 3, child & 7] = high


# --------------------------------------------------------------------------------------------------- sorting of points


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
    """Points in the order of their cells."""
    first = np.zeros(count + 1, np.int64)
    for cell in cells:
        first[cell + 1] += 1
    for k in range(count):
        first[k + 1] += first[k]
    for i, cell in enumerate(cells):
        order[first[cell]] = i
        first[cell] += 1


# -------------------------------------------------------------------------------------------------------------- search


@compiled
def _search(
    fitted: _Fitted, x: np.ndarray, order: np.ndarray, within: float, room: _Room, found: ClosestPoints, begin: int,
    end: int,
) -> None:  # fmt: skip
    """Closest places to points in this order; four are evaluated at a time, once their triangles have been found."""
    squares, waiting, four, places = room.squares, room.waiting, room.four, room.places
    slot, count = -1, 0
    for j in range(begin, end):
        i = order[j]
        for r in range(x.shape[1]):
            four[0, 9 + r, count] = (x[i, r] - fitted.centre[r]) * fitted.scale
        X, Y, Z = four[0, 9, count], four[0, 10, count], four[0, 11, count]
        slot = _nearest(fitted, X, Y, Z, within * fitted.scale, slot, squares, waiting)
        if slot >= 0:
            found.facet[i] = fitted.facets[slot >> 2, slot & 3]
            for r in range(9):
                four[0, r, count] = fitted.triangles[slot >> 2, r, slot & 3]
        else:
            found.facet[i] = -1
        count += 1
        if count == 4 or j == end - 1:
            v, w, squared = _closest_of_four(four, 0, load(four, 0, 9), load(four, 0, 10), load(four, 0, 11))
            store(places, 0, 0, v)
            store(places, 0, 1, w)
            store(places, 0, 2, squared)
            for k in range(count):
                _write(fitted, four, places, k, order[j - count + 1 + k], found)
            count = 0


@inlined
def _write(fitted: _Fitted, four: np.ndarray, places: np.ndarray, k: int, i: int, found: ClosestPoints) -> None:
    d = found.point.shape[1]
    if found.facet[i] < 0:
        found.distance[i] = np.inf
        for r in range(d):
            found.point[i, r] = found.barycentric[i, r] = np.nan
        return
    v, w = places[0, 0, k], places[0, 1, k]
    u = 1 - v - w
    found.distance[i] = np.sqrt(places[0, 2, k]) / fitted.scale
    found.barycentric[i, 0] = u
    found.barycentric[i, 1] = v if d == 3 else v + w
    if d == 3:
        found.barycentric[i, 2] = w
    for r in range(d):
        value = u * four[0, r, k] + v * four[0, r + 3, k] + w * four[0, r + 6, k]
        found.point[i, r] = fitted.centre[r] + value / fitted.scale


@inlined
def _nearest(
    fitted: _Fitted, x: float, y: float, z: float, within: float, start: int, squares: np.ndarray, waiting: np.ndarray
) -> int:
    """The triangle closest to a point, as 4 leaf + k, or -1; the leaf of triangle `start` is opened first."""
    furthest = abs(x) + abs(y) + abs(z)
    boxes, triangles, facets, nodes = fitted.boxes, fitted.triangles, fitted.facets, len(fitted.boxes)
    box_x, box_y, box_z = _near(x), _near(y), _near(z)
    X, Y, Z = spread(x), spread(y), spread(z)
    slack = SLACK * (1 + furthest)
    best, slot = within * within, -1
    bound = _bound(best, slack)
    squares[0], waiting[0] = 0, 0
    # A NaN is not less. There is no early return: with one, numba counts references to the arrays in every call.
    count = 1 if furthest < TOO_FAR else 0
    if start >= 0 and count:
        squares[1], waiting[1], count = 0, nodes + (start >> 2), 2
    while count > 0:
        count -= 1
        if squares[count] >= bound:
            continue
        i = waiting[count]
        if i < nodes:
            distances = _box_distances(boxes, i, box_x, box_y, box_z)
            near = bits(distances < spread(bound))
            first = count
            while near:
                k = lowest(near)
                near &= near - 1
                squares[count], waiting[count] = lane(distances, k), 8 * i + k + fitted.offset
                # The nearest is opened first.
                if count > first and squares[count - 1] < squares[count]:
                    squares[count - 1], squares[count] = squares[count], squares[count - 1]
                    waiting[count - 1], waiting[count] = waiting[count], waiting[count - 1]
                count += 1
            continue
        i -= nodes
        _, _, squared = _closest_of_four(triangles, i, X, Y, Z)
        least = smallest(squared)
        if least <= best:
            k = lowest(bits(squared <= spread(least)))
            if least < best or slot < 0 or facets[i, k] < facets[slot >> 2, slot & 3]:
                slot = 4 * i + k
            if least < best:
                best = least
                bound = _bound(best, slack)
    return slot


@inlined
def _near(x: float) -> Lanes:
    """A coordinate that is compared with boxes, not so large that its square overflows."""
    return spread(np.float32(min(max(x, -FAR), FAR)))


@inlined
def _bound(squared: float, slack: float) -> np.float32:
    """A square that exceeds that of any box with a place as near as this."""
    length = np.sqrt(squared) + slack
    return np.float32(min(length * length * (1 + 1e-6) + 1e-37, 3e38))


@inlined
def _box_distances(boxes: np.ndarray, i: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distances of a point from the boxes of eight children."""
    zero = spread(np.float32(0))
    a = larger(larger(load(boxes, i, 0) - x, x - load(boxes, i, 3)), zero)
    b = larger(larger(load(boxes, i, 1) - y, y - load(boxes, i, 4)), zero)
    c = larger(larger(load(boxes, i, 2) - z, z - load(boxes, i, 5)), zero)
    return a * a + b * b + c * c


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
