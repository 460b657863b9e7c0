"""Winding numbers of closed surfaces in space, by the triangles that a ray from each point crosses."""

import numpy as np

from nilbs.engine.compiled import compiled, in_pieces, inlined
from nilbs.geometry.winding import winding_number as generalized

# Points that a thread takes at once, and about how many triangles share a column of the grid across the rays.
PIECE, SHARE = 16_384, 4
# The most entries of columns, which long triangles across the whole surface would exceed: they are counted otherwise.
MOST = 2**26


def winding_number(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Winding number (p,) of a surface V (n, d), F (m, d) around points (p, d).

    Of a closed surface in space it is whole, and counted; `nilbs.geometry.winding.winding_number` is the twin, and
    returns that of any other.

    Examples
    --------
    >>> V, F = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> winding_number(V, F, np.array([[0.2, 0.2, 0.2], [0.9, 0.9, 0.9]])).tolist()
    [-1.0, 0.0]
    """
    if not len(F) or V.shape[1] == 2 or not is_closed(F):
        return generalized(V, F, x)
    V, x = (np.ascontiguousarray(a, dtype=np.float64) for a in (V, x))
    used = V[F.ravel(), 1:]
    low, extent = used.min(axis=0), np.ptp(used, axis=0)
    edge = max(float(np.sqrt(extent.prod() * SHARE / len(F))), float(extent.max()) / 1024, 1e-300)
    shape = np.floor(extent / edge).astype(np.int64) + 1
    first = np.zeros(shape.prod() + 2, dtype=np.int64)
    _fill(V, F, low, edge, shape, first, np.empty(0, dtype=np.int64))
    np.cumsum(first, out=first)
    if first[-1] > MOST:
        return generalized(V, F, x)
    triangles = np.empty(first[-1], dtype=np.int64)
    _fill(V, F, low, edge, shape, first, triangles)
    found = np.empty(len(x))
    in_pieces(lambda b, e: _wind(V, F, x, low, edge, shape, first, triangles, b, e, found), len(x), piece=PIECE)
    return found


def is_closed(F: np.ndarray) -> bool:
    """Whether the triangles' edges cancel: each runs as often one way as the other."""
    tail, head = F.ravel().astype(np.int64), np.roll(F, -1, axis=1).ravel().astype(np.int64)
    n = int(F.max()) + 1
    there, back = np.sort(tail * n + head), np.sort(head * n + tail)
    return bool(np.array_equal(there, back))


@inlined
def _columns(V, F, f, low, edge, shape):  # type: ignore[no-untyped-def]
    """The columns that a triangle's box meets, without those beside."""
    y0, y1, y2 = V[F[f, 0], 1], V[F[f, 1], 1], V[F[f, 2], 1]
    z0, z1, z2 = V[F[f, 0], 2], V[F[f, 1], 2], V[F[f, 2], 2]
    j0 = _column(min(y0, y1, y2), low[0], edge, shape[0])
    j1 = _column(max(y0, y1, y2), low[0], edge, shape[0])
    k0 = _column(min(z0, z1, z2), low[1], edge, shape[1])
    k1 = _column(max(z0, z1, z2), low[1], edge, shape[1])
    return j0, j1, k0, k1


@inlined
def _column(y, low, edge, count):  # type: ignore[no-untyped-def]
    return int(min(max((y - low) / edge, 0.0), count - 1.0))


@compiled
def _fill(V, F, low, edge, shape, first, triangles):  # type: ignore[no-untyped-def]
    """Count the triangles of columns, two places on; or write them, and where each column's begin, one place on."""
    for f in range(F.shape[0]):
        j0, j1, k0, k1 = _columns(V, F, f, low, edge, shape)
        for j in range(j0, j1 + 1):
            for k in range(k0, k1 + 1):
                c = j * shape[1] + k
                if triangles.shape[0]:
                    triangles[first[c + 1]] = f
                    first[c + 1] += 1
                else:
                    first[c + 2] += 1


@compiled
def _wind(V, F, x, low, edge, shape, first, triangles, begin, end, found):  # type: ignore[no-untyped-def]
    """Write winding numbers: what the triangles above each point, along the first axis, sum up to."""
    for i in range(begin, end):
        X, Y, Z = x[i, 0], x[i, 1], x[i, 2]
        found[i] = 0.0
        outside = low[0] > Y or low[1] > Z or low[0] + edge * shape[0] < Y or low[1] + edge * shape[1] < Z
        if outside:
            continue
        c = _column(Y, low[0], edge, shape[0]) * shape[1] + _column(Z, low[1], edge, shape[1])
        for t in range(first[c], first[c + 1]):
            p, q, r = F[triangles[t], 0], F[triangles[t], 1], F[triangles[t], 2]
            # The shadow of the triangle turns around the point once, one way or the other, or not at all.
            turns = _turn(V, p, q, Y, Z) + _turn(V, q, r, Y, Z) + _turn(V, r, p, Y, Z)
            if turns == 0:
                continue
            ax, ay, az = V[q, 0] - V[p, 0], V[q, 1] - V[p, 1], V[q, 2] - V[p, 2]
            bx, by, bz = V[r, 0] - V[p, 0], V[r, 1] - V[p, 1], V[r, 2] - V[p, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            # Above the point are planes that it lies behind, where their normals point up.
            behind = nx * (V[p, 0] - X) + ny * (V[p, 1] - Y) + nz * (V[p, 2] - Z)
            if behind * nx > 0:
                found[i] += turns


@inlined
def _turn(V, a, b, y, z):  # type: ignore[no-untyped-def]
    """Whether the shadow of an edge crosses the half line from (y, z) along y: 1 upwards in z, -1 downwards, or 0.

    Of the two directions of an edge exactly one is counted upwards: its lower end comes first in the arithmetic.
    """
    up_a, up_b = V[a, 2] > z, V[b, 2] > z
    if up_a == up_b:
        return 0
    lower, upper = (b, a) if up_a else (a, b)
    side = (V[upper, 1] - V[lower, 1]) * (z - V[lower, 2]) - (V[upper, 2] - V[lower, 2]) * (y - V[lower, 1])
    if not side > 0:
        return 0
    return 1 if up_b else -1
