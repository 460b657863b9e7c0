"""Points on the zero set of a field, along segments between places of different sign."""

from collections.abc import Callable

import numpy as np

from nilbs.engine.compiled import compiled, inlined

# Rounds of secants, and parts into which every further round cuts what is left.
SECANTS, PARTS = 6, 8
# In tolerances: how long the last step may be, and by how much it may miss by what slopes predict.
LAST, MISSED = 8, 0.2


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
    Secants through the last two places where these stay between ends of different sign, else false position; what is
    left after a few rounds, as where a level jumps, is cut into several parts at once. The last step is made without a
    query if it is short and the slopes on its two sides agree.

    Examples
    --------
    >>> cubes = lambda x: 4 * x[:, 0] ** 3 - 2
    >>> x = on_zero_set(np.zeros((1, 1)), np.ones((1, 1)), [-2.0], [2.0], cubes, tolerance=1e-6)
    >>> abs(float(x[0, 0]) ** 3 - 0.5) < 3e-6
    True
    """
    low, high = (np.ascontiguousarray(ends, dtype=np.float64) for ends in (low, high))
    n = len(low)
    found, left = np.empty(low.shape), np.arange(n)
    # The part of each segment that is queried next, and what `_step` keeps of its earlier places.
    part, kept = np.empty(n), np.empty((n, 4))
    _begin(np.asarray(level_low, dtype=np.float64), np.asarray(level_high, dtype=np.float64), part, kept)
    for _ in range(SECANTS):
        x = np.empty((len(left), low.shape[1]))
        _places(low, high, left, part, 0.0, x)
        left = left[: _step(low, high, np.asarray(values(x)), left, part, kept, tolerance)]
    low_left, along, a, b = low[left], high[left] - low[left], kept[left, 0], kept[left, 2]
    while len(left) and (np.abs(b - a) * np.linalg.norm(along, axis=1)).max() > tolerance:
        parts = a[:, None] + (b - a)[:, None] * np.linspace(0, 1, PARTS + 1)
        x = low_left[:, None] + parts[:, 1:-1, None] * along[:, None]
        level = np.asarray(values(x.reshape(-1, low.shape[1]))).reshape(len(left), PARTS - 1)
        changed = np.ones((len(left), PARTS), dtype=bool)
        changed[:, :-1] = (level < 0) != (kept[left, 1] < 0)[:, None]
        last = changed.argmax(axis=1)[:, None]
        a, b = (np.take_along_axis(parts, k, axis=1)[:, 0] for k in (last, last + 1))
    part[left] = (a + b) / 2
    _places(low, high, np.arange(n), part, 0.25 * tolerance, found)
    return found


@compiled
def _begin(level_low, level_high, part, kept):  # type: ignore[no-untyped-def]
    """Start with the ends of segments, and where the line between their levels is zero."""
    for i in range(part.shape[0]):
        f, g = level_low[i], level_high[i]
        kept[i, 0], kept[i, 1], kept[i, 2], kept[i, 3] = 0.0, f, 1.0, g
        part[i] = f / (f - g)


@compiled
def _places(low, high, left, part, margin, x):  # type: ignore[no-untyped-def]
    """Write parts of segments as points, not nearer to an end than a margin."""
    for n in range(left.shape[0]):
        i = left[n]
        s = part[i]
        if margin > 0:
            least = min(margin / _length(low, high, i), 0.5)
            s = min(max(s, least), 1 - least)
        for r in range(x.shape[1]):
            x[n, r] = low[i, r] + s * (high[i, r] - low[i, r])


@inlined
def _length(low, high, i):  # type: ignore[no-untyped-def]
    squared = 0.0
    for r in range(low.shape[1]):
        squared += (high[i, r] - low[i, r]) ** 2
    return np.sqrt(squared)


@compiled
def _step(low, high, level, left, part, kept, tolerance):  # type: ignore[no-untyped-def]
    """Write the next parts, keep the segments that need another query and return how many there are.

    Kept are the part a beyond the zero and the last one b, with their levels.
    """
    count = 0
    for n in range(left.shape[0]):
        i = left[n]
        # The last place becomes the one before it, c.
        a, f_a, c, f_c = kept[i, 0], kept[i, 1], kept[i, 2], kept[i, 3]
        b, f_b = part[i], level[n]
        before, behind = (f_b - f_a) / (b - a), (f_c - f_b) / (c - b)
        if (f_b < 0) == (f_a < 0):
            a, f_a = c, f_c
        size = _length(low, high, i)
        s = b - f_b * (b - c) / (f_b - f_c)
        if not (s - a) * (s - b) < 0:
            s = b - f_b * (b - a) / (f_b - f_a)
        short = abs(a - b) * size < tolerance
        # The step misses the zero by about the part of it by which the slopes on the two sides differ.
        missed = abs(s - b) * size * abs(before - behind) / max(abs(before), abs(behind))
        near = missed < MISSED * tolerance and max(abs(s - b) * size, abs(f_b)) < LAST * tolerance
        if short:
            s = (a + b) / 2
        kept[i, 0], kept[i, 1], kept[i, 2], kept[i, 3] = a, f_a, b, f_b
        part[i] = s
        if not (short or near):
            left[count] = i
            count += 1
    return count
