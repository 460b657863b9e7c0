"""The plane z = 0 within space: what is flat, in three dimensions."""

from dataclasses import replace

import numpy as np

from nilbs.geometry.skeleton import Skeleton


def in_space(x: np.ndarray) -> np.ndarray:
    """Points in three dimensions: those of the plane at z = 0.

    Parameters
    ----------
    x : (n, d) float array
        Points; d is 2 or 3.

    Returns
    -------
    x : (n, 3) float array

    Examples
    --------
    >>> in_space(np.ones((1, 2)))
    array([[1., 1., 0.]])
    """
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def counter_clockwise(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Flat triangles, those that run clockwise turned.

    Parameters
    ----------
    V : (n, 2) float array
    E : (m, 3) int array

    Returns
    -------
    E : (m, 3) int array

    Examples
    --------
    >>> counter_clockwise(np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1, 2], [0, 2, 1]])).tolist()
    [[0, 1, 2], [0, 1, 2]]
    """
    V = V / (np.abs(V).max(initial=0) or 1.0)  # so that no product overflows
    a, b = V[E[:, 1]] - V[E[:, 0]], V[E[:, 2]] - V[E[:, 0]]
    clockwise = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
    return np.where(clockwise[:, None], E[:, [0, 2, 1]], E)


def skeleton_in_space(skeleton: Skeleton) -> Skeleton:
    """Skeleton in three dimensions.

    Parameters
    ----------
    skeleton : Skeleton

    Returns
    -------
    skeleton : Skeleton

    Examples
    --------
    >>> skeleton_in_space(Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ("arm",))).d
    3
    """
    return replace(skeleton, C=in_space(skeleton.C))


def transforms_in_space(B: np.ndarray) -> np.ndarray:
    """Transforms in three dimensions: those of the plane leave z as it is.

    Parameters
    ----------
    B : (..., d+1, d+1) float array
        Homogeneous transforms; d is 2 or 3.

    Returns
    -------
    B : (..., 4, 4) float array

    Examples
    --------
    >>> transforms_in_space(np.array([[1.0, 0, 5], [0, 1, 6], [0, 0, 1]]))[:3, 3]
    array([5., 6., 0.])
    """
    if B.shape[-1] == 4:
        return B
    lifted = np.broadcast_to(np.eye(4), (*B.shape[:-2], 4, 4)).copy()
    plane = np.array([0, 1, 3])
    lifted[..., plane[:, None], plane] = B
    return lifted
