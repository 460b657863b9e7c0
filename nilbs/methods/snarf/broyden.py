"""Broyden's method: roots of many small systems at once, from a few values of the function and no derivative."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

# The least by which an update of the inverse is divided, in terms of the squared step.
SMALLEST = 1e-3


class BroydenRoots(NamedTuple):
    """The best points (m, d) of searches, their residuals (m,), which converged (m,), and evaluations of the map."""

    x_rest: Tensor
    residual: Tensor
    converged: Tensor
    evaluations: int


def broyden(
    forward: Callable[[Tensor, Tensor], Tensor],
    x: Tensor,
    start: Tensor,
    inverse_jacobian: Tensor,
    *,
    iterations: int,
    x_start: Tensor | None = None,
    convergence: float = 1e-5,
    divergence: float = 1.0,
) -> BroydenRoots:
    """Points that a map sends to given places x (m, d), by Broyden's first ("good") method [1]_.

    Parameters
    ----------
    forward : function of (a, d) tensor and (a,) int tensor
        The map at points (a, d); the integers are the searches, of m, that the points belong to.
    x, start : (m, d) tensors
        Where the map must send the roots, and where the searches start.
    inverse_jacobian : (m, d, d) tensor
        Inverse of the map's derivative at or about the start.
    iterations : int
        The most steps; each evaluates the map once at every point that is not done.
    x_start : (m, d) tensor, optional
        The map at the starts, if computed already.
    convergence, divergence : float
        A residual below the first ends a search, one above the second gives it up.

    Returns
    -------
    roots : BroydenRoots
        Without a graph of derivatives.

    References
    ----------
    .. [1] Broyden, A class of methods for solving nonlinear simultaneous equations, 1965.

    Examples
    --------
    >>> x, start = torch.tensor([[4.0, 9.0]]), torch.tensor([[1.5, 2.5]])
    >>> roots = broyden(lambda z, _: z**2, x, start, torch.diag_embed(0.5 / start), iterations=10)
    >>> roots.x_rest.round(decimals=3).tolist(), roots.converged.tolist()
    ([[2.0, 3.0]], [True])
    """
    with torch.no_grad():
        active = torch.arange(len(x), device=x.device)
        evaluations = 0
        if x_start is None:
            x_start = forward(start, active)
            evaluations += len(start)
        at, error, inverse = start, x_start - x, inverse_jacobian
        best, residual = start.clone(), _length(error)
        going = residual >= convergence  # also drops what is not a number
        for _ in range(iterations):
            active, at, error, inverse = active[going], at[going], error[going], inverse[going]
            if not len(active):
                break
            step = -_times(inverse, error)
            at = at + step
            change = -error
            error = forward(at, active) - x[active]
            change = change + error
            evaluations += len(active)
            length = _length(error)
            better = length < residual[active]
            best[active[better]], residual[active[better]] = at[better], length[better]
            going = (length >= convergence) & (length < divergence)
            predicted = _times(inverse, change)
            row = _times(inverse.mT, step)
            scale = (step * predicted).sum(dim=-1)
            least = SMALLEST * (step * step).sum(dim=-1)
            scale = torch.where(scale.abs() < least, torch.where(scale < 0, -least, least), scale)
            inverse = inverse + (step - predicted)[:, :, None] * (row / scale[:, None])[:, None]
        return BroydenRoots(best, residual, residual < convergence, evaluations)


def _length(v: Tensor) -> Tensor:
    return (v * v).sum(dim=-1).sqrt()


def _times(matrix: Tensor, v: Tensor) -> Tensor:
    return (matrix * v[:, None]).sum(dim=-1)
