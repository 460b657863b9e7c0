"""What a rig is like beside the surface that it should move."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from nilbs.geometry.bone_names import marks_end
from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.topology import group_labels
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import occupancy

_ON_TOP = 1e-6  # of the rig's extent: joints that are nearer coincide
_SAMPLES = 9  # points between the joints of a bone
# Metres, centimetres, millimetres, inches and feet among each other.
_FACTORS = (1.0, *(f**sign for f in (10, 100, 1000, 2.54, 25.4, 39.37, 30.48, 3.281) for sign in (1, -1)))
_SMALL = 0.05  # of the surface's extent: a smaller rig is in doubt, and
_FITTING = 0.25  # how large one must be at least that is suggested instead
_ALIKE = (0.45, 1.3)  # how large one is, of the surface's extent, whose unit is not in doubt
_SLACK = 0.05  # of the surface's extent: how far joints may lie outside its box


@dataclass(frozen=True)
class RigReport:
    """A rig in a surface: joints of bones that lie `outside`, bones `without_volume`, of which no part lies inside.

    `suggestion` describes how the rig would fit if it seems to be in another unit or frame than the surface.
    """

    outside: np.ndarray
    without_volume: np.ndarray
    suggestion: str | None


def rig_report(V: np.ndarray, F: np.ndarray, skeleton: Skeleton) -> RigReport:
    """Examine a rig and the surface that it moves; the winding number decides what is inside.

    Examples
    --------
    >>> V, F = [[0, 0], [4, 0], [4, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> skeleton = Skeleton([[1, 0.5], [3, 0.5], [9, 0.5], [8, 0.5]], [[0, 1], [1, 2], [2, 3]], [-1, 0, 1], "abc")
    >>> report = rig_report(V, F, skeleton)
    >>> report.outside.tolist(), report.without_volume.tolist()
    ([2, 3], [2])
    """
    C, BE = skeleton.C, skeleton.BE
    V, F, C = arrays(V=(V, "n d"), F=(F, "m d", int), C=(C, "k d"))
    joints = np.unique(BE)
    inside = np.zeros(len(C), dtype=bool)
    inside[joints] = occupancy(V, F, C[joints])
    s = (np.arange(1, _SAMPLES + 1) / (_SAMPLES + 1))[:, None]
    between = (1 - s) * C[BE[:, :1]] + s * C[BE[:, 1:]]
    partly = occupancy(V, F, between.reshape(-1, V.shape[1])).reshape(-1, _SAMPLES).any(axis=1) | inside[BE].any(axis=1)
    return RigReport(
        outside=joints[~inside[joints]],
        without_volume=np.flatnonzero(~partly),
        suggestion=frame_suggestion(V, F, C[joints]),
    )


def tips(skeleton: Skeleton) -> np.ndarray:
    """Bones (t,) that exporters add where others end: they are called so, as is all that hangs from them.

    Examples
    --------
    >>> names = ("head", "head_end", "head_end_end")
    >>> tips(Skeleton([[0, 0], [0, 1], [0, 2]], [[0, 1], [1, 2], [2, 2]], [-1, 0, 1], names)).tolist()
    [1, 2]
    """
    is_tip = np.array([marks_end(name) for name in skeleton.names])
    is_tip &= (skeleton.P >= 0) & ~np.isin(np.arange(len(is_tip)), skeleton.forks[:, 0])
    for bone in bone_order(skeleton.P)[::-1]:
        if skeleton.P[bone] >= 0 and not is_tip[bone]:
            is_tip[skeleton.P[bone]] = False
    return np.flatnonzero(is_tip)


def coincident_joints(skeleton: Skeleton) -> np.ndarray:
    """Joints (c,) that lie on an earlier one, except a bone's start on its parent's end.

    Places nearer than 1e-6 of the rig's extent are one.

    Examples
    --------
    >>> C, BE = [[0, 0], [1, 0], [1, 0], [2, 0], [2, 0], [3, 0]], [[0, 1], [2, 3], [4, 5]]
    >>> coincident_joints(Skeleton(C, BE, [-1, 0, 0], "abc")).tolist()
    [4]
    """
    from scipy.spatial import cKDTree

    C, BE, P = skeleton.C, skeleton.BE, skeleton.P
    near = _ON_TOP * float(np.ptp(C, axis=0).max())
    child = np.flatnonzero(P >= 0)
    end, start = BE[P[child], 1], BE[child, 0]
    meet = np.linalg.norm(C[end] - C[start], axis=1) <= near
    one = group_labels(end[meet], start[meet], len(C))
    pairs = cKDTree(C).query_pairs(near, output_type="ndarray").reshape(-1, 2)
    pairs = pairs[one[pairs[:, 0]] != one[pairs[:, 1]]]
    return np.unique(pairs.max(axis=1, initial=0))


def frame_suggestion(V: np.ndarray, F: np.ndarray, C: np.ndarray) -> str | None:
    """A sentence on the change of unit or axes that puts most joints inside, or on where the rig lies instead.

    None if the joints (k, d) fit as they are.

    Examples
    --------
    >>> V, F = [[1, 1], [5, 1], [5, 2], [1, 2]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> frame_suggestion(V, F, [[0.02, 0.015], [0.04, 0.015]])
    'the rig is in another unit: with its joints times 100, 2 of 2 lie inside the mesh instead of 0'
    """
    V, F, C = arrays(V=(V, "n d"), F=(F, "m d", int), C=(C, "k d"))
    if not len(F) or not len(C):
        return None
    used = V[np.unique(F)]
    lower, upper = used.min(axis=0), used.max(axis=0)
    size, extent = float((upper - lower).max()), float(np.ptp(C, axis=0).max())
    now = int(occupancy(V, F, C).sum())
    if 2 * now >= len(C) and (extent >= _SMALL * size or len(C) < 3):
        return None
    best: tuple[int, str] | None = None
    in_doubt = not _ALIKE[0] <= extent / size <= _ALIKE[1] if size else False
    for factor, axes, moved in _candidates(C, _FACTORS if in_doubt else _FACTORS[:1]):
        fits = (moved >= lower - _SLACK * size).all() and (moved <= upper + _SLACK * size).all()
        if fits and np.ptp(moved, axis=0).max() >= _FITTING * size:
            inside = int(occupancy(V, F, moved).sum())
            if 2 * inside >= len(C) and inside > (best[0] if best else now if extent >= _SMALL * size else 0):
                best = inside, _in_words(factor, axes)
    if best:
        return f"{best[1]}, {best[0]} of {len(C)} lie inside the mesh instead of {now}"
    apart = np.maximum(np.maximum(lower - C.max(axis=0), C.min(axis=0) - upper), 0)
    if extent < _SMALL * size or extent > size / _SMALL:
        ratio, how = (size / extent, "smaller") if 0 < extent < size else (extent / size, "larger")
        return f"the rig's box is {ratio:.3g} x {how} than the mesh's" if extent else "the rig is one point"
    if apart.max() > 0:
        shift = (lower + upper) / 2 - (C.min(axis=0) + C.max(axis=0)) / 2
        by = ", ".join(f"{s:.3g}" for s in shift)
        return f"the rig's box lies beside the mesh's: moved by ({by}) its joints would meet it"
    return None


def _candidates(C: np.ndarray, factors: Sequence[float]) -> Iterator[tuple[float, np.ndarray | None, np.ndarray]]:
    """Joints in other units and frames, simple ones first: factor, axes in new order (from 1, signed), points."""
    d = C.shape[1]
    turns = [
        np.array(order) * signs
        for order in permutations(range(1, d + 1))
        for signs in product((1, -1), repeat=d)
        if np.linalg.det(np.eye(d)[np.array(order) - 1] * np.array(signs)[:, None]) > 0
    ]
    # Of simple ones those that exchange two axes come first: one of these is up.
    turns.sort(key=lambda turn: ((turn != np.arange(1, d + 1)).sum(), (np.abs(turn) == np.arange(1, d + 1)).all()))
    for factor in factors:
        yield factor, None, factor * C
    for factor in factors:
        for turn in turns[1:]:
            yield factor, turn, factor * np.sign(turn) * C[:, np.abs(turn) - 1]


def _in_words(factor: float, turn: np.ndarray | None) -> str:
    by = f"times {factor:.6g}" if factor >= 1 else f"divided by {1 / factor:.6g}"
    if turn is None:
        return f"the rig is in another unit: with its joints {by}"
    axes = ", ".join("-" * int(axis < 0) + "xyz"[abs(axis) - 1] for axis in turn)
    text = f"the rig is in another frame: with ({', '.join('xyz'[: len(turn)])}) of its joints taken as ({axes})"
    return text if factor == 1 else f"{text} and {by}"
