"""Changes of a motion moved towards another that is clear: the rest pose's, or one that was found before."""

from collections.abc import Callable

import numpy as np

from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.least_change import least_change, smoothing_inverse

# Halvings of a share, and how often smooth shares that are not clear are increased, by more each time.
HALVINGS, INCREASES, INCREASE = 6, 12, 0.02
# Shares below this are none.
LEAST = 1e-3

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
    """The turns (f, b, 1 or 3) of the smallest smooth blend of frames (f,) with the rest pose that is clear.

    As of `smallest_move`, from no turns at all.
    """
    turns = to_rest(changes, run)
    return smallest_move(changes, run, np.zeros_like(turns), turns, bad, smooth=smooth, ends=ends)


def smallest_move(
    changes: JointChanges,
    run: np.ndarray,
    start: np.ndarray,
    target: np.ndarray,
    bad: Bad,
    *,
    smooth: float,
    ends: tuple[bool, bool],
) -> np.ndarray | None:
    """The turns of frames that are moved from some turns towards others as little as is clear.

    Parameters
    ----------
    changes : JointChanges
    run : (f,) int array
        Frames that follow each other.
    start, target : (f, b, 1 or 3) float array
    bad : function
    smooth : float
        As for `nilbs.contacts.least_change.smoothing_inverse`.
    ends : (bool, bool)
        Whether the frames before and after are held as they are.

    Returns
    -------
    turns : (f, b, 1 or 3) float array, or None
        None if no smooth move is clear.

    Notes
    -----
    Each frame's share of the move is found by bisection; then shares are the least that are smooth and not below these,
    increased where frames are not clear.
    """

    def at(share: np.ndarray) -> np.ndarray:
        moved: np.ndarray = start + share[:, None, None] * (target - start)
        return moved

    def is_bad(share: np.ndarray, which: np.ndarray) -> np.ndarray:
        return bad(run[which], changes.turned(run[which], at(share)[which]))

    low, high = np.zeros(len(run)), np.ones(len(run))
    every = np.arange(len(run))
    some = np.flatnonzero(is_bad(low, every))
    high[np.setdiff1d(every, some)] = 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        wrong = is_bad(middle, some)
        low[some[wrong]], high[some[~wrong]] = middle[some[wrong]], middle[some[~wrong]]
    inverse = smoothing_inverse(len(run), smooth, held_before=ends[0], held_after=ends[1])
    # The share of each frame that was found to be clear.
    least, is_clear = high, np.where(np.isin(every, some), np.nan, 0.0)
    for k in range(INCREASES):
        share = least_change(every, np.ones((len(run), 1)), least, inverse, smooth=smooth)[:, 0]
        share = np.where((share < LEAST) & (least == 0), 0.0, np.clip(share, 0.0, 1.0))
        tested = np.flatnonzero(share != is_clear)
        wrong = tested[is_bad(share, tested)]
        if not len(wrong):
            return at(share)
        is_clear[tested] = share[tested]
        is_clear[wrong] = np.nan
        least = least.copy()
        least[wrong] = np.minimum(1.05 * np.maximum(share, least)[wrong] + (k + 1) * INCREASE, 1.2)
    return None
