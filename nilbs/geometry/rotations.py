"""Rotations and rigid motions of the plane and of space, by the same functions."""

import numpy as np

from nilbs.geometry.quaternions import quaternions
from nilbs.geometry.validation import arrays


def rotation_matrices(theta: np.ndarray) -> np.ndarray:
    """Rotation matrices of rotation vectors (3D) or angles (2D).

    Parameters
    ----------
    theta : (..., 1) or (..., 3) float array
        Angles in the plane, or axis times angle in space, in radians.

    Returns
    -------
    R : (..., d, d) float array
        Rotations acting on column vectors; d is 2 for angles and 3 for rotation vectors.

    Raises
    ------
    ValueError
        If the last dimension is neither 1 nor 3.

    Notes
    -----
    Rodrigues' formula, R = I + sin(a)/a K + (1 - cos(a))/a^2 K^2, with both quotients written so that they need no
    epsilon at a = 0: R is orthogonal to rounding at every angle.

    Examples
    --------
    >>> rotation_matrices([np.pi / 2]).round(6) + 0.0
    array([[ 0., -1.],
           [ 1.,  0.]])
    """
    (theta,) = arrays(theta=(theta, "... r"))
    if theta.shape[-1] == 1:
        c, s = np.cos(theta[..., 0]), np.sin(theta[..., 0])
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    if theta.shape[-1] != 3:
        raise ValueError(f"theta must be (..., 1) in the plane or (..., 3) in space, got {theta.shape}")
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    K = _cross_matrices(theta)
    # np.sinc(x) is sin(pi x)/(pi x) and is exact at zero; 1 - cos(a) = 2 sin(a/2)^2 loses no digits near zero.
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (K @ K)


def rotation_vectors(R: np.ndarray) -> np.ndarray:
    """Rotation vectors (3D) or angles (2D) of rotation matrices; the inverse of `rotation_matrices`.

    Parameters
    ----------
    R : (..., d, d) float array
        Rotations.

    Returns
    -------
    theta : (..., 1) or (..., 3) float array
        Radians; the angle lies in [-pi, pi] in the plane and in [0, pi] in space.

    Raises
    ------
    ValueError
        If R is not square of size 2 or 3.

    Notes
    -----
    In space by way of the unit quaternion, so that neither a tiny angle nor one near pi loses digits.

    Examples
    --------
    >>> rotation_vectors(rotation_matrices([0.0, 0.3, 0.0])).round(6)
    array([0. , 0.3, 0. ])
    """
    (R,) = arrays(R=(R, "... d d"))
    if R.shape[-1] == 2:
        return np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])[..., None]
    q = quaternions(R)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    # angle / sine tends to 2 where the sine vanishes, because q then holds half of the rotation vector.
    scale = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 1e-150)
    return scale * q[..., :3]


def rigid_transforms(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Homogeneous transforms x -> R x + t.

    Parameters
    ----------
    R : (..., d, d) float array
        Linear parts.
    t : (..., d) float array
        Translations; leading dimensions broadcast against those of R.

    Returns
    -------
    B : (..., d+1, d+1) float array
        Transforms acting on column vectors (x, 1).

    Raises
    ------
    ValueError
        If R and t disagree on d.

    Examples
    --------
    >>> rigid_transforms(np.eye(2), [3, 4])
    array([[1., 0., 3.],
           [0., 1., 4.],
           [0., 0., 1.]])
    """
    R, t = arrays(R=(R, "... d d"), t=(t, "... d"))
    d = R.shape[-1]
    B = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), d + 1, d + 1))
    B[..., :d, :d] = R
    B[..., :d, d] = t
    B[..., d, d] = 1.0
    return B


def transform_points(B: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Move points by homogeneous transforms.

    Parameters
    ----------
    B : (..., d+1, d+1) float array
        Affine transforms acting on column vectors.
    x : (..., d) float array
        Points; leading dimensions broadcast against those of B.

    Returns
    -------
    y : (..., d) float array
        Moved points.

    Raises
    ------
    ValueError
        If B and x disagree on d.

    Examples
    --------
    >>> transform_points(rigid_transforms(np.eye(2), [3, 4]), [[1, 1], [0, 0]])
    array([[4., 5.],
           [3., 4.]])
    """
    x, B = arrays(x=(x, "... d"), B=(B, "... d+1 d+1"))
    d = x.shape[-1]
    return (B[..., :d, :d] @ x[..., None])[..., 0] + B[..., :d, d]


def nearest_rotations(A: np.ndarray) -> np.ndarray:
    """Rotations nearest to matrices (..., d, d) in the Frobenius norm: the polar factor with determinant one."""
    (A,) = arrays(A=(A, "... d d"))
    left, _, right = np.linalg.svd(A)
    # A reflection is turned into a rotation along the direction that A stretches least.
    left[..., -1] *= np.linalg.det(left @ right)[..., None]
    return left @ right


def slerp(R0: np.ndarray, R1: np.ndarray, s: float | np.ndarray) -> np.ndarray:
    """Rotations a fraction s of the way from R0 to R1, at constant angular speed.

    Parameters
    ----------
    R0, R1 : (..., d, d) float array
        Rotations.
    s : float or (...) float array
        0 gives R0, 1 gives R1.

    Returns
    -------
    R : (..., d, d) float array
        Rotations.

    Raises
    ------
    ValueError
        If R0 and R1 disagree on d.

    Notes
    -----
    Shoemake's spherical interpolation [1]_, written as R0 exp(s log(R0^T R1)).

    References
    ----------
    .. [1] Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985, doi:10.1145/325334.325242.

    Examples
    --------
    >>> half = slerp(rotation_matrices([0.0]), rotation_matrices([1.0]), 0.5)
    >>> rotation_vectors(half).round(6)
    array([0.5])
    """
    R0, R1 = arrays(R0=(R0, "... d d"), R1=(R1, "... d d"))
    return R0 @ rotation_matrices(np.asarray(s)[..., None] * rotation_vectors(np.swapaxes(R0, -1, -2) @ R1))


def interpolate_transforms(B0: np.ndarray, B1: np.ndarray, s: float | np.ndarray) -> np.ndarray:
    """Transforms (..., d+1, d+1) a fraction s, or (...), of the way from B0 to B1, each on its own.

    The rotation of the polar decomposition is slerped; the stretch and the translation are linear.

    Examples
    --------
    >>> interpolate_transforms(np.eye(3), rigid_transforms(3 * np.eye(2), [4, 0]), 0.5)
    array([[2., 0., 2.],
           [0., 2., 0.],
           [0., 0., 1.]])
    """
    B0, B1 = arrays(B0=(B0, "... d+1 d+1"), B1=(B1, "... d+1 d+1"))
    d = B0.shape[-1] - 1
    R0, R1 = nearest_rotations(B0[..., :d, :d]), nearest_rotations(B1[..., :d, :d])
    stretch0, stretch1 = (np.swapaxes(R, -1, -2) @ B[..., :d, :d] for R, B in ((R0, B0), (R1, B1)))
    R, s = slerp(R0, R1, s), np.asarray(s)[..., None]
    linear = R @ ((1 - s[..., None]) * stretch0 + s[..., None] * stretch1)
    return rigid_transforms(linear, (1 - s) * B0[..., :d, d] + s * B1[..., :d, d])


def linear_inverses(A: np.ndarray) -> np.ndarray:
    """Inverses of matrices (..., d, d); of what squeezes space flat, the pseudoinverse.

    Examples
    --------
    >>> linear_inverses(np.array([[[2.0, 0], [0, 4]], [[2, 0], [0, 0]]])).tolist()
    [[[0.5, 0.0], [0.0, 0.25]], [[0.5, 0.0], [0.0, 0.0]]]
    """
    largest = np.abs(A).max(axis=(-2, -1), initial=1e-100)
    flat = np.abs(np.linalg.det(A / largest[..., None, None])) < 1e-12
    inverse = np.linalg.inv(np.where(flat[..., None, None], np.eye(A.shape[-1]), A))
    if flat.any():
        inverse[flat] = np.linalg.pinv(A[flat])
    return inverse


def _cross_matrices(v: np.ndarray) -> np.ndarray:
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return K - np.swapaxes(K, -1, -2)
