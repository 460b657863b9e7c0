"""A network of points that takes the pose at its middle layer, as SNARF's occupancy network does."""

from itertools import pairwise
from math import pi

import torch
from torch import Tensor, nn

SHARPNESS = 100.0  # of the activation: the larger, the more it is like a ramp with a corner
SUMMARY = 8  # numbers that what many points share is summed up in


class ConditionedNetwork(nn.Module):
    """Multilayer perceptron on points; a few numbers that many points share enter at its middle layer.

    `shared` is how many numbers are shared; `depth` counts the linear layers.
    """

    def __init__(self, d: int, outputs: int, width: int, depth: int, *, shared: int = 0) -> None:
        super().__init__()
        if depth < 2:
            raise ValueError(f"a network needs at least 2 layers, got {depth}")
        self.middle = depth // 2
        sizes = [d, *([width] * (depth - 1)), outputs]
        self.layers = nn.ModuleList(nn.Linear(i, o) for i, o in pairwise(sizes))
        self.summary = nn.Linear(shared, SUMMARY, bias=False) if shared else None
        self.entry = nn.Linear(SUMMARY, sizes[self.middle + 1], bias=False) if shared else None

    @property
    def linear(self) -> list[nn.Linear]:
        """The layers from point to output."""
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]

    def forward(self, x: Tensor, shared: Tensor | None = None, which: Tensor | None = None) -> Tensor:
        """Outputs at points (..., d), each with row `which` of the shared numbers."""
        hidden = x
        for i, layer in enumerate(self.layers):
            hidden = layer(_activation(hidden) if i else hidden)
            if i == self.middle and self.summary is not None and self.entry is not None:
                hidden = hidden + self.entry(self.summary(shared))[which]
        return hidden

    def derivative(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Outputs (m, o) at points (m, d), and their derivatives (m, d, o), of a network without shared numbers."""
        first, *others = self.linear
        hidden, slope = first(x), first.weight.T.expand(len(x), -1, -1)
        for layer in others:
            gate = torch.sigmoid(SHARPNESS * hidden)
            slope = slope * (gate * (1 + SHARPNESS * hidden * (1 - gate)))[:, None]
            hidden, slope = layer(hidden * gate), slope @ layer.weight.T
        return hidden, slope

    def start_round(self, radius: float) -> None:
        """Set the parameters so that the output is about the depth below a sphere's surface [1]_, negative outside.

        References
        ----------
        .. [1] Atzmon and Lipman, SAL: Sign Agnostic Learning of Shapes from Raw Data, CVPR 2020, arXiv:1911.10414.
        """
        *hidden, last = self.linear
        for layer in hidden:
            nn.init.normal_(layer.weight, 0, (2 / layer.out_features) ** 0.5)
            nn.init.zeros_(layer.bias)
        nn.init.normal_(last.weight, -((pi / last.in_features) ** 0.5), 1e-4)
        nn.init.constant_(last.bias, radius)
        if self.entry is not None:
            nn.init.zeros_(self.entry.weight)


def _activation(h: Tensor) -> Tensor:
    """A smooth ramp, h sigmoid(100 h)."""
    return nn.functional.silu(SHARPNESS * h) / SHARPNESS
