"""Given weights, whatever was painted, as weights that skinning can use: every row on the simplex."""

import numpy as np
from scipy.spatial import cKDTree

from nilbs.geometry.validation import arrays

_TOLERANCE = 1e-6  # of weights below zero and of row sums beside one; less is rounding, and not reported


def weights_on_simplex(
    W: np.ndarray, V: np.ndarray, *, numbers: np.ndarray | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Make rows of given weights non-negative and sum to one; also a sentence on every kind of change.

    Negative weights become zero; rows are divided by their sums; a row without weight becomes that of the nearest
    vertex that has some. The notes use `numbers` (n,) for the vertices.

    Examples
    --------
    >>> W, notes = weights_on_simplex([[2.0, 2], [0, 1], [0, 0]], [[0, 0], [1, 0], [3, 0]])
    >>> W.tolist()
    [[0.5, 0.5], [0.0, 1.0], [0.0, 1.0]]
    >>> for note in notes:
    ...     print(note)
    1 of 3 vertices have weights that do not sum to one (4 to 4): they are normalised
    1 of 3 vertices have no weight, vertex 2 first: they move as the nearest vertex that has some
    """
    W, V = arrays(W=(W, "n b"), V=(V, "n d"))
    n = len(W)
    numbers = np.arange(n) if numbers is None else numbers
    notes = []
    lowest = W.min(axis=1, initial=0)
    below = lowest < -_TOLERANCE
    if below.any():
        worst = int(lowest.argmin())
        notes.append(
            f"{int(below.sum())} of {n} vertices have weights below zero, down to {lowest[worst]:.3g} at vertex "
            f"{numbers[worst]}: they count as zero"
        )
    W = np.maximum(W, 0)
    largest = W.max(axis=1, initial=0)
    empty = largest == 0
    if empty.all():
        raise ValueError("no vertex has any weight: solve for weights instead, or give others")
    W = W / np.where(empty, 1, largest)[:, None]  # so that no sum overflows
    scaled = np.where(empty, 1, W.sum(axis=1))
    W /= scaled[:, None]
    with np.errstate(over="ignore"):
        sums = np.where(empty, 1, scaled * largest)
    off = np.abs(sums - 1) > _TOLERANCE
    if off.any():
        least, most = sums[off].min(), sums[off].max()
        notes.append(
            f"{int(off.sum())} of {n} vertices have weights that do not sum to one ({least:.3g} to {most:.3g}): they "
            "are normalised"
        )
    if empty.any():
        notes.append(
            f"{int(empty.sum())} of {n} vertices have no weight, vertex {numbers[int(empty.argmax())]} first: they "
            "move as the nearest vertex that has some"
        )
        _, nearest = cKDTree(V[~empty]).query(V[empty])
        W[empty] = W[~empty][nearest]
    return W, tuple(notes)
