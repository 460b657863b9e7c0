"""Eq. 5 of the paper, the tempting inverse, as what it is: not a formula but a fixed point, to be iterated."""

import torch
from torch import Tensor

from nilbs.fields.cramer import cramer
from nilbs.fields.newton import ForwardMap, Roots


def fixed_point(x: Tensor, start: Tensor, field: ForwardMap, blends: Tensor, *, iterations: int) -> Roots:
    """Rest points that eq. 5 leaves where they are, x_rest = [W(x_rest) B]^-1 x, from starts (n, d).

    Returns the best points met. Where the map x_rest -> [W(x_rest) B]^-1 x is no contraction the iteration fails.
    Whether space is inside out there is not computed, because it takes a derivative: `inverted` is false.
    """
    d = x.shape[-1]
    with torch.no_grad():
        guess = best = start
        missed = torch.full_like(start[:, 0], torch.inf)
        for _ in range(iterations + 1):
            blend = field.blend(guess, blends)
            residual = ((blend[..., :d] @ guess[..., None])[..., 0] + blend[..., d] - x).norm(dim=-1)
            better = residual < missed
            best, missed = torch.where(better[:, None], guess, best), torch.where(better, residual, missed)
            guess = cramer(blend[..., :d].unbind(-1), x - blend[..., d], dim=-1)
        return Roots(best, missed, torch.zeros_like(missed, dtype=torch.bool), (iterations + 1) * len(x))
