"""Closest points on a posed surface: a tree of boxes that is built once at rest and fitted to every pose.

A node has eight children, whose boxes are compared with a point at once; a leaf has eight triangles. An edge of the
plane is a triangle with two equal corners, in the plane z = 0. Every level is full, so that children are found by
counting: child k of node i is node 8 i + k + offset, and leaves are numbered after the nodes.

The tree works in units of half the posed box. It is searched by `nilbs.engine.closest_search`.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from nilbs.engine.closest_search import ClosestPoints, Fitted, closest_places
from nilbs.engine.compiled import allocating, compiled, in_pieces
from nilbs.geometry.validation import arrays

# Leaves and nodes that a thread works on at a time.
PIECE = 2048


class _Tree(NamedTuple):
    """What all poses share: corners (leaves, 3, 8) as indices of vertices, facets (leaves, 8), vertices in use."""

    corners: np.ndarray
    facets: np.ndarray
    used: np.ndarray
    offset: int


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
        leaves, offset, self._levels = _shape(-(-len(F) // 8))
        E = np.ascontiguousarray(F if self.d == 3 else F[:, [0, 1, 1]])
        order = np.arange(len(E))
        middles = np.zeros((len(E), 3))
        middles[:, : self.d] = V[E].sum(axis=1)
        _sort_facets(middles, order, leaves)
        corners, facets = np.empty((leaves, 3, 8), np.int32), np.empty((leaves, 8), np.int64)
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
        boxes, triangles = np.empty((nodes, 6, 8), np.float32), np.empty((leaves, 21, 8), np.float32)
        vertices = np.zeros((self.n, 3))
        vertices[:, : self.d] = (U - centre[: self.d]) * scale
        fitted = Fitted(boxes, triangles, tree.corners, tree.facets, tree.offset, vertices, centre, scale)
        if leaves:
            boxes[0, :3], boxes[0, 3:] = np.inf, -np.inf  # children that the root lacks
        in_pieces(partial(_fit_leaves, fitted), leaves, piece=PIECE)
        for begin, end in zip(self._levels[-2:0:-1], self._levels[:1:-1], strict=True):
            in_pieces(partial(_fit_nodes, fitted, begin), end - begin, piece=PIECE)
        return PosedSurface(fitted, self.d)


class PosedSurface:
    """A surface in a pose; made by `SurfaceTree.posed`. Several threads may use it at once."""

    def __init__(self, fitted: Fitted, d: int) -> None:
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
        return self._closest(x, within, self._d)

    def distance(self, x: np.ndarray, *, within: float = np.inf) -> np.ndarray:
        """Distances (n,) alone, as `closest` has them, in less time."""
        return self._closest(x, within, 0).distance

    def _closest(self, x: np.ndarray, within: float, coordinates: int) -> ClosestPoints:
        x = np.ascontiguousarray(x, dtype=np.float64)
        if x.ndim != 2 or x.shape[1] != self._d:
            raise ValueError(f"x must be (n, d) = (n, {self._d}), got {x.shape}")
        return closest_places(self._fitted, x, within=within, coordinates=coordinates)


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
    """Give each leaf its facets, by index; the last one fills what is left of eight."""
    m, leaves = len(order), len(facets)
    for i in range(leaves):
        begin, end = m * i // leaves, m * (i + 1) // leaves
        own = np.sort(order[begin:end])
        for k in range(8):
            facets[i, k] = own[min(k, end - begin - 1)]
            for c in range(3):
                corners[i, c, k] = E[facets[i, k], c]


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
def _fit_leaves(fitted: Fitted, begin: int, end: int) -> None:
    """Write the triangles of leaves begin .. end-1, and their boxes to their parents."""
    nodes, corners, x, t = len(fitted.boxes), fitted.corners, fitted.vertices, fitted.triangles
    for i in range(begin, end):
        child = nodes + i - fitted.offset
        for r in range(3):
            low, high = np.inf, -np.inf
            for c in range(3):
                for k in range(8):
                    low, high = min(low, x[corners[i, c, k], r]), max(high, x[corners[i, c, k], r])
            fitted.boxes[child >> 3, r, child & 7] = low
            fitted.boxes[child >> 3, r + 3, child & 7] = high
        for k in range(8):
            a, b, c = corners[i, 0, k], corners[i, 1, k], corners[i, 2, k]
            e0, e1, e2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
            f0, f1, f2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
            n0, n1, n2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
            ee, ef, ff = e0 * e0 + e1 * e1 + e2 * e2, e0 * f0 + e1 * f1 + e2 * f2, f0 * f0 + f1 * f1 + f2 * f2
            nn = n0 * n0 + n1 * n1 + n2 * n2
            # Without area not even infinity: no place is inside such a triangle.
            inverse = 1 / nn if nn > 0 else np.nan
            length = np.sqrt(inverse)
            t[i, 0, k], t[i, 1, k], t[i, 2, k] = x[a, 0], x[a, 1], x[a, 2]
            t[i, 3, k], t[i, 4, k], t[i, 5, k] = e0, e1, e2
            t[i, 6, k], t[i, 7, k], t[i, 8, k] = f0, f1, f2
            t[i, 9, k], t[i, 10, k], t[i, 11, k] = (
                inverse * (ff * e0 - ef * f0),
                inverse * (ff * e1 - ef * f1),
                inverse * (ff * e2 - ef * f2),
            )
            t[i, 12, k], t[i, 13, k], t[i, 14, k] = (
                inverse * (ee * f0 - ef * e0),
                inverse * (ee * f1 - ef * e1),
                inverse * (ee * f2 - ef * e2),
            )
            t[i, 15, k], t[i, 16, k], t[i, 17, k] = length * n0, length * n1, length * n2
            t[i, 18, k], t[i, 19, k], t[i, 20, k] = 1 / ee, 1 / ff, 1 / (ee - 2 * ef + ff)


@compiled
def _fit_nodes(fitted: Fitted, first: int, begin: int, end: int) -> None:
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
