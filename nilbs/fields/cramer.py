"""Small linear systems by Cramer's rule: many at once, with derivatives, on any device."""

from collections.abc import Sequence

import torch
from torch import Tensor

# A smaller determinant is held at this, so that the solution lies far away instead of being undefined.
SMALLEST = 1e-4


def cramer(columns: Sequence[Tensor], y: Tensor, *, dim: int) -> Tensor:
    """Solutions z of sum_i z_i columns_i = y, the unknowns last; `dim` holds the equations, all else is a batch."""
    if len(columns) == 2:
        (a, c), (b, e), (u, v) = (vector.unbind(dim) for vector in (*columns, y))
        det = a * e - b * c
        solution = torch.stack([e * u - b * v, a * v - c * u], dim=-1)
    else:
        first, second, third = columns
        normal = torch.linalg.cross(second, third, dim=dim)
        det = (first * normal).sum(dim)
        # Triple products are turned so that two cross products serve all three unknowns.
        turned = torch.linalg.cross(first, y, dim=dim)
        solution = torch.stack([(y * normal).sum(dim), (turned * third).sum(dim), -(turned * second).sum(dim)], dim=-1)
    det = torch.where(det.abs() < SMALLEST, torch.where(det < 0, -SMALLEST, SMALLEST).to(det), det)
    return solution / det[..., None]


def determinant(columns: Sequence[Tensor], *, dim: int) -> Tensor:
    """Determinants of matrices given by their columns; `dim` holds the rows, all else is a batch."""
    if len(columns) == 2:
        (a, c), (b, e) = (vector.unbind(dim) for vector in columns)
        return a * e - b * c
    first, second, third = columns
    return (first * torch.linalg.cross(second, third, dim=dim)).sum(dim)
