"""A plain network on the point and the pose: the floor among methods that learn, with no skinning in it."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.field import Field


class PoseMlp(Field):
    """Multilayer perceptron from a posed point and the pose parameters to the logit of occupancy.

    What the papers on articulated fields compare with, as the unstructured baseline of [1]_: nothing tells it that
    parts of a body move rigidly, so it has to learn each pose's shape by heart.

    Differs from the paper: the layers are those of the networks that predict skinning weights here, plain and of a
    width to choose, and the pose is told as local rotations.

    Parameters
    ----------
    P : (b,) tensor
        Parent bones, -1 at a root.
    d : int
        Dimension.
    width : int
        Units of a hidden layer.
    depth : int
        Linear layers, the first and the last included.

    References
    ----------
    .. [1] Deng et al., NASA: Neural Articulated Shape Approximation, 2020, arXiv:1912.03207.
    """

    def __init__(self, P: Tensor, d: int, *, width: int, depth: int) -> None:
        super().__init__()
        if depth < 2:
            raise ValueError(f"a network needs at least 2 layers, got {depth}")
        self.encoding = ParameterEncoding(P, d)
        sizes = [self.encoding.size, *([width] * (depth - 1)), 1]
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in pairwise(sizes))

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy (p, n) of points (p, n, d) in poses (p, b, d+1, d+1)."""
        # The encoding is affine in the point and so is the first layer: for a pose they are one small matrix.
        linear, offset = self.encoding(B)
        first = self.layers[0]
        hidden = torch.baddbmm((offset @ first.weight.T + first.bias)[:, None], x, (first.weight @ linear).mT)
        for layer in self.layers[1:]:
            hidden = layer(torch.relu(hidden))
        return hidden[..., 0]
