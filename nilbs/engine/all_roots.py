"""All canonical points of a posed point that the search finds, inside the body or beside it, compiled."""

import numpy as np

from nilbs.engine.compiled import compiled
from nilbs.engine.distances import rest_distance
from nilbs.engine.search import MOST, ROOT, SAME, PosedSearch, find_starts, known_root, newton


def all_roots(posed: PosedSearch, x: np.ndarray, to_unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Canonical points of posed points, with the rest distance at each.

    Parameters
    ----------
    posed : PosedSearch
        A search in a pose.
    x, to_unit : (n, d) and (d, d+1) float arrays
        Points, and the transform that moves them into the unit frame.

    Returns
    -------
    x_rest, distance : (n, r, d) and (n, r) float32 arrays
        In the unit frame, in the order in which they are found; nan after the last.
    """
    n, d = x.shape
    roots = np.full((n, MOST, 3), np.nan, dtype=np.float32)
    distance = np.full((n, MOST), np.nan, dtype=np.float32)
    posed.search(x, to_unit, _search, roots, distance)
    r = int((~np.isnan(distance)).sum(axis=1).max(initial=0))
    return roots[:, :r, :d], distance[:, :r]


@compiled
def _search(points, begin, end, room, weights, distances, lattice, cells, B, roots, distance):  # type: ignore[no-untyped-def]
    """Write the roots of points, and return the look-ups."""
    find_starts(points, begin, end, lattice, cells, room)
    count, cell, at, slots = room.starts, room.cell, room.at, room.slots
    looks = 0
    for s in range(end - begin):
        i = points.number[begin + s]
        p0, p1, p2 = points.x[begin + s], points.y[begin + s], points.z[begin + s]
        found = 0
        for j in range(count[s]):
            q0, q1, q2, c = at[s, j, 0], at[s, j, 1], at[s, j, 2], cell[s, j]
            same = np.float32(SAME) * lattice.edge[c, 0]
            if known_root(q0, q1, q2, same, roots[i], found):
                continue
            residual, r0, r1, r2, turned, evaluations = newton(p0, p1, p2, q0, q1, q2, weights, B, slots)
            looks += evaluations
            # Unlike its start, the root may be one that is known.
            if not residual < np.float32(ROOT) or turned or known_root(r0, r1, r2, same, roots[i], found):
                continue
            roots[i, found, 0], roots[i, found, 1], roots[i, found, 2] = r0, r1, r2
            distance[i, found] = rest_distance(r0, r1, r2, distances)
            found += 1
    return looks
