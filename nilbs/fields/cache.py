"""The rest-pose cache: signed distance on a grid, computed once, read anywhere and differentiable."""

from collections.abc import Sequence
from math import prod
from typing import Self

import torch
from torch import Tensor, nn

from nilbs.engine.distances import divisions


class RestCache(nn.Module):
    """Signed distance and occupancy of the rest shape, multilinear on a grid that is finer at the surface.

    Between nodes the value is linear along each axis. Where cells of different size meet, values on the two sides
    differ by about what the coarser interpolation misses. Outside the grid it is the value at the nearest point of the
    grid plus the distance to that point, an upper bound of the true distance that grows away from the shape. Lengths
    are in the unit of the points, which in a model is L.

    Parameters
    ----------
    values : (s,) tensor
        Values at the nodes of the grid, and then, division by division, at those of every brick, whose interpolation
        is signed distance, negative inside; see `nilbs.geometry.rest_grids.distance_bricks`.
    brick : (n_1 - 1, .., n_d - 1) int tensor
        Number of a cell's brick, the nodes that it is divided by, among those of the first division; -1 for none.
    finer : (c,) int tensor
        The same for cells of bricks, brick by brick: number of a cell's brick among those of the next division.
    origin : (d,) tensor
        Position of the first node.
    spacing : float
        Edge of a cell.
    parts : sequence of int
        How many parts the edge of a cell is divided in, the first time and so on.
    width : float
        Occupancy is sigmoid(-distance / width): the sharper, the nearer to a step and the fewer points
        a gradient reaches.

    Raises
    ------
    ValueError
        If there are more or fewer values or cells than the bricks have.
    """

    values: Tensor
    brick: Tensor
    finer: Tensor
    origin: Tensor

    def __init__(
        self,
        values: Tensor,
        brick: Tensor,
        finer: Tensor,
        origin: Tensor,
        spacing: float,
        *,
        parts: Sequence[int],
        width: float,
    ) -> None:
        super().__init__()
        for name, tensor in {"values": values, "brick": brick, "finer": finer, "origin": origin}.items():
            self.register_buffer(name, tensor, persistent=False)
        self.spacing, self.width = float(spacing), float(width)
        self._divisions = divisions(brick.cpu().numpy(), finer.cpu().numpy(), parts, values=len(values))

    @classmethod
    def of_grid(cls, values: Tensor, origin: Tensor, spacing: float, *, width: float) -> Self:
        """A cache of values (n_1, .., n_d) on a grid without divided cells."""
        brick = torch.full([n - 1 for n in values.shape], -1, dtype=torch.int32, device=values.device)
        return cls(values.ravel(), brick, brick[:0].ravel(), origin, spacing, parts=(), width=width)

    def distance(self, x_rest: Tensor) -> Tensor:
        """Signed distance (...,) of rest points (..., d)."""
        d = x_rest.shape[-1]
        cells = self.brick.shape
        position = (x_rest - self.origin) / self.spacing
        last = torch.tensor(cells, dtype=x_rest.dtype, device=x_rest.device)
        # A nan (no canonical point) must not become an index; the interpolation weights make it nan again.
        inside = torch.minimum(position.clamp_min(0), last)
        cell = torch.minimum(torch.nan_to_num(inside.detach()).floor(), last - 1)
        fraction = inside - cell
        strides = [_strides([n + 1 for n in cells])]
        first = _flat(cell.long(), strides[0])
        level = torch.zeros_like(first)
        number = self.brick.ravel()[_flat(cell.long(), _strides(cells))].long()
        # In a divided cell the same once more, and so on.
        for deeper, division in enumerate(self._divisions, 1):
            divided = number >= 0
            parts = torch.where(divided, float(division.parts), 1.0).to(x_rest)[..., None]
            cell = torch.minimum(torch.nan_to_num(fraction.detach() * parts).floor(), parts - 1)
            fraction = fraction * parts - cell
            strides.append(_strides([division.parts + 1] * d))
            begins = division.first_value + number * (division.parts + 1) ** d
            first = torch.where(divided, begins + _flat(cell.long(), strides[-1]), first)
            level = torch.where(divided, deeper, level)
            if division.first_cell is not None:
                begins = division.first_cell + number.clamp_min(0) * division.parts**d
                below = self.finer[begins + _flat(cell.long(), _strides([division.parts] * d))]
                number = torch.where(divided, below.long(), -1)
        offsets = torch.tensor([_corners(steps) for steps in strides], device=first.device).T
        corners = [torch.take(self.values, first + offset[level]) for offset in offsets]
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
