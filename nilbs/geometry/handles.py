"""Bones as handles: the points that hold a volume mesh, and the weights that are known there."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays


@dataclass(frozen=True)
class BoneConditions:
    """Known weights of a volume mesh.

    Vertices `fixed` (f,), ascending, have the weights `W_fixed` (f, b): bones that hold one vertex share it equally.
    Bones `outside` (o,) have no point inside the volume and hold the nearest vertices instead; bones `away` (a,) lie
    beyond the reach and hold nothing.
    """

    fixed: np.ndarray
    W_fixed: np.ndarray
    outside: np.ndarray
    away: np.ndarray


def bone_points(skeleton: Skeleton, *, spacing: float, most: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spaced points (s, d) of all bones and forks, and the bone (s,) of each.

    The two joints of every segment come first and are exact; between them stand one to `most` points.

    Examples
    --------
    >>> x, bone = bone_points(Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ["arm"]), spacing=0.5)
    >>> x.tolist(), bone.tolist()
    ([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0]], [0, 0, 0])
    """
    ends, bone = skeleton.segments()
    first, last = skeleton.C[ends[:, 0]], skeleton.C[ends[:, 1]]
    length = np.linalg.norm(last - first, axis=1)
    # Of a mesh without extent the spacing is zero.
    between = np.clip(np.ceil(length / max(spacing, np.finfo(float).tiny)) - 1, 1, most).astype(np.int64)
    segment = np.repeat(np.arange(len(ends)), between)
    step = np.arange(len(segment)) - np.repeat(np.cumsum(between) - between, between) + 1
    s = (step / (between[segment] + 1))[:, None]
    inner = (1 - s) * first[segment] + s * last[segment]
    return np.concatenate([first, last, inner]), np.concatenate([bone, bone, bone[segment]])


def distinct_points(x: np.ndarray, tolerance: float) -> np.ndarray:
    """Ascending indices of points of which no two are nearer than a tolerance, and every other point is near one.

    Examples
    --------
    >>> distinct_points([[0, 0], [0.1, 0], [0.3, 0]], 0.2)
    array([0, 2])
    """
    from scipy.spatial import cKDTree

    (x,) = arrays(x=(x, "s d"))
    keep = np.ones(len(x), dtype=bool)
    for i, near in enumerate(cKDTree(x).query_ball_point(x, tolerance) if len(x) else ()):
        if keep[i]:
            keep[near] = False
            keep[i] = True
    return np.flatnonzero(keep)


def bone_conditions(
    V: np.ndarray,
    vertices: np.ndarray,
    x: np.ndarray,
    bone: np.ndarray,
    inside: np.ndarray,
    *,
    bones: int,
    snap: float,
    reach: float,
) -> BoneConditions:
    """Vertices that bones hold, and the weights there.

    Only `vertices` (u,) may be held. Points x (s, d) belong to bones `bone` (s,) and lie inside the volume or not. A
    point inside holds the nearest vertex within `snap`; a bone that holds none takes the nearest ones within `reach`.

    Notes
    -----
    The conditions of section 3 of [1]_ for bones, for rigs as they are: bones on top of each other share what they
    hold, and a bone outside takes what is nearest.

    References
    ----------
    .. [1] Jacobson et al., Bounded biharmonic weights for real-time deformation, SIGGRAPH 2011,
       doi:10.1145/2010324.1964973.

    Examples
    --------
    >>> V, x = [[0, 0], [1, 0], [2, 0], [1, 1]], [[0, 0], [1, 0], [1, 0], [2, 0]]
    >>> known = bone_conditions(V, [0, 1, 2, 3], x, [0, 0, 1, 1], np.ones(4, bool), bones=2, snap=0.1, reach=1)
    >>> known.fixed.tolist(), known.W_fixed.tolist()
    ([0, 1, 2], [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    """
    from scipy.spatial import cKDTree

    V, vertices, x, bone = arrays(V=(V, "n d"), vertices=(vertices, "u", int), x=(x, "s d"), bone=(bone, "s", int))
    distance, nearest = cKDTree(V[vertices]).query(x)
    held = inside & (distance <= snap)
    without = np.ones(bones, dtype=bool)
    without[bone[held]] = False
    closest = np.full(bones, np.inf)
    np.minimum.at(closest, bone, distance)
    away = without & ~(closest <= reach)
    # A bone along the surface outside: all places that are about as near as the nearest.
    held |= (without & ~away)[bone] & (distance <= 1.5 * closest[bone] + snap)
    pairs = np.unique(np.stack([vertices[nearest[held]], bone[held]], axis=1), axis=0)
    fixed, row, count = np.unique(pairs[:, 0], return_inverse=True, return_counts=True)
    W_fixed = np.zeros((len(fixed), bones))
    W_fixed[row, pairs[:, 1]] = 1 / count[row]
    return BoneConditions(fixed, W_fixed, np.flatnonzero(without & ~away), np.flatnonzero(away))
