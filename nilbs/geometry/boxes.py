"""Boxes that overlap, among many."""

from collections.abc import Iterator

import numpy as np

_CHUNK = 2**18  # pairs compared together


def overlapping_boxes(lower: np.ndarray, upper: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Iterate over the pairs of boxes that overlap, as arrays first and second (p,), each pair once.

    The boxes are given by their corners (m, d), m at least 1. A tree halves the boxes by their middles, and two copies
    of it are walked together: time m log m if each box overlaps few others.

    Examples
    --------
    >>> [pair] = overlapping_boxes(np.array([[0.0], [1.0], [5.0]]), np.array([[2.0], [3.0], [6.0]]))
    >>> sorted(np.concatenate(pair).tolist())
    [0, 1]
    """
    m = len(lower)
    depth = max(m - 1, 0).bit_length()
    order = np.arange(m)
    middle = lower + upper
    for level in range(depth):
        start = np.arange(2**level) * m // 2**level  # where nodes start in the order
        node = np.searchsorted(start, np.arange(m), side="right") - 1
        spread = np.maximum.reduceat(middle[order], start) - np.minimum.reduceat(middle[order], start)
        axis = spread.argmax(axis=1)[node]
        order = order[np.lexsort((middle[order, axis], node))]
    # Boxes of the tree, level by level; some nodes of the last level are empty.
    start = np.arange(2**depth) * m // 2**depth
    empty = start == np.arange(1, 2**depth + 1) * m // 2**depth
    low = np.where(empty[:, None], np.inf, lower[order[np.minimum(start, m - 1)]])
    high = np.where(empty[:, None], -np.inf, upper[order[np.minimum(start, m - 1)]])
    levels = [(low, high)]
    while len(low) > 1:
        low, high = np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])
        levels.append((low, high))
    levels.reverse()
    waiting = [(0, np.zeros(1, np.int64), np.zeros(1, np.int64))]
    while waiting:
        level, a, b = waiting.pop()
        if len(a) > _CHUNK:
            half = len(a) // 2
            waiting += [(level, a[:half], b[:half]), (level, a[half:], b[half:])]
            continue
        low, high = levels[level]
        meet = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        a, b = a[meet], b[meet]
        if level == depth:
            different = a < b
            if different.any():
                yield order[start[a[different]]], order[start[b[different]]]
            continue
        two = a < b
        first = np.concatenate([2 * a, 2 * a, 2 * a + 1, 2 * a[two] + 1])
        second = np.concatenate([2 * b, 2 * b + 1, 2 * b + 1, 2 * b[two]])
        waiting.append((level + 1, first, second))
