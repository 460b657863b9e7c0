"""Where a body overlaps itself: canonical points inside the body besides one that is known, compiled."""

import numpy as np

from nilbs.engine.compiled import compiled
from nilbs.engine.distances import rest_distance
from nilbs.engine.search import ROOT, SAME, PosedSearch, find_starts, known_root, newton


def other_roots(
    posed: PosedSearch, x: np.ndarray, to_unit: np.ndarray, x_rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The deepest canonical point (n, d) of each posed point besides a known one, and the rest distance (n,) there.

    Parameters
    ----------
    posed : PosedSearch
        A search in a pose.
    x, to_unit : (n, d) and (d, d+1) float arrays
        Points, and the transform that moves them into the unit frame.
    x_rest : (n, d) float array
        The canonical points that are known, in the unit frame; nan if none is.

    Returns
    -------
    other, distance : (n, d) and (n,) float32 arrays
        nan and inf where there is no other point, or it lies outside the body.
    """
    n, d = x_rest.shape
    own, other = np.zeros((n, 3), dtype=np.float32), np.full((n, 3), np.nan, dtype=np.float32)
    own[:, :d] = x_rest
    distance = np.full(n, np.inf, dtype=np.float32)
    posed.search(x, to_unit, _search, own, distance, other)
    return other[:, :d], distance


@compiled
def _search(points, begin, end, room, weights, distances, lattice, cells, B, own, distance, other):  # type: ignore[no-untyped-def]
    """Write the deepest root besides the own one, and return the look-ups."""
    find_starts(points, begin, end, lattice, cells, room)
    count, cell, at, roots, slots = room.starts, room.cell, room.at, room.roots, room.slots
    looks = 0
    for s in range(end - begin):
        i = points.number[begin + s]
        p0, p1, p2 = points.x[begin + s], points.y[begin + s], points.z[begin + s]
        best, found = np.float32(0), 0
        if own[i, 0] == own[i, 0]:  # not nan
            roots[0, 0], roots[0, 1], roots[0, 2] = own[i, 0], own[i, 1], own[i, 2]
            found = 1
        for j in range(count[s]):
            q0, q1, q2, c = at[s, j, 0], at[s, j, 1], at[s, j, 2], cell[s, j]
            same = np.float32(SAME) * lattice.edge[c, 0]
            if known_root(q0, q1, q2, same, roots, found):
                continue
            residual, r0, r1, r2, turned, evaluations = newton(p0, p1, p2, q0, q1, q2, weights, B, slots)
            looks += evaluations
            # Unlike its start, the root may be one that is known.
            if not residual < np.float32(ROOT) or turned or known_root(r0, r1, r2, same, roots, found):
                continue
            if found < roots.shape[0]:
                roots[found, 0], roots[found, 1], roots[found, 2] = r0, r1, r2
                found += 1
            v = rest_distance(r0, r1, r2, distances)
            if v < best:
                best = v
                distance[i] = v
                other[i, 0], other[i, 1], other[i, 2] = r0, r1, r2
    return looks
