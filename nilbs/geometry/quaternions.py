"""Unit quaternions (x, y, z, w), and the transforms of translations, rotations and scales."""

import numpy as np


def quaternions(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), with w >= 0, of rotations (..., 3, 3).

    From the largest of the four components (Shepperd's method [1]_), so that neither a tiny angle nor one near pi loses
    digits.

    References
    ----------
    .. [1] Shepperd, Quaternion from rotation matrix, Journal of Guidance and Control, 1978, doi:10.2514/3.55767b.

    Examples
    --------
    >>> quaternions(np.diag([-1.0, -1, 1])).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    trace = np.trace(R, axis1=-2, axis2=-1)
    i, j, k = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    # Row c of Q is 4 q_c q: the row with the largest diagonal is the one to normalise.
    Q = np.empty((*R.shape[:-2], 4, 4))
    Q[..., 0, 0], Q[..., 1, 1], Q[..., 2, 2], Q[..., 3, 3] = 1 + i - j - k, 1 - i + j - k, 1 - i - j + k, 1 + trace
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        Q[..., 3, a] = Q[..., a, 3] = R[..., c, b] - R[..., b, c]
        Q[..., a, b] = Q[..., b, a] = R[..., b, a] + R[..., a, b]
    largest = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(Q, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def unit_quaternions(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (..., 4) scaled to length one, and which of them have no length.

    Examples
    --------
    >>> unit_quaternions(np.array([[0.0, 0, 0, 5], [0, 0, 0, 0]]))
    (array([[0., 0., 0., 1.],
           [0., 0., 0., 0.]]), array([False,  True]))
    """
    largest = np.abs(q).max(axis=-1, keepdims=True)
    zero = largest < 1e-100
    q = q / np.where(zero, 1.0, largest)
    return np.where(zero, 0.0, q / np.where(zero, 1.0, np.linalg.norm(q, axis=-1, keepdims=True))), zero[..., 0]


def without_jumps(q: np.ndarray) -> np.ndarray:
    """Quaternions (t, ..., 4) over time, of which some change their sign so that none is nearer to minus the last.

    Examples
    --------
    >>> without_jumps(np.array([[0.0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 0, -1]]))[:, 3].tolist()
    [1.0, 1.0, 1.0]
    """
    flips = np.where((q[1:] * q[:-1]).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return q * np.concatenate([np.ones((len(q[:1]), *flips.shape[1:])), np.cumprod(flips, axis=0)])


def slerp_quaternions(q0: np.ndarray, q1: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) a fraction s (..., 1) of the way between others, by the shorter way round.

    Examples
    --------
    >>> half = slerp_quaternions(np.array([0.0, 0, 0, 1]), np.array([0.0, 0, -1, 0]), np.array([0.5]))
    >>> half.round(3).tolist()  # a quarter turn about -z
    [0.0, 0.0, -0.707, 0.707]
    """
    cosine = (q0 * q1).sum(axis=-1, keepdims=True)
    q1 = np.where(cosine < 0, -q1, q1)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    # np.sinc(x) is sin(pi x) / (pi x): both quotients tend to 1 - s and s where the angle vanishes.
    total = np.sinc(angle / np.pi)
    return (1 - s) * np.sinc((1 - s) * angle / np.pi) / total * q0 + s * np.sinc(s * angle / np.pi) / total * q1


def compose(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Matrices (..., 4, 4) of translations, unit quaternions and scales, applied in reverse.

    Examples
    --------
    >>> compose(np.array([1.0, 2, 3]), np.array([0.0, 0, 1, 0]), np.ones(3))[:3].tolist()
    [[-1.0, 0.0, 0.0, 1.0], [0.0, -1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0]]
    """
    x, y, z, w = np.moveaxis(rotation, -1, 0)
    R = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
    matrix = np.zeros((*np.broadcast_shapes(R.shape[:-2], translation.shape[:-1], scale.shape[:-1]), 4, 4))
    matrix[..., :3, :3] = R * scale[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1
    return matrix
