"""Frames of a motion blended with the rest pose: the plain way to keep parts apart, where a search for less begins."""

from collections.abc import Callable

import numpy as np

from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.least_change import least_change, smoothing_inverse

# Halvings of the share of the rest pose; and how often a smooth blend that is not clear is increased.
HALVINGS, INCREASES = 6, 12

# Frames (f,) and their poses (f, b, d+1, d+1) to whether they are not clear (f,).
Bad = Callable[[np.ndarray, np.ndarray], np.ndarray]


def to_rest(changes: JointChanges, frames: np.ndarray) -> np.ndarray:
    """The turns (f, b, 1 or 3) that take the joints of frames to rest; none of roots.

    A share of such a turn leaves so much less of the joint's rotation.
    """
    turns = -changes.rotations(frames)
    turns[:, changes.P < 0] = 0
    return turns


def smallest_blend(
    changes: JointChanges, run: np.ndarray, bad: Bad, *, smooth: float, ends: tuple[bool, bool]
) -> np.ndarray | None:
    """The turns (f, b, 1 or 3) of the smallest smooth blend of frames with the rest pose that is clear.

    Parameters
    ----------
    changes : JointChanges
    run : (f,) int array
        Frames that follow each other.
    bad : function
    smooth : float
        As for `nilbs.contacts.least_change.smoothing_inverse`.
    ends : (bool, bool)
        Whether the frames before and after are held as they are.

    Returns
    -------
    turns : (f, b, 1 or 3) float array, or None
        None if no blend is clear.

    Notes
    -----
    Each frame's share is found by bisection; then shares are the least that are smooth and not below these, increased
    where frames are not clear.
    """
    turns = to_rest(changes, run)

    def at(share: np.ndarray) -> np.ndarray:
        moved: np.ndarray = share[:, None, None] * turns
        return moved

    def is_bad(share: np.ndarray, which: np.ndarray) -> np.ndarray:
        return bad(run[which], changes.turned(run[which], at(share)[which]))

    low, high = np.zeros(len(run)), np.ones(len(run))
    some = np.flatnonzero(is_bad(low, np.arange(len(run))))
    high[np.setdiff1d(np.arange(len(run)), some)] = 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        wrong = is_bad(middle, some)
        low[some[wrong]], high[some[~wrong]] = middle[some[wrong]], middle[some[~wrong]]
    inverse = smoothing_inverse(len(run), smooth, from_rest=ends[0], to_rest=ends[1])
    least = high
    for _ in range(INCREASES):
        share = least_change(np.arange(len(run)), np.ones((len(run), 1)), least, inverse, smooth=smooth)[:, 0]
        share = np.clip(share, 0.0, 1.0)
        wrong = is_bad(share, np.arange(len(run)))
        if not wrong.any():
            return at(share)
        least = np.where(wrong, np.minimum(1.05 * np.maximum(share, least) + 0.02, 1.2), least)
    return None
