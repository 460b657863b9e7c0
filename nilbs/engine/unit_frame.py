"""The frame that fields work in: relative to the root bone, centred, in units of the character's size."""

import sys
from typing import Any, Generic, TypeVar

import numpy as np

from nilbs.characters.character import Character

# A transform with a smaller determinant counts as singular.
SINGULAR = 1e-12
# In units of L: single precision does not resolve points that are farther away.
FAR = 1e6

# A numpy array or a torch tensor; what follows is computed in the same way for both.
Array = TypeVar("Array")


class UnitFrame(Generic[Array]):
    """A pose, or several, in the unit frame, and the way there and back for points.

    A field thereby answers the same for a character and its rigidly moved, scaled or far-away copy. Everything is
    computed in the precision of the pose; in double precision nothing is lost far from the origin. Poses and points
    are numpy arrays, or torch tensors, which are differentiable.

    Parameters
    ----------
    character : Character
    pose : (..., b, d+1, d+1) array or tensor
        Bone transforms, rest to posed, in mesh units.

    Attributes
    ----------
    B : (..., b, d+1, d+1) array or tensor
        The pose in the unit frame.

    Raises
    ------
    ValueError
        If a bone's transform is singular, or moves the bone very far from the root.
    """

    B: Array

    def __init__(self, character: Character, pose: Array) -> None:
        d, L, center = character.d, character.L, character.center
        linalg = _linalg(pose)
        determinant = linalg.det(pose[..., :d, :d])  # type: ignore[index]
        _check(abs(determinant) < SINGULAR, "has a singular transform; fields take its inverse")
        to_unit, from_unit = np.eye(d + 1) / L, np.eye(d + 1) * L
        to_unit[:, d], from_unit[:, d] = np.append(-center / L, 1), np.append(center, 1)
        to_unit, from_unit = _like(to_unit, pose), _like(from_unit, pose)
        self.character, self._root = character, pose[..., root_bone(character), :, :]  # type: ignore[index]
        self._to_root = to_unit @ linalg.inv(self._root)
        self.B = self._to_root[..., None, :, :] @ pose @ from_unit
        size: Any = abs(self.B)  # type: ignore[arg-type]
        far = ~(size < FAR).all(-1).all(-1)
        _check(far, f"is moved or stretched by {FAR:g} times the character's size or more against the root")

    @property
    def to_unit(self) -> Array:
        """The transform (..., d, d+1) that moves posed points into the unit frame."""
        return self._to_root[..., : self.character.d, :]

    def points(self, x: Array) -> Array:
        """Posed points (..., n, d) in the unit frame."""
        d = self.character.d
        return x @ self._to_root[..., :d, :d].mT + self._to_root[..., None, :d, d]

    def points_back(self, x_unit: Array) -> Array:
        """Points (..., n, d) of the unit frame in mesh units."""
        c, d = self.character, self.character.d
        x: Any = x_unit
        x = x * c.L + _like(c.center, x_unit)
        return x @ self._root[..., :d, :d].mT + self._root[..., None, :d, d]

    @property
    def turn_back(self) -> Array:
        """Matrix (..., d, d) that takes gradients by points of the unit frame to those in the world, but for L."""
        d = self.character.d
        return _linalg(self._root).inv(self._root[..., :d, :d])


def root_bone(character: Character) -> int:
    """The first bone without a parent."""
    return int(np.flatnonzero(character.skeleton.P < 0)[0])


def at_rest(character: Character, points: np.ndarray) -> np.ndarray:
    """Rest points (..., d) in the unit frame."""
    return (points - character.center) / character.L


def first_joints(character: Character) -> np.ndarray:
    """First joint (b, d) of every bone at rest, in the unit frame."""
    skeleton = character.skeleton
    return at_rest(character, skeleton.C[skeleton.BE[:, 0]])


def last_joints(character: Character) -> np.ndarray:
    """Last joint (b, d) of every bone at rest, in the unit frame."""
    skeleton = character.skeleton
    return at_rest(character, skeleton.C[skeleton.BE[:, 1]])


def _linalg(array):  # type: ignore[no-untyped-def]
    """The linear algebra of an array's library: a tensor's is loaded wherever there is one."""
    return np.linalg if isinstance(array, np.ndarray) else sys.modules["torch"].linalg


def _like(array: np.ndarray, other):  # type: ignore[no-untyped-def]
    """The array in the library, the type and on the device of another."""
    return array if isinstance(other, np.ndarray) else sys.modules["torch"].as_tensor(array).to(other)


def _check(wrong, what: str) -> None:  # type: ignore[no-untyped-def]
    """Raise ValueError for the first bone (..., b) at fault."""
    if bool(wrong.any()):
        *pose, bone = np.argwhere(np.asarray(wrong.cpu() if hasattr(wrong, "cpu") else wrong))[0].tolist()
        where = f" in pose {pose[0]}" if pose else ""
        raise ValueError(f"bone {bone}{where} {what}")
