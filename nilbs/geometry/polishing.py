"""Points moved onto the zero set of a field along segments."""

from collections.abc import Callable

import numpy as np

# Rounds of queries, and after how many of them every second one halves what is left.
ROUNDS, SECANTS = 50, 6
# A step shorter than this many tolerances, from a level as small, needs no query: it lands within one.
LAST = 8


def on_zero_set(
    low: np.ndarray,
    high: np.ndarray,
    level_low: np.ndarray,
    level_high: np.ndarray,
    values: Callable[[np.ndarray], np.ndarray],
    *,
    tolerance: float,
) -> np.ndarray:
    """Where a field changes sign between points.

    Parameters
    ----------
    low, high : (n, d) float arrays
        Ends of segments.
    level_low, level_high : (n,) float arrays
        Levels there, of which one is negative and the other is not.
    values : function of (k, d) points
        Returns the levels (k,).
    tolerance : float
        A length: how far from a change of sign a point may be.

    Returns
    -------
    x : (n, d) float array
        Points on the segments, not quite at their ends, so that those of different segments differ.

    Notes
    -----
    Secants through the last two places where these stay between ends of different sign, else false position; where a
    level jumps, halving. The last step is made without a query if it is short.

    Examples
    --------
    >>> x = on_zero_set(np.zeros((1, 1)), np.ones((1, 1)), [-2.0], [2.0], lambda x: x[:, 0] ** 3 * 4 - 2, tolerance=1e-6)
    >>> abs(float(x[0, 0]) ** 3 - 0.5) < 3e-6
    True
    """
    along = high - low
    length = np.linalg.norm(along, axis=1)
    place, left, reach = np.empty(len(low)), np.arange(len(low)), LAST * tolerance
    # In parts of the segments: the end beyond the zero, the last place, and the one before it, with their levels.
    a, f_a = np.zeros(len(low)), np.array(level_low, dtype=np.float64)
    b, f_b = np.ones(len(low)), np.array(level_high, dtype=np.float64)
    s = f_a / (f_a - f_b)
    for k in range(ROUNDS):
        b, f_b, c, f_c = s, values(low[left] + s[:, None] * along[left]), b, f_b
        passed = (f_b < 0) == (f_a < 0)
        a, f_a = np.where(passed, c, a), np.where(passed, f_c, f_a)
        middle = (a + b) / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            s = b - f_b * (b - c) / (f_b - f_c)
        s = np.where((s - a) * (s - b) < 0, s, b - f_b * (b - a) / (f_b - f_a))
        s = s if k < SECANTS or k % 2 else middle
        size = length[left]
        near = (np.abs(s - b) * size < reach) & (np.abs(f_b) < reach)
        short = np.abs(a - b) * size < tolerance
        place[left] = np.where(short, middle, s)
        keep = ~(near | short)
        if not keep.any():
            break
        left, a, f_a, b, f_b, c, f_c, s = (array[keep] for array in (left, a, f_a, b, f_b, c, f_c, s))
    shortest = 0.25 * tolerance / length
    return low + np.clip(place, shortest, 1 - shortest)[:, None] * along
