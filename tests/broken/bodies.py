"""Intact bodies and skeletons, from which broken ones are made."""

from functools import lru_cache

import numpy as np

from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.skeleton import Skeleton

Mesh = tuple[np.ndarray, np.ndarray]


def joined(*meshes: Mesh) -> Mesh:
    """One mesh of several, none of them joined to another."""
    offsets = np.cumsum([0] + [len(V) for V, _ in meshes[:-1]])
    parts = [F + offset for (_, F), offset in zip(meshes, offsets, strict=True)]
    return np.concatenate([V for V, _ in meshes]), np.concatenate(parts)


def shifted(mesh: Mesh, *offset: float) -> Mesh:
    V, F = mesh
    return V + np.array(offset), F


def reversed_faces(mesh: Mesh) -> Mesh:
    V, F = mesh
    return V, F[:, ::-1].copy()


def strip(rows: int, columns: int, *, closed_rows: str = "", closed_columns: bool = False) -> np.ndarray:
    """Triangles between rows x columns vertices; the last row may meet the first, "as it is" or "mirrored"."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if closed_rows:
        index = np.vstack([index, index[:1] if closed_rows == "as it is" else index[:1, ::-1]])
    if closed_columns:
        index = np.hstack([index, index[:, :1]])
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def tube(path: np.ndarray, radius: np.ndarray | float, *, around: int = 16, capped: bool = True) -> Mesh:
    """A tube around a path that stays near the plane z = 0."""
    path = np.asarray(path, dtype=float)
    tangent = np.gradient(path, axis=0)
    across = np.cross(tangent, [0, 0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, tangent)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    radius = np.broadcast_to(radius, len(path))[:, None, None]
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * up[:, None]
    V = (path[:, None] + radius * ring).reshape(-1, 3)
    F = strip(len(path), around, closed_columns=True)
    if not capped:
        return V, F
    first, last = np.arange(around), np.arange(around) + around * (len(path) - 1)
    caps = [
        np.stack([np.full(around, len(V)), first, np.roll(first, -1)], axis=1),
        np.stack([np.full(around, len(V) + 1), np.roll(last, -1), last], axis=1),
    ]
    return np.concatenate([V, path[[0, -1]]]), np.concatenate([F, *caps])


def worm(*, radius: float = 0.1, around: int = 16, rings: int = 33) -> Mesh:
    """A round bar from x = 0 to 1 with tapering ends."""
    x = np.linspace(0.004, 0.996, rings)
    taper = np.sqrt(np.clip(1 - (np.abs(2 * x - 1) - 0.8) ** 2 / 0.04, 0.04, 1))
    profile = radius * np.where(np.abs(2 * x - 1) > 0.8, taper, 1)
    return tube(np.stack([x, 0 * x, 0 * x], axis=1), profile, around=around)


def ball(centre: np.ndarray, radius: float, *, around: int = 16) -> Mesh:
    latitude = np.linspace(-np.pi / 2, np.pi / 2, around // 2 + 2)[1:-1]
    x = np.concatenate([[-1], np.sin(latitude), [1]])
    V, F = tube(np.stack([x[1:-1], 0 * latitude, 0 * latitude], axis=1), np.cos(latitude), around=around)
    V[-2:] = [[-1, 0, 0], [1, 0, 0]]
    return np.asarray(centre) + radius * V, F


def box(lower: np.ndarray, upper: np.ndarray) -> Mesh:
    """Twelve triangles."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    F = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return np.where(corners, upper, lower).astype(float), np.array(F)


def slab(lower: np.ndarray, upper: np.ndarray, cells: int = 24) -> Mesh:
    """A box whose two large sides, across z, are finely divided."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    s, t = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 1, cells + 1)] * 2, indexing="ij"))
    side = lower + np.stack([s, t, 0 * s], axis=1) * (upper - lower)
    top = side + np.array([0, 0, upper[2] - lower[2]])
    F = strip(cells + 1, cells + 1)
    n = len(side)
    edge = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    code = edge[:, 0] * n + edge[:, 1]
    rim = edge[~np.isin(code, edge[:, 1] * n + edge[:, 0])]
    walls = [
        np.stack([rim[:, 0], rim[:, 1], rim[:, 1] + n], axis=1),
        np.stack([rim[:, 0], rim[:, 1] + n, rim[:, 0] + n], axis=1),
    ]
    return np.concatenate([side, top]), np.concatenate([F[:, ::-1], F + n, *walls])


def cloth(cells: int = 24) -> Mesh:
    """An open wavy sheet of one unit by a half."""
    x, y = (
        a.ravel()
        for a in np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(-0.25, 0.25, cells // 2 + 1), indexing="ij")
    )
    return np.stack([x, y, 0.05 * np.sin(9 * x) * np.cos(5 * y)], axis=1), strip(cells + 1, cells // 2 + 1)


def skeleton(C: np.ndarray, BE: np.ndarray, P: np.ndarray | None = None) -> Skeleton:
    BE = np.asarray(BE)
    return Skeleton(C, BE, bone_parents(BE) if P is None else P, tuple(f"bone{i}" for i in range(len(BE))))


def chain(joints: np.ndarray) -> Skeleton:
    """A bone from every joint to the next."""
    index = np.arange(len(joints) - 1)
    return skeleton(joints, np.stack([index, index + 1], axis=1), index - 1)


def spine(bones: int = 4, lower: float = 0.1, upper: float = 0.9) -> Skeleton:
    """A chain along the middle of the worm."""
    x = np.linspace(lower, upper, bones + 1)
    return chain(np.stack([x, 0 * x, 0 * x], axis=1))


_JOINTS = np.array(
    [
        [0, 0.5, 0], [0, 0.75, 0], [0, 0.95, 0],  # pelvis, chest, crown
        [0.12, 0.73, 0], [0.27, 0.71, 0.01], [0.42, 0.7, 0.02],  # left shoulder, elbow, hand
        [-0.12, 0.73, 0], [-0.27, 0.71, 0.01], [-0.42, 0.7, 0.02],
        [0.09, 0.45, 0], [0.11, 0.24, 0.01], [0.12, 0.05, 0],  # left hip, knee, foot
        [-0.09, 0.45, 0], [-0.11, 0.24, 0.01], [-0.12, 0.05, 0],
    ]
)  # fmt: skip
_BONES = np.array([[0, 1], [1, 2], [1, 3], [3, 4], [4, 5], [1, 6], [6, 7], [7, 8],
                   [0, 9], [9, 10], [10, 11], [0, 12], [12, 13], [13, 14]])  # fmt: skip
_RADII = np.array([0.11, 0.08, 0.07, 0.05, 0.045, 0.07, 0.05, 0.045, 0.08, 0.065, 0.05, 0.08, 0.065, 0.05])


def person_skeleton() -> Skeleton:
    return skeleton(_JOINTS, _BONES)


@lru_cache
def _person(resolution: int) -> Mesh:
    grid = Grid.box(_JOINTS[:, :] + np.array([[0, 0, -0.12]]) * (np.arange(15) % 2)[:, None], resolution, pad=0.12)
    x = grid.points()
    distance = np.full(len(x), np.inf)
    for (start, end), radius in zip(_JOINTS[_BONES], _RADII, strict=True):
        along = end - start
        s = np.clip((x - start) @ along / (along @ along), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(start + s[:, None] * along - x, axis=1) - radius)
    return isosurface(distance, grid)


def person(resolution: int = 36) -> Mesh:
    """A body with head, arms and legs, one unit tall, upright in y."""
    V, F = _person(resolution)
    return V.copy(), F.copy()


def person_of_parts(around: int = 14) -> Mesh:
    """The same body as artists often build one: a closed piece around every bone, all overlapping."""
    parts = []
    for (start, end), radius in zip(_JOINTS[_BONES], _RADII, strict=True):
        V, F = worm(radius=radius, around=around, rings=13)
        along = end - start
        length = np.linalg.norm(along)
        x = along / length
        y = np.cross([0, 0, 1.0], x)
        y /= np.linalg.norm(y)
        V[:, 0] = V[:, 0] * (length + 2 * radius) - radius
        parts.append((start + V @ np.stack([x, y, np.cross(x, y)]), F))
    return joined(*parts)


def plate(cells: int = 20) -> Mesh:
    """In the plane: a rectangle from (0, 0) to (2, 1) in triangles."""
    x, y = (
        a.ravel() for a in np.meshgrid(np.linspace(0, 2, 2 * cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    )
    return np.stack([x, y], axis=1), strip(2 * cells + 1, cells + 1)


def plate_spine(bones: int = 3) -> Skeleton:
    x = np.linspace(0.2, 1.8, bones + 1)
    return chain(np.stack([x, 0.5 + 0 * x], axis=1))
