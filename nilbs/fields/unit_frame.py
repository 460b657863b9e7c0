"""The frame that fields work in: relative to the root bone, centred, in units of the character's size."""

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.geometry.rotations import rigid_transforms

# Determinant of a transform without an inverse to speak of.
SINGULAR = 1e-12
# In units of L: what is farther away, single precision tells nothing of.
FAR = 1e6


def rest_center(character: Character) -> np.ndarray:
    """Centre (d,) of the rest mesh's bounding box."""
    return (character.V.min(axis=0) + character.V.max(axis=0)) / 2


def root_bone(character: Character) -> int:
    """The first bone without a parent."""
    return int(np.flatnonzero(character.skeleton.P < 0)[0])


def at_rest(character: Character, points: np.ndarray) -> np.ndarray:
    """Rest points (..., d) in the unit frame."""
    return (points - rest_center(character)) / character.L


def in_unit_frame(character: Character, x: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and poses as the field sees them: relative to the root bone, centred, in units of L.

    The field thereby gives one and the same answer for a character and its rigidly moved, scaled or far-away copy;
    what single precision would lose far from the origin is taken off in double precision first.

    Parameters
    ----------
    character : Character
    x : (..., n, d) float array
        Posed points.
    B : (..., b, d+1, d+1) float array
        Poses, rest to posed.

    Returns
    -------
    x_unit : (..., n, d) float array
    B_unit : (..., b, d+1, d+1) float array

    Raises
    ------
    ValueError
        If a bone's transform is singular, or moves the bone absurdly far from the root.
    """
    x_unit, B_unit = unit_frame(character, *(torch.from_numpy(np.array(a, dtype=np.float64)) for a in (x, B)))
    return x_unit.numpy(), B_unit.numpy()


def unit_frame(character: Character, x: torch.Tensor, B: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What `in_unit_frame` does, on tensors and differentiable."""
    d, L, center = character.d, character.L, rest_center(character)
    _check(torch.linalg.det(B[..., :d, :d]).abs() < SINGULAR, "has a singular transform; fields take its inverse")
    root = B[..., root_bone(character), :, :]
    to_unit = torch.as_tensor(rigid_transforms(np.eye(d) / L, -center / L)).to(B)
    from_unit = torch.as_tensor(rigid_transforms(np.eye(d) * L, center)).to(B)
    to_root = to_unit @ torch.linalg.inv(root)
    x_unit = x @ to_root[..., :d, :d].mT + to_root[..., None, :d, d]
    B_unit = to_root[..., None, :, :] @ B @ from_unit
    far = ~(B_unit.abs().amax(dim=(-2, -1)) < FAR)
    _check(far, f"is moved or stretched by {FAR:g} times the character's size or more against the root")
    return x_unit, B_unit


def _check(wrong: torch.Tensor, what: str) -> None:
    """Name the first bone (..., b) at fault."""
    if bool(wrong.any()):
        *pose, bone = torch.nonzero(wrong)[0].tolist()
        where = f" in pose {pose[0]}" if pose else ""
        raise ValueError(f"bone {bone}{where} {what}")
