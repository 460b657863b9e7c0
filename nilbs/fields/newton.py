"""Root search: the rest points that forward skinning sends to a posed point, found from a few good starts."""

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from nilbs.fields.cramer import cramer, determinant
from nilbs.fields.forward import Forward

# Lengths are in units of the body's longest edge.
ROOT = 1e-3  # farther from where it must be than this is no root
STEP = 0.1  # the longest step
SHORTER = 0.3  # a step that led farther away is taken again, this much shorter


class ForwardMap(Protocol):
    """What a search goes on: `ForwardField` or `ForwardNetwork`."""

    def blends(self, B: Tensor) -> Tensor:
        """What a pose (b, d+1, d+1) is to the other two."""

    def blend(self, x_rest: Tensor, blends: Tensor) -> Tensor:
        """Blended transforms (n, d, d+1) at rest points (n, d)."""

    def pose(self, x_rest: Tensor, blends: Tensor) -> Forward:
        """Posed places of rest points (n, d), and their derivatives."""


class Roots(NamedTuple):
    """Where a search ended, and what it took.

    Attributes
    ----------
    x_rest : (n, d) tensor
        The best places met.
    residual : (n,) tensor
        How far their images miss.
    inverted : (n,) bool tensor
        Whether the forward map turns space inside out there.
    evaluations : int
        Look-ups of the forward field.
    """

    x_rest: Tensor
    residual: Tensor
    inverted: Tensor
    evaluations: int


def newton(
    x: Tensor, start: Tensor, field: ForwardMap, blends: Tensor, *, iterations: int, accuracy: float | None = None
) -> Roots:
    """Rest points that forward skinning sends to posed points.

    Parameters
    ----------
    x : (n, d) tensor
        Posed points.
    start : (n, d) tensor
        Where to begin.
    field : ForwardField or ForwardNetwork
    blends : (rows, d (d+1)) tensor
        Of the pose.
    iterations : int
        The most steps; each looks the field up once, and there is one look-up more.
    accuracy : float
        Points that miss by less are done; by default a hundred times the precision of x.

    Returns
    -------
    roots : Roots
        The best places met, without a graph of derivatives.

    Notes
    -----
    Newton's method on the piecewise multilinear forward map, whose exact derivative comes with its value. A step is no
    longer than a tenth of the body, and one that leads farther away is taken back and made shorter.
    """
    if accuracy is None:
        accuracy = 100 * torch.finfo(x.dtype).eps
    with torch.no_grad():
        x_rest, best = start.clone(), torch.full_like(start[:, 0], torch.inf)
        inverted = torch.zeros_like(best, dtype=torch.bool)
        step = torch.zeros_like(start)
        active = torch.arange(len(x), device=x.device)
        evaluations = 0
        for _ in range(iterations + 1):
            guess = x_rest[active] + step
            posed, jacobian = field.pose(guess, blends)
            evaluations += len(guess)
            missing = x[active] - posed
            residual = missing.norm(dim=-1)
            better = residual < best[active]
            improved = active[better]
            x_rest[improved], best[improved] = guess[better], residual[better]
            inverted[improved] = determinant(jacobian[better].unbind(-1), dim=-1) < 0
            newton_step = cramer(jacobian.unbind(-1), missing, dim=-1)
            newton_step = newton_step * (STEP / newton_step.norm(dim=-1, keepdim=True).clamp_min(STEP))
            step = torch.where(better[:, None], newton_step, SHORTER * step)
            going = best[active] > accuracy
            if not bool(going.any()):
                break
            active, step = active[going], step[going]
        return Roots(x_rest, best, inverted, evaluations)


def implicit(x: Tensor, root: Tensor, field: ForwardMap, blends: Tensor) -> Tensor:
    """Roots as functions of the posed points and of the pose.

    Parameters
    ----------
    x : (n, d) tensor
        Posed points.
    root : (n, d) tensor
        Their rest images, found without a graph.
    field : ForwardField or ForwardNetwork
    blends : (rows, d (d+1)) tensor
        Of the pose, with a graph where derivatives by it are wanted.

    Returns
    -------
    x_rest : (n, d) tensor
        The same places, one Newton step on, with first derivatives by the implicit function theorem:
        d x_rest = J^-1 (d x - d posed), J being the derivative of posed by rest coordinates.
    """
    posed, jacobian = field.pose(root.detach(), blends)
    return root.detach() + cramer(jacobian.detach().unbind(-1), x - posed, dim=-1)
