"""Linear blend skinning of points, and its inverse where the weights are known."""

import numpy as np

from nilbs.geometry.validation import arrays


def linear_blend_skinning(V: np.ndarray, W: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Move points by a weighted blend of bone transforms.

    Parameters
    ----------
    V : (n, d) float array
        Rest positions, in mesh units; d is 2 or 3.
    W, B : (n, b) and (b, d+1, d+1) float arrays
        Skinning weights, whose rows sum to one; bone transforms, rest to posed, acting on column vectors (x, 1).

    Returns
    -------
    U : (n, d) float array
        Posed positions, in mesh units.

    Raises
    ------
    ValueError
        If V, W and B disagree on n, b or d.

    Notes
    -----
    U_i = sum_b W_ib B_b V_i, eq. 1 to 3 of [1]_. A blend of rotations is not a rotation: U shrinks near bent joints.

    References
    ----------
    .. [1] Jeruzalski et al., NiLBS: Neural Inverse Linear Blend Skinning, 2020, arXiv:2004.05980.

    Examples
    --------
    >>> stay, lift = np.eye(3), np.array([[1, 0, 0], [0, 1, 2], [0, 0, 1]])
    >>> linear_blend_skinning([[0, 0], [1, 0]], [[1, 0], [0.5, 0.5]], [stay, lift])
    array([[0., 0.],
           [1., 1.]])
    """
    V, W, B = arrays(V=(V, "n d"), W=(W, "n b"), B=(B, "b d+1 d+1"))
    A, t = _blends(W, B)
    return (A @ V[:, :, None])[:, :, 0] + t


def inverse_linear_blend_skinning(x: np.ndarray, W: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Move posed points back to the rest frame by inverting their blended bone transform.

    Parameters
    ----------
    x : (n, d) float array
        Posed positions, in mesh units; d is 2 or 3.
    W, B : (n, b) and (b, d+1, d+1) float arrays
        Skinning weights, whose rows sum to one; bone transforms, rest to posed, acting on column vectors (x, 1).

    Returns
    -------
    x_rest : (n, d) float array
        Rest positions, in mesh units. Where a blend is singular (opposite rotations in equal parts) it has no inverse
        and the point is undefined: nan.

    Raises
    ------
    ValueError
        If x, W and B disagree on n, b or d.

    Notes
    -----
    x_rest = [sum_b W_b B_b]^-1 x, eq. 6 of [1]_: the *blend* is inverted. A blend of inverses (what several published
    codes do) is another map, and loses volume.

    References
    ----------
    .. [1] Jeruzalski et al., NiLBS: Neural Inverse Linear Blend Skinning, 2020, arXiv:2004.05980.

    Examples
    --------
    >>> stay, lift = np.eye(3), np.array([[1, 0, 0], [0, 1, 2], [0, 0, 1]])
    >>> inverse_linear_blend_skinning([[1, 1]], [[0.5, 0.5]], [stay, lift])
    array([[1., 0.]])
    """
    x, W, B = arrays(x=(x, "n d"), W=(W, "n b"), B=(B, "b d+1 d+1"))
    A, t = _blends(W, B)
    # A determinant at the level of rounding, against the bones' own size: the blend has collapsed the neighbourhood.
    scale = np.abs(W) @ np.abs(B[:, :-1, :-1]).max(axis=(1, 2), initial=0)
    singular = np.abs(np.linalg.det(A)) <= 1e-14 * np.maximum(scale, 1e-100) ** x.shape[1]
    A[singular] = np.eye(x.shape[1])
    x_rest = np.linalg.solve(A, (x - t)[:, :, None])[:, :, 0]
    x_rest[singular] = np.nan
    return x_rest


def _blends(W: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear part (n, d, d) and translation (n, d) of every point's blended transform."""
    b, d = B.shape[0], B.shape[1] - 1
    blend = (W @ B[:, :d].reshape(b, -1)).reshape(len(W), d, d + 1)
    return blend[:, :, :d].copy(), blend[:, :, d]
