"""Poses turned by hand: extra rotations of single bones on top of those of a clip."""

import numpy as np

from nilbs.geometry.kinematics import composed, local_transforms
from nilbs.geometry.rotations import nearest_rotations, rigid_transforms, rotation_matrices, rotation_vectors
from nilbs.geometry.skeleton import Skeleton


def turned(skeleton: Skeleton, B: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """A pose whose bones are turned further about their first joints, before what the pose does to them.

    Parameters
    ----------
    skeleton : Skeleton
    B : (b, d+1, d+1) float array
        The pose; it may scale bones and take joints apart.
    theta : (b, 1) or (b, 3) float array
        Rotation vectors in each bone's rest frame, in radians.

    Returns
    -------
    B : (b, d+1, d+1) float array
        With theta = 0 the same pose, digit by digit.

    Examples
    --------
    >>> skeleton = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))
    >>> B = turned(skeleton, np.tile(np.eye(3), (2, 1, 1)), np.array([[0], [np.pi / 2]]))
    >>> (B[1] @ [2, 0, 1]).round(6).tolist()
    [1.0, 1.0, 1.0]
    """
    if not theta.any():
        return B
    start = skeleton.C[skeleton.BE[:, 0]]
    local = local_transforms(skeleton.C, skeleton.BE, skeleton.P, B)
    local = local @ rigid_transforms(rotation_matrices(theta), np.zeros_like(start))
    return composed(skeleton.P, local) @ rigid_transforms(np.eye(skeleton.d), -start)


def turn_to(B: np.ndarray, theta: np.ndarray, bone: int, R: np.ndarray) -> np.ndarray:
    """The rotation vector of a bone with which it is turned in the world as R (d, d), where it is not stretched.

    Parameters
    ----------
    B, theta
        A pose that `turned` returned, and the rotation vectors with which it did.
    bone : int
    R : (d, d) float array
        How the bone's rest frame is to stand in the world.
    """
    d = R.shape[0]
    own = rotation_matrices(theta[bone])
    return rotation_vectors(own @ nearest_rotations(B[bone, :d, :d]).T @ R)


def joints(skeleton: Skeleton, B: np.ndarray) -> np.ndarray:
    """Posed first joints (b, d) of all bones."""
    start, d = skeleton.C[skeleton.BE[:, 0]], skeleton.d
    return np.einsum("bij,bj->bi", B[:, :d, :d], start) + B[:, :d, d]


def segments(skeleton: Skeleton, B: np.ndarray) -> np.ndarray:
    """Posed ends (s, 2, d) of the lines that move with bones."""
    ends, bone = skeleton.segments()
    d = skeleton.d
    return np.einsum("sij,skj->ski", B[bone, :d, :d], skeleton.C[ends]) + B[bone, None, :d, d]
