"""Self-intersections of a surface."""

import numpy as np

from nilbs.geometry.boxes import overlapping_boxes
from nilbs.geometry.validation import arrays

TOUCHING = 1e-9  # of the surface's extent: facets nearer than this touch
_FOLDED = 1e-9  # rad; facets at an angle below this lie on each other
_PAIRS_PER_FACET = 200  # pairs of boxes that meet, on average, and
_ENOUGH = 10_000  # pairs of facets that touch, after which the search ends


def self_intersections(V: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, bool]:
    """Pairs of facets that cross or touch each other elsewhere than at the vertices that they share.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets; d is 2 or 3. Facets are edges in the plane, triangles in space.

    Returns
    -------
    pairs : (k, 2) int array
        Facets i < j, ascending.
    complete : bool
        Whether all were found. The search ends after some 10,000 pairs, or where every facet is so close to hundreds
        of others that it would take long.

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Notes
    -----
    Facets touch where they come nearer than 1e-9 of the surface's extent, or lie on each other at less than 1e-9 rad.
    Vertices at the very same place count as one, so a surface that is cut along a seam does not touch itself there.
    Left out are facets without area and two facets with the same vertices.

    A tree of boxes finds pairs that may touch, in time m log m for ordinary surfaces. Two triangles without a common
    vertex touch where an edge of one crosses the other or comes near it; two with one common vertex where the arcs
    that they cut out of a small sphere around it do; two with a common edge where they are folded onto each other.

    Examples
    --------
    >>> V = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -1], [0.5, 0.5, 1], [5, 5, 1]]
    >>> self_intersections(V, [[0, 1, 2], [3, 4, 5]])
    (array([[0, 1]]), True)
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    nothing = np.zeros((0, 2), dtype=np.int64)
    if not len(F):
        return nothing, True
    V, place = np.unique(V + 0.0, axis=0, return_inverse=True)  # -0.0 is 0.0
    F = place.reshape(-1)[F]
    lower = V[F].min(axis=(0, 1))
    size = float((V[F].max(axis=(0, 1)) - lower).max()) or 1.0
    V = (V - lower) / size
    kept = np.flatnonzero(~degenerate_facets(V, F))
    F = F[kept]
    if not len(F):
        return nothing, True
    found = [nothing]
    looked_at, complete = 0, True
    corners = V[F]
    for i, j in overlapping_boxes(corners.min(axis=1) - TOUCHING / 2, corners.max(axis=1) + TOUCHING / 2):
        looked_at += len(i)
        touching = _touching(V, F, i, j)
        found.append(np.stack([i[touching], j[touching]], axis=1))
        if sum(map(len, found)) >= _ENOUGH or looked_at > _PAIRS_PER_FACET * (len(F) + 1000):
            complete = False
            break
    pairs = np.sort(kept[np.concatenate(found)], axis=1)
    return pairs[np.lexsort(pairs.T[::-1])], complete


def t_junctions(V: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Ends of edges (r, 2) that lie on another edge between its ends: a surface is open there though it looks closed.

    An end at the place of another end is no junction.
    """
    V, edges = arrays(V=(V, "n 3"), edges=(edges, "r 2", int))
    ends = np.unique(edges)
    if not len(ends):
        return ends
    V = V - V[ends].min(axis=0)
    near = TOUCHING * float(V[ends].max())
    lower, upper = np.concatenate([V[edges].min(axis=1), V[ends]]), np.concatenate([V[edges].max(axis=1), V[ends]])
    found = [ends[:0]]
    for i, j in overlapping_boxes(lower - near, upper + near):
        i, j = np.minimum(i, j), np.maximum(i, j)
        mixed = (i < len(edges)) & (j >= len(edges))
        x, (start, end) = ends[j[mixed] - len(edges)], edges[i[mixed]].T
        along = V[end] - V[start]
        s = _dot(V[x] - V[start], along) / np.maximum(_dot(along, along), 1e-300)
        away = np.linalg.norm(V[x] - V[start] - np.clip(s, 0, 1)[:, None] * along, axis=1)
        from_ends = np.minimum(np.linalg.norm(V[x] - V[start], axis=1), np.linalg.norm(V[x] - V[end], axis=1))
        found.append(x[(away <= near) & (from_ends > near)])
    return np.unique(np.concatenate(found))


def degenerate_facets(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Mask (m,) of facets that repeat a corner, or are thinner than 1e-9 of their longest edge."""
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    edges = V[np.roll(F, -1, axis=1)] - V[F]
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1, initial=0))
    if F.shape[1] == 2:
        return longest == 0
    edges = edges / np.where(longest > 0, longest, 1)[:, None, None]
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) <= TOUCHING


def _touching(V: np.ndarray, F: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Whether facets i and j touch elsewhere than where they share a vertex; V within the unit box."""
    same = F[i][:, :, None] == F[j][:, None, :]
    shared = same.sum(axis=(1, 2))
    answer = np.zeros(len(i), dtype=bool)
    d = F.shape[1]
    for k in range(d):  # facets that share all vertices are duplicates, no intersections
        part = np.flatnonzero(shared == k)
        if not len(part):
            continue
        # The shared corners first, in the same order.
        one = np.argsort(~same[part].any(axis=2), axis=1, kind="stable")
        A = np.take_along_axis(F[i[part]], one, axis=1)
        other = np.argsort(~same[part].any(axis=1), axis=1, kind="stable")
        B = np.take_along_axis(F[j[part]], other, axis=1)
        P, Q = V[A], V[B]
        if k == 0:
            near = _near_segments(P, Q) <= TOUCHING if d == 2 else _near_triangles(P, Q)
        elif k == 1:
            near = _folded(P[:, 1] - P[:, 0], Q[:, 1] - Q[:, 0]) if d == 2 else _arcs_meet(P, Q)
        else:
            edge = P[:, 1] - P[:, 0]
            near = _folded(_across(edge, P[:, 2] - P[:, 0]), _across(edge, Q[:, 2] - Q[:, 0]))
        answer[part] = near
    return answer


def _across(edge: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The part of vectors perpendicular to an edge."""
    return v - (_dot(v, edge) / _dot(edge, edge))[:, None] * edge


def _folded(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Whether two vectors point the same way."""
    return np.linalg.norm(_unit(u) - _unit(v), axis=1) <= _FOLDED


def _arcs_meet(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Whether triangles that share their first corner meet elsewhere: near it they are arcs on a sphere."""
    e, f = _unit(P[:, 1:] - P[:, :1]), _unit(Q[:, 1:] - Q[:, :1])
    n, o = _unit(np.cross(e[:, 0], e[:, 1])), _unit(np.cross(f[:, 0], f[:, 1]))
    s, t = (f @ n[:, :, None])[..., 0], (e @ o[:, :, None])[..., 0]  # heights of ends above the other's plane
    answer = (_clear_sides(s) == 0) & (_clear_sides(t) == 0) & (s[:, 0] * t[:, 0] < 0)
    answer &= (np.abs(s) > _FOLDED).all(axis=1) & (np.abs(t) > _FOLDED).all(axis=1)
    rest = np.flatnonzero(~answer & (_clear_sides(s) == 0) & (_clear_sides(t) == 0))
    e, f, n, o, s, t = (x[rest] for x in (e, f, n, o, s, t))
    near = np.zeros(len(rest), dtype=bool)
    for arc, normal, ends, height in ((e, n, f, s), (f, o, e, t)):
        for k in range(2):
            x = ends[:, k]
            within = (_dot(np.cross(normal, arc[:, 0]), x) >= 0) & (_dot(np.cross(arc[:, 1], normal), x) >= 0)
            near |= within & (np.abs(height[:, k]) <= _FOLDED)
            near |= (np.linalg.norm(arc - x[:, None], axis=2) <= _FOLDED).any(axis=1)
    answer[rest] = near
    return answer


def _clear_sides(s: np.ndarray, tolerance: float = _FOLDED) -> np.ndarray:
    """1 where all heights are above the tolerance, -1 where all are below, else 0."""
    return (s > tolerance).all(axis=1).astype(int) - (s < -tolerance).all(axis=1)


def _near_triangles(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Whether triangles without a common corner cross or come near each other."""
    answer = np.zeros(len(P), dtype=bool)
    rest = np.arange(len(P))
    for one, other in ((P, Q), (Q, P)):  # a plane along one of the triangles, or upright on its edges, between them
        one, other = one[rest], other[rest]
        edges = np.roll(one, -1, axis=1) - one
        normal = _unit(np.cross(edges[:, 0], edges[:, 1]))
        apart = _clear_sides(_dot(other - one[:, :1], normal[:, None]), TOUCHING) != 0
        for k in range(3):
            outward = _unit(np.cross(edges[:, k], normal))
            apart |= _clear_sides(_dot(other - one[:, k, None], outward[:, None]), TOUCHING) > 0
        rest = rest[~apart]
    P, Q = P[rest], Q[rest]
    near = np.zeros(len(rest), dtype=bool)
    for one, other in ((P, Q), (Q, P)):
        near |= _stabs(one, other) | _stands_on(one, other)
    for a in range(3):
        for b in range(3):
            near |= _near_segments(P[:, [a, a - 2]], Q[:, [b, b - 2]]) <= TOUCHING
    answer[rest] = near
    return answer


def _stabs(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Whether an edge of P runs through the inside of Q."""
    answer = np.zeros(len(P), dtype=bool)
    normal = np.cross(Q[:, 1] - Q[:, 0], Q[:, 2] - Q[:, 0])
    height = _dot(P - Q[:, :1], normal[:, None])
    for k in range(3):
        start, end = P[:, k], P[:, k - 2]
        along = end - start
        ahead = Q - start[:, None]
        turns = np.stack([_dot(np.cross(ahead[:, c], ahead[:, c - 2]), along) for c in range(3)], axis=1)
        answer |= (height[:, k] * height[:, k - 2] < 0) & (np.abs(np.sign(turns).sum(axis=1)) == 3)
    return answer


def _stands_on(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Whether a corner of P is near the inside of Q."""
    edges = np.roll(Q, -1, axis=1) - Q
    normal = _unit(np.cross(edges[:, 0], edges[:, 1]))
    on = np.abs(_dot(P - Q[:, :1], normal[:, None])) <= TOUCHING
    for k in range(3):
        on &= _dot(P - Q[:, k, None], np.cross(normal, edges[:, k])[:, None]) >= 0
    return on.any(axis=1)


def _near_segments(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Distances between segments, each given by its two ends."""
    u, v, w = P[:, 1] - P[:, 0], Q[:, 1] - Q[:, 0], P[:, 0] - Q[:, 0]
    a, b, c, e, f = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    across = a * c - b * b
    s = np.where(across > 1e-14 * a * c, np.clip((b * f - c * e) / np.where(across > 0, across, 1), 0, 1), 0)
    t = np.clip((b * s + f) / c, 0, 1)
    nearest = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    # Where s or t were clipped, or the two are parallel, an end of one is nearest to the other.
    for start, along, square, ends in ((Q[:, 0], v, c, P), (P[:, 0], u, a, Q)):
        for k in range(2):
            x = ends[:, k] - start
            r = np.clip(_dot(x, along) / square, 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(x - r[:, None] * along, axis=1))
    return nearest


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)
