"""The rest-pose cache: signed distance on a grid, computed once, read anywhere and differentiable."""

from math import prod
from typing import Self

import torch
from torch import Tensor, nn


class RestCache(nn.Module):
    """Signed distance and occupancy of the rest shape, interpolated multilinearly on a grid that is finer at the skin.

    Between nodes the value is linear along each axis. Where a divided cell borders on one that is not, values on the
    two sides differ by what the coarser interpolation misses. Outside the grid it is the value at the nearest point of
    the grid plus the distance to that point, an upper bound of the true distance that grows away from the shape.
    Lengths are in the unit of the points, which in a model is L.

    Parameters
    ----------
    values : (s,) tensor
        Signed distance at the nodes of the grid and then of every divided cell, negative inside; see
        `nilbs.geometry.rest_grids.distance_bricks`.
    brick : (n_1 - 1, .., n_d - 1) int tensor
        Where in `values` the nodes of a divided cell begin; -1 for the others.
    origin : (d,) tensor
        Position of the first node.
    spacing : float
        Edge of a cell.
    parts : int
        How many parts the edge of a divided cell is divided in.
    width : float
        Occupancy is sigmoid(-distance / width): the sharper, the nearer to a step and the fewer points
        a gradient reaches.
    """

    values: Tensor
    brick: Tensor
    origin: Tensor

    def __init__(
        self, values: Tensor, brick: Tensor, origin: Tensor, spacing: float, *, parts: int, width: float
    ) -> None:
        super().__init__()
        self.register_buffer("values", values)
        self.register_buffer("brick", brick)
        self.register_buffer("origin", origin)
        self.spacing, self.parts, self.width = float(spacing), int(parts), float(width)

    @classmethod
    def of_grid(cls, values: Tensor, origin: Tensor, spacing: float, *, width: float) -> Self:
        """A cache of values (n_1, .., n_d) on a grid without divided cells."""
        brick = torch.full([n - 1 for n in values.shape], -1, dtype=torch.int32, device=values.device)
        return cls(values.ravel(), brick, origin, spacing, parts=1, width=width)

    def distance(self, x_rest: Tensor) -> Tensor:
        """Signed distance (...,) of rest points (..., d)."""
        d = x_rest.shape[-1]
        cells = self.brick.shape
        position = (x_rest - self.origin) / self.spacing
        last = torch.tensor(cells, dtype=x_rest.dtype, device=x_rest.device)
        # A nan (no rest image) must not become an index; it comes out as nan again through the interpolation weights.
        inside = torch.minimum(position.clamp_min(0), last)
        cell = torch.minimum(torch.nan_to_num(inside.detach()).floor(), last - 1)
        fraction = inside - cell
        strides, cell_strides = _strides([n + 1 for n in cells]), _strides(cells)
        first = _flat(cell.long(), strides)
        brick = self.brick.ravel()[_flat(cell.long(), cell_strides)].long()
        divided = brick >= 0
        # In a divided cell the same once more.
        parts = torch.where(divided, float(self.parts), 1.0).to(x_rest)[..., None]
        fine = torch.minimum(torch.nan_to_num(fraction.detach() * parts).floor(), parts - 1)
        fraction = fraction * parts - fine
        fine_strides = _strides([self.parts + 1] * d)
        first = torch.where(divided, brick + _flat(fine.long(), fine_strides), first)
        offsets, fine_offsets = _corners(strides), _corners(fine_strides)
        corners = [
            torch.take(self.values, first + torch.where(divided, fine, coarse))
            for coarse, fine in zip(offsets, fine_offsets, strict=True)
        ]
        for axis in reversed(range(d)):
            half = len(corners) // 2
            corners = [torch.lerp(corners[i], corners[i + half], fraction[..., axis]) for i in range(half)]
        beyond = position - inside
        return corners[0] + self.spacing * _length(beyond)

    def occupancy(self, x_rest: Tensor) -> Tensor:
        """Occupancy (...,) of rest points (..., d): one half on the surface, one inside."""
        return torch.sigmoid(-self.distance(x_rest) / self.width)


def _strides(shape: list[int] | torch.Size) -> list[int]:
    """Steps between neighbours along each axis of an array whose last axis runs fastest."""
    return [prod(shape[axis + 1 :]) for axis in range(len(shape))]


def _flat(index: Tensor, strides: list[int]) -> Tensor:
    """Places (...,) of indices (..., d) in memory."""
    return (index * torch.tensor(strides, device=index.device)).sum(dim=-1)


def _corners(strides: list[int]) -> list[int]:
    """Places of a cell's corners from its first; the second half of them is one step along the last axis on."""
    offsets = [0]
    for stride in strides:
        offsets = [*offsets, *(offset + stride for offset in offsets)]
    return offsets


def _length(v: Tensor) -> Tensor:
    """Euclidean length with a gradient of zero at zero, where the plain one has none."""
    square = (v * v).sum(dim=-1)
    positive = square > 0
    return torch.where(positive, torch.where(positive, square, 1.0).sqrt(), 0.0)
