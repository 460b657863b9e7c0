"""Eq. 5 of the paper, the tempting inverse: a fixed-point iteration."""

import torch
from torch import Tensor

from nilbs.fields.cramer import cramer
from nilbs.fields.newton import ForwardMap, Roots


def fixed_point(x: Tensor, start: Tensor, field: ForwardMap, blends: Tensor, *, iterations: int) -> Roots:
    """Fixed points of eq. 5, x_rest = [W(x_rest) B]^-1 x, from starts (n, d).

    Returns the best points met. Where the map x_rest -> [W(x_rest) B]^-1 x is no contraction the iteration fails.
    Whether space is inside out there is not computed, because it takes a derivative: `inverted` is false.
    """
    d = x.shape[-1]
    with torch.no_grad():
        x_rest = best = start
        least = torch.full_like(start[:, 0], torch.inf)
        for _ in range(iterations + 1):
            blend = field.blend(x_rest, blends)
            residual = ((blend[..., :d] @ x_rest[..., None])[..., 0] + blend[..., d] - x).norm(dim=-1)
            better = residual < least
            best, least = torch.where(better[:, None], x_rest, best), torch.where(better, residual, least)
            x_rest = cramer(blend[..., :d].unbind(-1), x - blend[..., d], dim=-1)
        return Roots(best, least, torch.zeros_like(least, dtype=torch.bool), (iterations + 1) * len(x))
