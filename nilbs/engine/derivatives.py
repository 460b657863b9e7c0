"""First derivatives of a search's answers by posed points and by the pose, compiled.

At a root the implicit function theorem gives d x_rest = J^-1 (d x - d posed), where J is the derivative of posed by
rest coordinates. A point without a canonical point has the distance to the posed skin, whose derivatives are those of
its closest place. Sums over points are those of pieces of always the same points, in always the same order, so that
they do not depend on the number of threads.
"""

import numpy as np

from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.compiled import compiled, in_pieces, inlined
from nilbs.engine.distances import distance_cell, trilinear
from nilbs.engine.search import SMALLEST, SearchEngine
from nilbs.engine.weights import columns, counted, forward, transforms, weight_cell
from nilbs.geometry.weight_blocks import ONE

# Points that a thread takes at once.
PIECE = 2048
ZERO = np.float32(0)


def root_gradients(
    engine: SearchEngine, B: np.ndarray, x_rest: np.ndarray, of_distance: np.ndarray, of_x_rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients by points (n, d) and by the pose (b, d+1, d+1) of what depends on distances and canonical points.

    Parameters
    ----------
    engine : SearchEngine
    B : (b, d+1, d+1) float array
        The pose in the unit frame, as all that follows.
    x_rest : (n, d) float array
        Roots; where there is none, nan, and no gradient.
    of_distance, of_x_rest : (n,) and (n, d) float arrays
        Gradients by the rest distance at the roots and by the roots themselves.
    """
    n, d = x_rest.shape
    x_rest, of_distance, of_x_rest = (
        np.ascontiguousarray(array, dtype=kind)
        for array, kind in ((x_rest, np.float32), (of_distance, np.float64), (of_x_rest, np.float64))
    )
    pose = columns(counted(transforms(B)))
    by_x, by_B = np.empty((n, d)), np.zeros((-(-n // PIECE), len(B), 3, 4))

    def add(begin: int, end: int) -> None:
        _add_roots(
            x_rest, of_distance, of_x_rest, begin, end, engine.weights, engine.distances, pose,
            np.empty((1, 4, 8), dtype=np.float32), np.zeros(3), by_x, by_B[begin // PIECE],
        )  # fmt: skip

    in_pieces(add, n, piece=PIECE)
    return by_x, _of_pose(by_B, d)


class SkinGradients:
    """Gradients of distances to the posed skin.

    Parameters
    ----------
    V, F, W : (n, d) float array, (m, d) int array and (n, b) float array
        Rest vertices, facets and skinning weights of the skin.
    """

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray) -> None:
        self._V, self._F, self._bones = np.ascontiguousarray(V), np.ascontiguousarray(F), W.shape[1]
        vertex, bone = np.nonzero(W)
        self._first = np.searchsorted(vertex, np.arange(len(W) + 1))
        self._bone, self._weight = bone.astype(np.int32), W[vertex, bone]

    def __call__(self, x: np.ndarray, places: ClosestPoints, of_distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients by points (n, d) and by the pose (b, d+1, d+1), from those by their distances (n,).

        The unit vector from the closest place to the point is the gradient by the point, and minus that by the place,
        which moves with the corners of its facet. A point on the skin has none.
        """
        n, d = x.shape
        length = np.where(places.distance > 0, places.distance, np.inf)
        by_x = (of_distance / length)[:, None] * (x - places.point)
        by_B = np.zeros((-(-n // PIECE), self._bones, 3, 4))

        def add(begin: int, end: int) -> None:
            _add_places(
                by_x, places.facet, places.barycentric, begin, end, self._V, self._F, self._first, self._bone,
                self._weight, by_B[begin // PIECE],
            )  # fmt: skip

        in_pieces(add, n, piece=PIECE)
        return by_x, _of_pose(by_B, d)


def _of_pose(pieces: np.ndarray, d: int) -> np.ndarray:
    """The sum of gradients (k, b, 3, 4) by upper rows, as a gradient (b, d+1, d+1); the last row has none."""
    found = np.zeros((pieces.shape[1], d + 1, d + 1))
    upper = pieces.sum(axis=0)
    found[:, :d, :d], found[:, :d, d] = upper[:, :d, :d], upper[:, :d, 3]
    return found


@compiled
def _add_roots(x_rest, of_distance, of_x_rest, begin, end, weights, distances, B, slots, g, by_x, by_B):  # type: ignore[no-untyped-def]
    """Write the gradients z by points, and take w z (x_rest, 1)^T from that by each bone with a weight w."""
    d = x_rest.shape[1]
    for i in range(begin, end):
        p0, p1, p2 = x_rest[i, 0], x_rest[i, 1], x_rest[i, 2] if d == 3 else ZERO
        if np.isnan(p0):
            by_x[i] = 0
            continue
        _, _, _, a00, a01, a02, a10, a11, a12, a20, a21, a22 = forward(p0, p1, p2, weights, B, slots)
        # J^T z = g by Cramer's rule, as in `nilbs.fields.cramer`.
        g[0], g[1], g[2] = _slope(p0, p1, p2, distances)
        for r in range(d):
            g[r] = g[r] * of_distance[i] + of_x_rest[i, r]
        c0, c1, c2 = a11 * a22 - a12 * a21, a12 * a20 - a10 * a22, a10 * a21 - a11 * a20
        det = a00 * c0 + a01 * c1 + a02 * c2
        if abs(det) < np.float32(SMALLEST):
            det = -np.float32(SMALLEST) if det < 0 else np.float32(SMALLEST)
        f = 1 / np.float64(det)
        z0 = f * (c0 * g[0] + c1 * g[1] + c2 * g[2])
        z1 = f * ((a02 * a21 - a01 * a22) * g[0] + (a00 * a22 - a02 * a20) * g[1] + (a01 * a20 - a00 * a21) * g[2])
        z2 = f * ((a01 * a12 - a02 * a11) * g[0] + (a02 * a10 - a00 * a12) * g[1] + (a00 * a11 - a01 * a10) * g[2])
        by_x[i, 0], by_x[i, 1] = z0, z1
        if d == 3:
            by_x[i, 2] = z2
        at, s0, s1, first, bones, f0, f1, f2 = weight_cell(p0, p1, p2, weights)
        for k in range(bones):
            value, _, _, _ = trilinear(weights.weight, at + k, s0, s1, bones, f0, f1, f2)
            w = value / np.float32(ONE)
            if w == 0:
                continue
            m = by_B[weights.bone[first + k]]
            for r, z in enumerate((w * z0, w * z1, w * z2)):
                m[r, 0] -= z * p0
                m[r, 1] -= z * p1
                m[r, 2] -= z * p2
                m[r, 3] -= z


@inlined
def _slope(p0, p1, p2, distances):  # type: ignore[no-untyped-def]
    """Derivatives of `nilbs.engine.distances.rest_distance` by the coordinates of a rest point."""
    at, s0, s1, unit, f0, f1, f2, scale0, scale1, scale2, b0, b1, b2 = distance_cell(p0, p1, p2, distances)
    _, slope0, slope1, slope2 = trilinear(distances.values, at, s0, s1, 1, f0, f1, f2)
    # Beyond the grid the nearest place in it stays where it is, and the distance to it grows.
    beyond = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    length = beyond if beyond > 0 else np.float32(1)
    return (
        b0 / length if b0 != 0 else unit * scale0 * slope0,
        b1 / length if b1 != 0 else unit * scale1 * slope1,
        b2 / length if b2 != 0 else unit * scale2 * slope2,
    )


@compiled
def _add_places(by_x, facet, barycentric, begin, end, V, F, first, bone, weight, by_B):  # type: ignore[no-untyped-def]
    """Take the gradients of the corners of facets from those by the pose."""
    d = V.shape[1]
    for i in range(begin, end):
        if facet[i] < 0:
            continue
        for corner in range(d):
            vertex = F[facet[i], corner]
            share = barycentric[i, corner]
            for s in range(first[vertex], first[vertex + 1]):
                y = share * weight[s]
                for r in range(d):
                    z = y * by_x[i, r]
                    for k in range(d):
                        by_B[bone[s], r, k] -= z * V[vertex, k]
                    by_B[bone[s], r, 3] -= z
