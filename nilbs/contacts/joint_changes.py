"""Poses of a motion whose joints are turned a little further, and how points of the body move with the joints."""

import numpy as np

from nilbs.geometry.kinematics import composed, local_transforms
from nilbs.geometry.rotations import (
    linear_inverses,
    nearest_rotations,
    rigid_transforms,
    rotation_matrices,
    rotation_vectors,
    transform_points,
)
from nilbs.geometry.skeleton import Skeleton


class JointChanges:
    """Turns of every joint relative to a motion, as rotation vectors in the axes of the bone's parent.

    A bone that is moved or scaled against its parent stays so: what turns is all that the parent holds at the joint.

    Parameters
    ----------
    skeleton : Skeleton
    B : (t, b, d+1, d+1) float array
        The motion.
    """

    def __init__(self, skeleton: Skeleton, B: np.ndarray) -> None:
        self.P, self._start = skeleton.P, skeleton.C[skeleton.BE[:, 0]]
        self.d, self.r = skeleton.d, 1 if skeleton.d == 2 else 3
        self._local = local_transforms(skeleton.C, skeleton.BE, skeleton.P, B)
        above = np.eye(len(self.P), dtype=bool)  # of each bone, itself and those that it hangs from
        for _ in range(len(self.P)):
            more = above | np.where((self.P >= 0)[:, None], above[self.P], False)
            if (more == above).all():
                break
            above = more
        self._below = above.T.astype(np.float64)

    def rotations(self, frames: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Rotation vectors (f, b, 1 or 3) of the joints in frames (f,), as they are or changed by others."""
        R = nearest_rotations(self._local[frames, :, : self.d, : self.d])
        return rotation_vectors(R if change is None else rotation_matrices(change) @ R)

    def turned(self, frames: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Poses (f, b, d+1, d+1) of frames (f,) changed by rotation vectors (f, b, 1 or 3)."""
        d, local = self.d, self._local[frames].copy()
        local[..., :d, :d] = rotation_matrices(change) @ local[..., :d, :d]
        G = composed(self.P, local)
        return rigid_transforms(G[..., :d, :d], transform_points(G, -self._start))

    def slopes(self, B: np.ndarray, of: np.ndarray, home: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """How fast points move along directions while joints turn.

        Parameters
        ----------
        B : (f, b, d+1, d+1) float array
            Poses.
        of : (k,) int array
            The pose of each point.
        home : (k, b, d+1) float array
            The points are the sums of B_b home_b: home_b is a weight times (x_rest, 1), or a sum of these.
        direction : (k, d) float array

        Returns
        -------
        slopes : (k, b, 1 or 3) float array
            Derivatives of direction . point by the turn of each joint, at the pose.
        """
        d = self.d
        joint = transform_points(B, self._start)
        A = np.where((self.P < 0)[:, None, None], np.eye(d), B[:, self.P, :d, :d])  # the parent's axes
        back = linear_inverses(A)
        pieces = np.einsum("kbrc,kbc->kbr", B[of][..., :d, :], home)
        moved = np.einsum("jb,kbr->kjr", self._below, pieces, optimize=True)
        moved -= (home[..., d] @ self._below.T)[..., None] * joint[of]
        v = np.einsum("kjrc,kjc->kjr", back[of], moved)
        m = np.einsum("kjcr,kc->kjr", A[of], direction)
        return np.cross(v, m) if d == 3 else (v[..., :1] * m[..., 1:] - v[..., 1:] * m[..., :1])
