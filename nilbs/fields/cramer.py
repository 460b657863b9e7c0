"""Small linear systems by Cramer's rule: many at once, with derivatives, on any device."""

from collections.abc import Sequence

import torch
from torch import Tensor

# Where a determinant is smaller it is held at this, which sends the solution far away instead of nowhere.
SMALLEST = 1e-4


def cramer(columns: Sequence[Tensor], y: Tensor, *, dim: int) -> Tensor:
    """Solutions z of sum_i z_i columns_i = y.

    Parameters
    ----------
    columns : two or three tensors
        Columns of the matrices, as many as `dim` is long.
    y : tensor
        Right-hand sides, of the columns' shape.
    dim : int
        The dimension that holds the equations; the others are a batch.

    Returns
    -------
    z : tensor
        Of the batch's shape, with the unknowns last.
    """
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
    """Determinants of matrices.

    Parameters
    ----------
    columns : two or three tensors
        Columns of the matrices, as many as `dim` is long.
    dim : int
        The dimension that holds the rows; the others are a batch.

    Returns
    -------
    determinant : tensor
        Of the batch's shape.
    """
    if len(columns) == 2:
        (a, c), (b, e) = (vector.unbind(dim) for vector in columns)
        return a * e - b * c
    first, second, third = columns
    return (first * torch.linalg.cross(second, third, dim=dim)).sum(dim)
