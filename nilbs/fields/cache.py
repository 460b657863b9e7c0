"""The rest-pose cache: signed distance on a grid, computed once, read anywhere and differentiable."""

import torch
from torch import Tensor, nn


class RestCache(nn.Module):
    """Signed distance and occupancy of the rest shape, interpolated multilinearly on a grid.

    Between nodes the value is linear along each axis. Outside the grid it is the value at the nearest point of the grid
    plus the distance to that point, an upper bound of the true distance that grows away from the shape.

    Parameters
    ----------
    values : (n_1, .., n_d) tensor
        Signed distance at the nodes, negative inside, in mesh units.
    origin : (d,) tensor
        Position of the first node.
    spacing : float
        Edge of a cell, in mesh units.
    width : float
        Occupancy is sigmoid(-distance / width), in mesh units: the sharper, the nearer to a step and the fewer points
        a gradient reaches.
    """

    values: Tensor
    origin: Tensor

    def __init__(self, values: Tensor, origin: Tensor, spacing: float, *, width: float) -> None:
        super().__init__()
        self.register_buffer("values", values.contiguous())  # look-ups index it as it lies in memory
        self.register_buffer("origin", origin)
        self.spacing, self.width = float(spacing), float(width)

    def distance(self, x_rest: Tensor) -> Tensor:
        """Signed distance (...,) of rest points (..., d), in mesh units."""
        d = x_rest.shape[-1]
        shape = self.values.shape
        position = (x_rest - self.origin) / self.spacing
        last = torch.tensor([n - 1 for n in shape], dtype=x_rest.dtype, device=x_rest.device)
        # A nan (no rest image) must not become an index; it comes out as nan again through the interpolation weights.
        inside = torch.minimum(position.clamp_min(0), last)
        cell = torch.minimum(torch.nan_to_num(inside.detach()).floor(), last - 1)
        fraction = inside - cell
        cell = cell.long()
        strides = self.values.stride()
        first = (cell * torch.tensor(strides, device=cell.device)).sum(dim=-1)
        offsets = [0]
        for axis in range(d):
            offsets = [*offsets, *(offset + strides[axis] for offset in offsets)]
        corners = [torch.take(self.values, first + offset) for offset in offsets]
        for axis in reversed(range(d)):
            half = len(corners) // 2
            corners = [torch.lerp(corners[i], corners[i + half], fraction[..., axis]) for i in range(half)]
        beyond = position - inside
        return corners[0] + self.spacing * _length(beyond)

    def occupancy(self, x_rest: Tensor) -> Tensor:
        """Occupancy (...,) of rest points (..., d): one half on the surface, one inside."""
        return torch.sigmoid(-self.distance(x_rest) / self.width)


def _length(v: Tensor) -> Tensor:
    """Euclidean length with a gradient of zero at zero, where the plain one has none."""
    square = (v * v).sum(dim=-1)
    positive = square > 0
    return torch.where(positive, torch.where(positive, square, 1.0).sqrt(), 0.0)
