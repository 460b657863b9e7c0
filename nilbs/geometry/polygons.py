"""Polygons in space, cut into triangles."""

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.geometry.validation import arrays, check_indices

_FLAT = 1e-9  # of a polygon's area: triangles smaller than this have none
_FEW = 8  # corners of a polygon that is tried as a fan around each of them
_STEPS = 10_000_000  # corners checked, in all, when cutting ears: some seconds


def cut_polygons(V: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut polygons into triangles F (m, 3) that cover them once.

    The polygons' `corners` (c,), indices into V, stand one polygon after the other, `counts` (e,) of them each. Returns
    F in the order of the polygons and wound like them; the polygon (m,) of each triangle; and a mask (e,) of polygons
    that no triangles cover once, because they cross themselves, or are concave and too large: these are cut in some
    way.

    A polygon, seen along its mean normal, is cut into a fan around its first corner if that covers it, else into one
    around another corner, else into ears [1]_. It need not be quite flat.

    References
    ----------
    .. [1] Meisters, Polygons have ears, 1975, doi:10.2307/2319703.

    Examples
    --------
    >>> V = [[0, 0, 0], [2, 1, 0], [0, 2, 0], [1, 1, 0]]
    >>> cut_polygons(V, [0, 1, 2, 3], [4])[0]
    array([[1, 2, 3],
           [1, 3, 0]])
    """
    V, corners, counts = arrays(V=(V, "n d"), corners=(corners, "c", int), counts=(counts, "e", int))
    if len(corners):
        check_indices("corners", corners[:, None], len(V), "vertices")
    if (counts < 0).any() or counts.sum() != len(corners):
        raise ValueError(f"counts must add up to the {len(corners)} corners")
    fans = np.maximum(counts - 2, 0)
    face = np.repeat(np.arange(len(counts)), fans)
    begin, first = np.cumsum(counts) - counts, np.cumsum(fans) - fans
    step = np.arange(len(face)) - first[face]
    F = corners[begin[face][:, None] + np.stack([np.zeros_like(step), step + 1, step + 2], axis=1)]
    crossed = np.zeros(len(counts), dtype=bool)
    many = np.flatnonzero(counts > 3)
    if not len(many):
        return F, face, crossed
    V = in_space(V) / (np.abs(V).max() or 1.0) / 4  # so that no difference overflows
    inside = np.flatnonzero(counts[face] > 3)
    starts = np.cumsum(fans[many]) - fans[many]
    of = np.repeat(np.arange(len(many)), fans[many])
    size = np.maximum.reduceat(np.abs(_sides(V, F[inside])).max(axis=(1, 2)), starts)
    area = _area_vectors(V, F[inside], size[of])
    normal = np.add.reduceat(area, starts, axis=0)
    convex = np.minimum.reduceat((area * normal[of]).sum(axis=1), starts) > _FLAT * (normal**2).sum(axis=1)
    steps = 0
    for k in np.unique(counts[many[~convex]]):
        group = np.flatnonzero(~convex & (counts[many] == k))
        polygon = corners[begin[many[group]][:, None] + np.arange(k)]
        for s in range(1, k if k <= _FEW else 1):
            turned = np.roll(polygon, -s, axis=1)
            cut = np.stack([np.repeat(turned[:, :1], k - 2, axis=1), turned[:, 1:-1], turned[:, 2:]], axis=2)
            areas = _area_vectors(V, cut, size[group, None])
            lowest = (areas * normal[group, None]).sum(axis=2).min(axis=1)
            covered = lowest > _FLAT * (normal[group] ** 2).sum(axis=1)
            F[first[many[group[covered]]][:, None] + np.arange(k - 2)] = cut[covered]
            group, polygon = group[~covered], polygon[~covered]
        for i, polygon_corners in zip(group, polygon, strict=True):
            if steps < _STEPS and normal[i].any():
                ears, taken = _ears(_seen_along(V[polygon_corners], normal[i], size[i]), _STEPS - steps)
                steps += taken
                F[first[many[i]] : first[many[i]] + k - 2] = polygon_corners[ears]
    area = _area_vectors(V, F[inside], size[of])
    length = np.linalg.norm(normal, axis=1)
    largest = np.maximum.reduceat(np.linalg.norm(area, axis=1), starts)
    lowest = np.minimum.reduceat((area * normal[of]).sum(axis=1), starts)
    crossed[many] = (lowest < -_FLAT * largest * length) | ((length <= _FLAT * largest) & (largest > 0))
    return F, face, crossed


def _sides(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Two sides of each triangle."""
    return V[F[..., 1:]] - V[F[..., :1]]


def _area_vectors(V: np.ndarray, F: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Normals as long as twice the triangles' areas, in units of a size each."""
    sides = _sides(V, F) / np.where(size > 0, size, 1)[..., None, None]
    return np.cross(sides[..., 0, :], sides[..., 1, :])


def _seen_along(points: np.ndarray, normal: np.ndarray, size: float) -> np.ndarray:
    """Points in a plane, such that a polygon with this normal runs counter-clockwise."""
    axis = int(np.abs(normal).argmax())
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    return ((points - points[0]) / size)[:, kept if normal[axis] > 0 else kept[::-1]]


def _ears(points: np.ndarray, limit: int) -> tuple[list[list[int]], int]:
    """Cut off one ear after the other, a corner whose triangle no other corner lies in; also count the steps taken."""
    x, y = points.T.tolist()
    k = len(x)
    before, after = [i - 1 for i in range(k)], [i + 1 for i in range(k)]
    before[0], after[-1] = k - 1, 0

    def area(a: int, b: int, c: int) -> float:
        return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])

    tiny = _FLAT * abs(sum(x[i - 1] * y[i] - x[i] * y[i - 1] for i in range(k)))
    dents = {i for i in range(k) if area(before[i], i, after[i]) <= tiny}

    def is_ear(b: int) -> bool:
        a, c = before[b], after[b]
        if b in dents:
            return False
        places = {(x[a], y[a]), (x[b], y[b]), (x[c], y[c])}
        return not any(
            area(a, b, p) >= 0 and area(b, c, p) >= 0 and area(c, a, p) >= 0 and (x[p], y[p]) not in places
            for p in dents
        )

    triangles: list[list[int]] = []
    b, failures, steps = 0, 0, 0
    while len(triangles) < k - 2:
        left = k - len(triangles)
        steps += len(dents) + 1
        # After a round without an ear all corners have no area, or the polygon crosses itself: then any corner is cut.
        if steps < limit and failures < left and not is_ear(b):
            b, failures = after[b], failures + 1
            continue
        a, c = before[b], after[b]
        triangles.append([a, b, c])
        after[a], before[c] = c, a
        dents.discard(b)
        for corner in (a, c):
            if area(before[corner], corner, after[corner]) > tiny:
                dents.discard(corner)
            else:
                dents.add(corner)
        b, failures = after[c], 0
    return triangles, steps
