"""The weight network: from a posed point in every bone's local coordinates to skinning weights."""

from itertools import pairwise

import torch
from torch import Tensor, nn


class WeightNetwork(nn.Module):
    """Multilayer perceptron W(x | theta) with one output for each bone and one for the ghost bone.

    Its input is the rig-agnostic encoding of the NiLBS paper (section "Pose representation"): the query in the local
    frame of every bone, here each bone's rest frame moved along with the bone. That encoding is affine in the query,
    and so is the first layer: for a given pose the two fold into one small matrix, and a query never visits the b d
    numbers.

    Parameters
    ----------
    centers : (b, d) tensor
        First joint of every bone at rest, in mesh units.
    scale : float
        Length that counts as one, in mesh units.
    width : int
        Units of a hidden layer.
    depth : int
        Linear layers, the first and the last included.
    """

    centers: Tensor

    def __init__(self, centers: Tensor, *, scale: float, width: int = 96, depth: int = 5) -> None:
        super().__init__()
        if depth < 2:
            raise ValueError(f"a weight network needs at least 2 layers, got {depth}")
        b, d = centers.shape
        self.register_buffer("centers", centers)
        self.scale = float(scale)
        sizes = [b * d, *([width] * (depth - 1)), b + 1]
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in pairwise(sizes))

    def forward(self, x: Tensor, B: Tensor) -> Tensor:
        """Logits of the weights.

        Parameters
        ----------
        x : (p, n, d) tensor
            Posed points, n for each pose.
        B : (p, b, d+1, d+1) tensor
            Poses, rest to posed.

        Returns
        -------
        logits : (p, n, b+1) tensor
            Softmax of the last dimension gives the weights; the ghost bone comes last.
        """
        p, d = len(B), x.shape[-1]
        B_inverse = torch.linalg.inv(B)
        # Encoding: x -> (B_b^-1 x - c_b) / scale for all bones, one matrix and one offset a pose.
        linear = B_inverse[:, :, :d, :d].reshape(p, -1, d) / self.scale
        offset = (B_inverse[:, :, :d, d] - self.centers).reshape(p, -1) / self.scale
        first = self.layers[0]
        hidden = torch.baddbmm((offset @ first.weight.T + first.bias)[:, None], x, (first.weight @ linear).mT)
        for layer in self.layers[1:]:
            hidden = layer(torch.relu(hidden))
        return hidden
