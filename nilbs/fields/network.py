"""The weight network: from a posed point and its pose to skinning weights."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from nilbs.fields.encoding import LocalEncoding, ParameterEncoding

# Logit of a ghost bone that does not exist: its weight is zero in any precision.
NEVER = -1e4


class WeightNetwork(nn.Module):
    """Multilayer perceptron W(x | theta) with one output for each bone and one for the ghost bone.

    Both encodings of a pose are affine in the query, and so is the first layer: for a given pose the two fold into one
    small matrix, and a query never visits the encoding's numbers.

    Parameters
    ----------
    encoding : LocalEncoding or ParameterEncoding
        What it is told of a point and a pose.
    bones : int
        How many bones.
    width : int
        Units of a hidden layer.
    depth : int
        Linear layers, the first and the last included.
    ghost : bool
        Whether there is a ghost bone; without one its weight is always zero.
    """

    def __init__(
        self,
        encoding: LocalEncoding | ParameterEncoding,
        bones: int,
        *,
        width: int = 96,
        depth: int = 5,
        ghost: bool = True,
    ) -> None:
        super().__init__()
        if depth < 2:
            raise ValueError(f"a weight network needs at least 2 layers, got {depth}")
        self.encoding, self.ghost = encoding, ghost
        sizes = [encoding.size, *([width] * (depth - 1)), bones + ghost]
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
        linear, offset = self.encoding(B)
        first = self.layers[0]
        hidden = torch.baddbmm((offset @ first.weight.T + first.bias)[:, None], x, (first.weight @ linear).mT)
        for layer in self.layers[1:]:
            hidden = layer(torch.relu(hidden))
        return hidden if self.ghost else nn.functional.pad(hidden, (0, 1), value=NEVER)
