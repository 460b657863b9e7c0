"""The frame that fields work in: relative to the root bone, centred, in units of the character's size."""

import numpy as np
import torch
from torch import Tensor

from nilbs.characters.character import Character
from nilbs.geometry.rotations import rigid_transforms

# A transform with a smaller determinant counts as singular.
SINGULAR = 1e-12
# In units of L: single precision does not resolve points that are farther away.
FAR = 1e6


class UnitFrame:
    """A pose, or several, in the unit frame, and the way there and back for points.

    A field thereby answers the same for a character and its rigidly moved, scaled or far-away copy. Everything is
    computed in the precision of the pose; in double precision nothing is lost far from the origin. Tensors are
    differentiable.

    Parameters
    ----------
    character : Character
    pose : (..., b, d+1, d+1) tensor
        Bone transforms, rest to posed, in mesh units.

    Attributes
    ----------
    B : (..., b, d+1, d+1) tensor
        The pose in the unit frame.

    Raises
    ------
    ValueError
        If a bone's transform is singular, or moves the bone very far from the root.
    """

    def __init__(self, character: Character, pose: Tensor) -> None:
        d, L, center = character.d, character.L, rest_center(character)
        _check(
            torch.linalg.det(pose[..., :d, :d]).abs() < SINGULAR, "has a singular transform; fields take its inverse"
        )
        to_unit = torch.as_tensor(rigid_transforms(np.eye(d) / L, -center / L)).to(pose)
        from_unit = torch.as_tensor(rigid_transforms(np.eye(d) * L, center)).to(pose)
        self.character, self._root = character, pose[..., root_bone(character), :, :]
        self._to_root = to_unit @ torch.linalg.inv(self._root)
        self.B = self._to_root[..., None, :, :] @ pose @ from_unit
        far = ~(self.B.abs().amax(dim=(-2, -1)) < FAR)
        _check(far, f"is moved or stretched by {FAR:g} times the character's size or more against the root")

    def points(self, x: Tensor) -> Tensor:
        """Posed points (..., n, d) in the unit frame."""
        d = self.character.d
        return x @ self._to_root[..., :d, :d].mT + self._to_root[..., None, :d, d]

    def points_back(self, x_unit: Tensor) -> Tensor:
        """Points (..., n, d) of the unit frame in mesh units."""
        c, d = self.character, self.character.d
        x = x_unit * c.L + torch.as_tensor(rest_center(c)).to(x_unit)
        return x @ self._root[..., :d, :d].mT + self._root[..., None, :d, d]

    @property
    def turn_back(self) -> Tensor:
        """Matrix (..., d, d) that takes gradients by points of the unit frame to those in the world, but for L."""
        d = self.character.d
        return torch.linalg.inv(self._root[..., :d, :d])


def rest_center(character: Character) -> np.ndarray:
    """Centre (d,) of the rest mesh's bounding box."""
    return (character.V.min(axis=0) + character.V.max(axis=0)) / 2


def root_bone(character: Character) -> int:
    """The first bone without a parent."""
    return int(np.flatnonzero(character.skeleton.P < 0)[0])


def at_rest(character: Character, points: np.ndarray) -> np.ndarray:
    """Rest points (..., d) in the unit frame."""
    return (points - rest_center(character)) / character.L


def first_joints(character: Character) -> np.ndarray:
    """First joint (b, d) of every bone at rest, in the unit frame."""
    skeleton = character.skeleton
    return at_rest(character, skeleton.C[skeleton.BE[:, 0]])


def _check(wrong: Tensor, what: str) -> None:
    """Raise ValueError for the first bone (..., b) at fault."""
    if bool(wrong.any()):
        *pose, bone = torch.nonzero(wrong)[0].tolist()
        where = f" in pose {pose[0]}" if pose else ""
        raise ValueError(f"bone {bone}{where} {what}")
