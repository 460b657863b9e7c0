"""Triangles that a flat mesh brings, refined so that they hold the bones."""

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import element_volumes


def conforming_triangles(
    V: np.ndarray, T: np.ndarray, points: np.ndarray, *, spacing: float = 0.02
) -> tuple[np.ndarray, np.ndarray]:
    """Refine a flat mesh so that it has vertices at given points (s, 2) and no large triangles inside.

    Returns the given vertices first, in their order, and counter-clockwise triangles, Delaunay inside the outline,
    which is kept edge by edge. Points outside are left out. `spacing`, a fraction of the bounding box's diagonal, is
    the distance between vertices that are added inside; a finer mesh gets none.

    Notes
    -----
    Lawson's incremental insertion [1]_: a point splits the triangle or edge that it lies in, and edges are flipped
    until no triangle's circumcircle holds its neighbour's far vertex. Flips never touch the outline.

    References
    ----------
    .. [1] Lawson, Software for C1 surface interpolation, 1977, doi:10.1016/B978-0-12-587260-7.50011-X.

    Examples
    --------
    >>> V, T = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> V2, T2 = conforming_triangles(V, T, [[0.2, 0.5], [0.8, 0.5]], spacing=0.5)
    >>> float(element_volumes(V2, T2).sum().round(12))
    1.0
    """
    V, T, points = arrays(V=(V, "n 2"), T=(T, "t 3", int), points=(points, "s 2"))
    area = element_volumes(V, T)
    size = float(np.linalg.norm(np.ptp(V, axis=0))) if len(V) else 0.0
    T = np.where((area < 0)[:, None], T[:, [0, 2, 1]], T)[np.abs(area) > 1e-14 * size**2]
    if not len(T):
        return V.copy(), T
    mesh = _Triangulation(V, T, tolerance=1e-9 * size)
    mesh.flip_all()
    for point in points:
        mesh.insert(point)
    step = spacing * size
    if step > 0:
        for point in _hexagonal_points(V.min(axis=0), V.max(axis=0), step):
            # A point nearer to a vertex than this would make the mesh worse instead of better.
            mesh.insert(point, clearance=0.7 * step)
    return mesh.points[: mesh.n].copy(), mesh.corners[: mesh.t].copy()


def _hexagonal_points(lower: np.ndarray, upper: np.ndarray, step: float) -> np.ndarray:
    rows = np.arange(lower[1], upper[1], step * np.sqrt(0.75))
    columns = np.arange(lower[0] - step, upper[0] + step, step)
    x = columns[None, :] + 0.5 * step * (np.arange(len(rows)) % 2)[:, None]
    return np.stack([x, np.broadcast_to(rows[:, None], x.shape)], axis=-1).reshape(-1, 2)


class _Triangulation:
    """Counter-clockwise triangles in growing arrays, and the triangle to the left of every directed edge."""

    def __init__(self, V: np.ndarray, T: np.ndarray, *, tolerance: float) -> None:
        self.points = V.copy()
        self.loose = np.setdiff1d(np.arange(len(V)), T)
        self.corners = T.copy()
        self.n, self.t = len(V), len(T)
        self.tolerance = tolerance
        self.left: dict[tuple[int, int], int] = {}
        for i in range(self.t):
            self._register(i)

    def flip_all(self) -> None:
        self._legalize([edge for edge in self.left if edge[0] < edge[1]])

    def insert(self, point: np.ndarray, clearance: float = 0.0) -> None:
        """Add a point; one this near to a vertex, or outside, changes nothing."""
        square = ((self.points[: self.n] - point) ** 2).sum(axis=1)
        square[self.loose] = np.inf  # a vertex without a triangle is not part of the mesh
        if np.sqrt(square.min()) <= max(clearance, self.tolerance):
            return
        a, b, c = (self.points[self.corners[: self.t, i]] for i in range(3))
        # Distances to the three sides, positive inside.
        sides = np.stack([_heights(a, b, point), _heights(b, c, point), _heights(c, a, point)], axis=1)
        lowest = sides.min(axis=1)
        i = int(lowest.argmax())
        if lowest[i] < -self.tolerance:
            return
        corners = self.corners[i].tolist()
        side = int(sides[i].argmin())
        first, second = corners[side], corners[(side + 1) % 3]
        new = self._add_point(point)
        opposite = corners[(side + 2) % 3]
        if lowest[i] > self.tolerance:
            self._replace(i, (first, second, new))
            self._add_triangle((second, opposite, new))
            self._add_triangle((opposite, first, new))
            self._legalize([(first, second), (second, opposite), (opposite, first)])
            return
        j = self.left.get((second, first))
        self._replace(i, (first, new, opposite))
        self._add_triangle((new, second, opposite))
        outer = [(second, opposite), (opposite, first)]
        if j is not None:
            far = self._third(j, first, second)
            self._replace(j, (second, new, far))
            self._add_triangle((new, first, far))
            outer += [(far, second), (first, far)]
        self._legalize(outer)

    def _legalize(self, edges: list[tuple[int, int]]) -> None:
        while edges:
            a, b = edges.pop()
            i, j = self.left.get((a, b)), self.left.get((b, a))
            if i is None or j is None:
                continue
            c, d = self._third(i, a, b), self._third(j, b, a)
            if self._flip_helps(a, b, c, d):
                self._unregister(i)
                self._unregister(j)
                self._set(i, (c, d, b))
                self._set(j, (d, c, a))
                edges += [(d, b), (b, c), (c, a), (a, d)]

    def _flip_helps(self, a: int, b: int, c: int, d: int) -> bool:
        """Whether d lies inside the circumcircle of a, b, c and both triangles stay positive after the flip."""
        pa, pb, pc, pd = self.points[[a, b, c, d]].tolist()
        if _area(pc, pd, pb) <= 0 or _area(pd, pc, pa) <= 0:
            return False
        (ax, ay), (bx, by), (cx, cy) = ((p[0] - pd[0], p[1] - pd[1]) for p in (pa, pb, pc))
        a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
        terms = (a2 * (bx * cy - cx * by), -b2 * (ax * cy - cx * ay), c2 * (ax * by - bx * ay))
        # Four points on one circle may be flipped either way; without the margin rounding could flip them for ever.
        return sum(terms) > 1e-10 * sum(abs(term) for term in terms)

    def _third(self, i: int, a: int, b: int) -> int:
        return next(v for v in self.corners[i].tolist() if v not in (a, b))

    def _register(self, i: int) -> None:
        a, b, c = self.corners[i].tolist()
        self.left[a, b] = self.left[b, c] = self.left[c, a] = i

    def _unregister(self, i: int) -> None:
        a, b, c = self.corners[i].tolist()
        for edge in ((a, b), (b, c), (c, a)):
            if self.left.get(edge) == i:
                del self.left[edge]

    def _replace(self, i: int, corners: tuple[int, int, int]) -> None:
        self._unregister(i)
        self._set(i, corners)

    def _set(self, i: int, corners: tuple[int, int, int]) -> None:
        self.corners[i] = corners
        self._register(i)

    def _add_triangle(self, corners: tuple[int, int, int]) -> None:
        if self.t == len(self.corners):
            self.corners = np.concatenate([self.corners, np.zeros((self.t + 16, 3), dtype=np.int64)])
        self.t += 1
        self._set(self.t - 1, corners)

    def _add_point(self, point: np.ndarray) -> int:
        if self.n == len(self.points):
            self.points = np.concatenate([self.points, np.zeros((self.n + 16, 2))])
        self.points[self.n] = point
        self.n += 1
        return self.n - 1


def _heights(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Signed distances of a point from lines a -> b, positive to the left."""
    e, f = b - a, point - a
    return (e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]) / np.maximum(np.linalg.norm(e, axis=1), 1e-300)


def _area(a: list[float], b: list[float], c: list[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
