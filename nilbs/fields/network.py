"""The weight network: from a posed point and its pose to skinning weights; and what it is made of."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from nilbs.fields.encoding import DistanceEncoding, LocalEncoding, ParameterEncoding
from nilbs.fields.field import CACHED, Field

# Logit of a ghost bone that does not exist: its weight is zero in any precision.
NEVER = -1e4


class EncodedNetwork(nn.Module):
    """Multilayer perceptron on posed points and their poses.

    Encodings of a pose are affine in the query, but for distances from bones, and so is the first layer: for a given
    pose the two fold into one small matrix, and a query never visits the encoding's numbers. `depth` counts all linear
    layers, at least 2.
    """

    def __init__(self, encoding: LocalEncoding | ParameterEncoding, outputs: int, *, width: int, depth: int) -> None:
        super().__init__()
        if depth < 2:
            raise ValueError(f"a network needs at least 2 layers, got {depth}")
        self.encoding, self.width = encoding, width
        more = len(encoding.ends) if isinstance(encoding, DistanceEncoding) else 0
        sizes = [encoding.size + more, *([width] * (depth - 1)), outputs]
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in pairwise(sizes))

    def forward(self, x: Tensor, B: Tensor) -> Tensor:
        """Outputs (p, n, outputs) at points (p, n, d) in poses (p, b, d+1, d+1)."""
        linear, offset = self.encoding(B)
        first = self.layers[0]
        assert isinstance(first, nn.Linear)
        weight, bias = first.weight, first.bias
        affine, other = weight[:, : self.encoding.size], weight[:, self.encoding.size :]
        hidden = torch.baddbmm((offset @ affine.T + bias)[:, None], x, (affine @ linear).mT)
        if isinstance(self.encoding, DistanceEncoding):
            hidden = hidden + self.encoding.features(x, B) @ other.T
        for layer in self.layers[1:]:
            hidden = layer(torch.relu(hidden))
        return hidden


class WeightNetwork(EncodedNetwork):
    """W(x | theta), with one output for each bone and, last, one for the ghost bone.

    Without a ghost bone its weight is always zero.
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
        super().__init__(encoding, bones + ghost, width=width, depth=depth)
        self.ghost = ghost

    def forward(self, x: Tensor, B: Tensor) -> Tensor:
        """Logits (p, n, b+1) of the weights at points (p, n, d) in poses (p, b, d+1, d+1)."""
        logits = super().forward(x, B)
        return logits if self.ghost else nn.functional.pad(logits, (0, 1), value=NEVER)


class NetworkField(Field):
    """Occupancy by a network whose only output is its logit."""

    def __init__(self, network: EncodedNetwork) -> None:
        super().__init__()
        self.network = network
        self.piece = max(128, CACHED // network.width)

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy (p, n) of points (p, n, d) in poses (p, b, d+1, d+1)."""
        logits: Tensor = self.network(x, B)
        return logits[..., 0]
