"""The plane z = 0 and space: which points are flat, and from two dimensions to three and back."""

import numpy as np

# What leaves the plane by less is flat: of the extent of most points, or of the largest entry of all transforms.
FLAT = 1e-6


def is_flat(x: np.ndarray) -> bool:
    """Whether points (n, d) are planar, or lie at z = 0.

    Examples
    --------
    >>> is_flat(np.array([[0.0, 0, 0], [1, 2, 1e-9]])), is_flat(np.array([[0.0, 0, 0], [1, 2, 1e-3]]))
    (True, False)
    """
    if x.shape[1] == 2 or not x[:, 2].any():
        return True
    with np.errstate(invalid="ignore"):
        x = x / np.abs(x).max()  # so that no difference overflows
        # Four median distances from the middle: one stray point far away must not flatten all others.
        extent = 4 * np.median(np.linalg.norm(x - np.median(x, axis=0), axis=1))
        return bool((np.abs(x[:, 2]) <= FLAT * extent).all())


def flattened(x: np.ndarray) -> np.ndarray:
    """Points (n, d) in two dimensions if they are flat, else as they are."""
    return x[:, :2].copy() if x.shape[1] == 3 and is_flat(x) else x


def in_space(x: np.ndarray) -> np.ndarray:
    """Points (n, d) in three dimensions: planar ones at z = 0.

    Examples
    --------
    >>> in_space(np.ones((1, 2)))
    array([[1., 1., 0.]])
    """
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def transforms_in_space(B: np.ndarray) -> np.ndarray:
    """Transforms (..., d+1, d+1) in three dimensions: those of the plane leave z as it is.

    Examples
    --------
    >>> transforms_in_space(np.array([[1.0, 0, 5], [0, 1, 6], [0, 0, 1]]))[:3, 3]
    array([5., 6., 0.])
    """
    if B.shape[-1] == 4:
        return B
    lifted = np.broadcast_to(np.eye(4), (*B.shape[:-2], 4, 4)).copy()
    lifted[..., [[0], [1], [3]], [0, 1, 3]] = B
    return lifted


def transforms_in_plane(B: np.ndarray) -> np.ndarray:
    """Transforms (t, b, 4, 4) that keep the plane z = 0, as (t, b, 3, 3); ValueError if one leaves it.

    Examples
    --------
    >>> transforms_in_plane(np.eye(4)[None, None]).shape
    (1, 1, 3, 3)
    """
    across = np.abs(B[..., 2, [0, 1, 3]]).max(axis=-1) + np.abs(B[..., :2, 2]).max(axis=-1)
    leaving = np.argwhere(across > FLAT * np.abs(B).max(initial=0))
    if len(leaving):
        raise ValueError("frame {} moves bone {} out of the plane of a flat character".format(*leaving[0]))
    return B[..., [[0], [1], [3]], [0, 1, 3]]


def counter_clockwise(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Triangles (m, 3) of the plane, the clockwise ones turned around.

    Examples
    --------
    >>> counter_clockwise(np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1, 2], [0, 2, 1]])).tolist()
    [[0, 1, 2], [0, 1, 2]]
    """
    V = V / (np.abs(V).max(initial=0) or 1.0)  # so that no product overflows
    a, b = V[E[:, 1]] - V[E[:, 0]], V[E[:, 2]] - V[E[:, 0]]
    clockwise = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
    return np.where(clockwise[:, None], E[:, [0, 2, 1]], E)
