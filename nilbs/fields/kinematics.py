"""Forward kinematics in torch, so that a pose can be found by its gradient."""

import numpy as np
import torch
from torch import Tensor

from nilbs.geometry.kinematics import bone_order


def forward_kinematics(C: Tensor, BE: np.ndarray, P: np.ndarray, theta: Tensor) -> Tensor:
    """Bone transforms of local rotations; `nilbs.geometry.kinematics.forward_kinematics`, differentiable.

    Parameters
    ----------
    C : (k, d) tensor
        Joints at rest, in mesh units.
    BE : (b, 2) int array
        Bones, indices into C.
    P : (b,) int array
        Parent bones, -1 at a root.
    theta : (b, 1) or (b, 3) tensor
        Rotation of every bone about its first joint relative to its parent: an angle in the plane, a rotation vector in
        space, in radians.

    Returns
    -------
    B : (b, d+1, d+1) tensor
        Pose, rest to posed.

    Raises
    ------
    ValueError
        If theta has another shape, or the parents form a cycle.
    """
    d = C.shape[1]
    if theta.shape != (len(BE), 1 if d == 2 else 3):
        raise ValueError(f"theta must be (b, {1 if d == 2 else 3}) for {len(BE)} bones, got {tuple(theta.shape)}")
    if d == 2:
        turn = torch.tensor([[0.0, -1], [1, 0]]).to(theta)
        generators = theta[..., None] * turn
    else:
        x, y, z = theta.unbind(-1)
        zero = torch.zeros_like(x)
        generators = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(-1, 3, 3)
    # The exponential is smooth at zero, where a formula with an angle in it is not.
    R = torch.linalg.matrix_exp(generators)
    c = C[torch.as_tensor(BE[:, 0])].to(theta)
    last = torch.zeros((len(BE), 1, d + 1)).to(theta)
    last[..., d] = 1
    local = torch.cat([torch.cat([R, (c - (R @ c[..., None])[..., 0])[..., None]], dim=-1), last], dim=-2)
    B: list[Tensor] = list(local)
    for bone in bone_order(P):
        if P[bone] >= 0:
            B[bone] = B[P[bone]] @ local[bone]
    return torch.stack(B)


def local_angles(B: Tensor, P: Tensor) -> Tensor:
    """Rotation (p, b, 1) or (p, b, 3) of every bone relative to its parent in poses (p, b, d+1, d+1), in radians.

    Of transforms that are no rotations it is about what their rotation is. Half a turn in space has two signs; near it
    either may be returned.
    """
    d = B.shape[-1] - 1
    R = B[..., :d, :d]
    parent = torch.where((P < 0)[:, None, None], torch.eye(d).to(R), R[:, P.clamp_min(0)])
    local = torch.linalg.inv(parent) @ R
    if d == 2:
        return torch.atan2(local[..., 1, 0] - local[..., 0, 1], local[..., 0, 0] + local[..., 1, 1])[..., None]
    skew = local - local.mT
    axis = torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], dim=-1) / 2
    cosine = (local.diagonal(dim1=-2, dim2=-1).sum(dim=-1, keepdim=True) - 1) / 2
    square = (axis * axis).sum(dim=-1, keepdim=True)
    small = square < 1e-12
    sine = torch.where(small, 1.0, square).sqrt()
    turned = axis * torch.where(small, 1.0, torch.atan2(sine, cosine) / sine)
    # Of half a turn nothing is left in the skew part; (R + I) / 2 is then the axis times itself, in every column.
    square_axis = (local + torch.eye(3).to(local)) / 2
    largest = square_axis.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)
    column = square_axis.gather(-1, largest[..., None, None].expand(*largest.shape, 3, 1))[..., 0]
    half = torch.pi * column / column.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    return torch.where(small & (cosine < 0), half, turned)
