"""Bone transforms as translations, rotations and scales of nodes relative to their parents."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.quaternions import compose, quaternions, without_jumps
from nilbs.geometry.rotations import linear_inverses, nearest_rotations

_ROUNDS = 50  # of the alternation that finds the closest rotation and scale


@dataclass(frozen=True)
class Track:
    """The motion of all nodes of a skeleton relative to their parents.

    `parts`: "translation" (t, b, 3), "rotation" (t, b, 4), unit quaternions (x, y, z, w) that do not jump from q to -q,
    and "scale" (t, b, 3). `moved`: how far (b,) each part gets from rest. `off` (t, b): how far, in mesh units, points
    near a bone are from where they should be.
    """

    parts: dict[str, np.ndarray]
    moved: dict[str, np.ndarray]
    off: np.ndarray


def rest_rotations(P: np.ndarray, motions: list[np.ndarray]) -> np.ndarray:
    """Axes (b, 3, 3), as columns, for the bones' rest frames along which their motions B (t, b, 4, 4) stretch them.

    The identity for a bone that stretches along the axes of the world, alike in all directions, or not at all. Relative
    to its parent a bone moves by A = R S with R a rotation, S = Q diag(s) Q^T. The eigenvectors of A^T A are Q in every
    frame; those of a sum with uneven coefficients over the frames separate axes that some frames do not.
    """
    Q = np.tile(np.eye(3), (len(P), 1, 1))
    total = np.zeros((len(P), 3, 3))
    uneven = np.zeros(len(P), dtype=bool)
    for B in motions:
        L = B[..., :3, :3]
        above = np.where((P >= 0)[:, None, None], L[:, P], np.eye(3))
        A = linear_inverses(above) @ L
        stretch = np.swapaxes(A, -1, -2) @ A
        largest = np.abs(stretch).max(axis=(-2, -1), initial=1e-300)
        mixed = np.abs(stretch * (1 - np.eye(3))).max(axis=(-2, -1), initial=0) > 1e-6 * largest
        uneven |= mixed.any(axis=0)
        coefficient = 1 + np.arange(len(B)) * 0.6180339887498949 % 1
        total += np.einsum("t,tbij->bij", coefficient, stretch)
    if uneven.any():
        axes = np.linalg.eigh(total[uneven])[1]
        axes[:, :, 0] *= np.linalg.det(axes)[:, None]
        Q[uneven] = axes
    return Q


def track(joints: np.ndarray, P: np.ndarray, Q: np.ndarray, B: np.ndarray, *, size: float) -> Track:
    """Translations, rotations and scales that move nodes, at `joints` (b, 3) turned by Q (b, 3, 3) at rest, as bones.

    Where a transform relative to the parent is more than a rotation times a scale, the closest; nodes below make up for
    what their parent is off. `size` is that of the character.
    """
    rest = np.tile(np.eye(4), (len(P), 1, 1))
    rest[:, :3, :3], rest[:, :3, 3] = Q, joints
    G = B @ rest
    made = np.zeros_like(G)  # the nodes' transforms as they are written
    shape = B.shape[:2]
    parts = {"translation": np.zeros((*shape, 3)), "rotation": np.zeros((*shape, 4)), "scale": np.zeros((*shape, 3))}
    moved = {name: np.zeros(len(P)) for name in parts}
    for bone in bone_order(P).tolist():
        parent = P[bone]
        above = made[:, parent] if parent >= 0 else np.broadcast_to(np.eye(4), (len(B), 4, 4))
        back = linear_inverses(above[:, :3, :3])
        translation = (back @ (G[:, bone, :3, 3] - above[:, :3, 3])[..., None])[..., 0]
        R, scale = _closest(back @ G[:, bone, :3, :3])
        q = quaternions(R)
        turn = Q[bone] if parent < 0 else Q[parent].T @ Q[bone]
        still = quaternions(turn)
        q = without_jumps(np.concatenate([still[None], q]))[1:]
        stay = joints[bone] if parent < 0 else Q[parent].T @ (joints[bone] - joints[parent])
        made[:, bone] = above @ compose(translation, q, scale)
        for name, values in (("translation", translation), ("rotation", q), ("scale", scale)):
            parts[name][:, bone] = values
        moved["translation"][bone] = np.abs(translation - stay).max(initial=0)
        moved["rotation"][bone] = np.minimum(*(np.abs(q - s * still).max(axis=-1) for s in (1, -1))).max(initial=0)
        moved["scale"][bone] = np.abs(scale - 1).max(initial=0)
    wrong = np.abs(made - G).max(axis=-2)
    return Track(parts, moved, np.maximum(wrong[..., :3].max(axis=-1) * size, wrong[..., 3]))


def _closest(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation R (t, 3, 3) and scale s (t, 3) with R diag(s) closest to A."""
    sign = np.where(np.linalg.det(A) < 0, -1.0, 1.0)[:, None, None]
    A = sign * A
    scale = np.linalg.norm(A, axis=1)
    R = np.tile(np.eye(3), (len(A), 1, 1))
    left = np.arange(len(A))  # the frames that are not there yet
    for _ in range(_ROUNDS):
        R[left] = nearest_rotations(A[left] * scale[left, None])
        fitted = (R[left] * A[left]).sum(axis=1)
        change = np.abs(fitted - scale[left]).max(axis=1, initial=0)
        scale[left] = fitted
        left = left[change > 1e-9 * np.abs(fitted).max(axis=1, initial=1e-300)]
        if not len(left):
            break
    return R, sign[:, 0] * scale
