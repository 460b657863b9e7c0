"""The paper's learnable forward map: skinning weights of rest points from a network (eq. 4)."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from nilbs.fields.forward import Forward, affine


class ForwardNetwork(nn.Module):
    """Forward skinning x = sum_b W_b(x_rest) B_b x_rest with weights from a multilayer perceptron and a softmax.

    A root search can use it in place of `ForwardField`.
    """

    def __init__(self, d: int, bones: int, *, width: int = 96, depth: int = 5) -> None:
        super().__init__()
        sizes = [d, *([width] * (depth - 1)), bones]
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in pairwise(sizes))

    def logits(self, x_rest: Tensor) -> Tensor:
        """Logits (..., b) of the weights of rest points (..., d)."""
        hidden = self.layers[0](x_rest)
        for layer in self.layers[1:]:
            # Smooth, so that the map has a derivative everywhere.
            hidden = layer(nn.functional.silu(hidden))
        return hidden

    def blends(self, B: Tensor) -> Tensor:
        """Upper rows (b, d (d+1)) of a pose's transforms (b, d+1, d+1)."""
        return B[:, :-1].flatten(1)

    def blend(self, x_rest: Tensor, blends: Tensor) -> Tensor:
        """Blended transforms (n, d, d+1) at rest points (n, d)."""
        d = x_rest.shape[-1]
        return (torch.softmax(self.logits(x_rest), dim=-1) @ blends).unflatten(-1, (d, d + 1))

    def pose(self, x_rest: Tensor, blends: Tensor) -> Forward:
        """Posed places of rest points (n, d), and their derivatives."""
        n, d = x_rest.shape
        # The derivative is carried along through the layers, one column for each coordinate.
        value, slope = x_rest, torch.eye(d).to(x_rest).expand(n, d, d)
        for k, layer in enumerate(self.layers):
            if k:
                share = torch.sigmoid(value)
                slope = (share * (1 + value * (1 - share)))[:, None] * slope
                value = value * share
            assert isinstance(layer, nn.Linear)
            value, slope = layer(value), slope @ layer.weight.T
        W = torch.softmax(value, dim=-1)
        slope = W[:, None] * (slope - (W[:, None] * slope).sum(dim=-1, keepdim=True))  # (n, d, b)
        blend = (W @ blends).unflatten(-1, (d, d + 1))
        turned = affine((slope @ blends).unflatten(-1, (d, d + 1)), x_rest[:, None])
        return Forward(affine(blend, x_rest), blend[..., :d] + turned.mT)
