"""What a network is given of a point and a pose: the encodings of the paper's "Pose representation", and distances."""

import torch
from torch import Tensor, nn

from nilbs.fields.kinematics import local_angles

# Squared distances are increased by this, in units of L squared: on a bone the logarithm is finite.
SOFT = 1e-3


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


class DistanceEncoding(LocalEncoding):
    """The point in every bone's local coordinates, and the logarithm of its distance from every posed bone.

    Near a bone its weight is large, and far from it small: a network finds that slowly from coordinates alone.

    Parameters
    ----------
    centers, ends : (b, d) tensors
        First and last joints of the bones at rest.
    """

    ends: Tensor

    def __init__(self, centers: Tensor, ends: Tensor) -> None:
        super().__init__(centers)
        self.register_buffer("ends", ends, persistent=False)

    def features(self, x: Tensor, B: Tensor) -> Tensor:
        """What is not affine in the points (p, n, d): half the logarithms (p, n, b) of squared distances, softened."""
        d = x.shape[-1]
        first, last = (
            (B[..., :d, :d] @ joint[..., None])[..., 0] + B[..., :d, d] for joint in (self.centers, self.ends)
        )
        along = last - first
        square = (along * along).sum(dim=-1).clamp_min(1e-12)
        # The closest place first + t along of x has t = (x - first) . along / |along|^2, between 0 and 1.
        t = (x @ along.mT - (first * along).sum(dim=-1)[:, None]) / square[:, None]
        t = t.clamp(0, 1)
        off = x[..., None, :] - first[:, None] - t[..., None] * along[:, None]
        return 0.5 * torch.log((off * off).sum(dim=-1) + SOFT)


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
