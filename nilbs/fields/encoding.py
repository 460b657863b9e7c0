"""What a network sees of a point and a pose: both encodings of the paper's section "Pose representation"."""

import torch
from torch import Tensor, nn

from nilbs.fields.kinematics import local_angles


class LocalEncoding(nn.Module):
    """The point in every bone's local coordinates, B_b^-1 x - c_b, whatever rig moves the bones.

    `centers` (b, d) are the first joints of the bones at rest. A bone's frame is its rest frame, moved along with it.
    """

    centers: Tensor

    def __init__(self, centers: Tensor) -> None:
        super().__init__()
        self.register_buffer("centers", centers)
        self.size = centers.numel()

    def forward(self, B: Tensor) -> tuple[Tensor, Tensor]:
        """The encoding of x in poses (p, b, d+1, d+1): linear (p, size, d) @ x + offset (p, size)."""
        p, d = len(B), B.shape[-1] - 1
        B_inverse = torch.linalg.inv(B)
        return B_inverse[:, :, :d, :d].reshape(p, -1, d), (B_inverse[:, :, :d, d] - self.centers).reshape(p, -1)


class ParameterEncoding(nn.Module):
    """The point, and after it the pose parameters: every bone's local rotation, one angle or a vector."""

    P: Tensor

    def __init__(self, P: Tensor, d: int) -> None:
        super().__init__()
        self.register_buffer("P", P, persistent=False)
        self.size = d + len(P) * {2: 1, 3: 3}[d]

    def forward(self, B: Tensor) -> tuple[Tensor, Tensor]:
        """The encoding of x in poses (p, b, d+1, d+1): linear (p, size, d) @ x + offset (p, size)."""
        p, d = len(B), B.shape[-1] - 1
        linear = torch.eye(self.size, d).to(B).expand(p, -1, -1)
        return linear, torch.cat([B.new_zeros((p, d)), local_angles(B, self.P).flatten(1)], dim=1)
