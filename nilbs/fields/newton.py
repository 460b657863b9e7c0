"""Root search: the rest points that forward skinning sends to a posed point, found from a few good starts."""

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from nilbs.fields.cramer import cramer, determinant
from nilbs.fields.forward import Forward

# Lengths are in units of the body's longest edge.
ROOT = 1e-3  # a larger residual is no root
STEP = 0.1  # the longest step
SHORTER = 0.3  # a step that increases the residual is repeated, this much shorter


class ForwardMap(Protocol):
    """What a search inverts: `ForwardField` or `ForwardNetwork`."""

    def blends(self, B: Tensor) -> Tensor:
        """A pose (b, d+1, d+1) in the form that the other two take."""

    def blend(self, x_rest: Tensor, blends: Tensor) -> Tensor:
        """Blended transforms (n, d, d+1) at rest points (n, d)."""

    def pose(self, x_rest: Tensor, blends: Tensor) -> Forward:
        """Posed places of rest points (n, d), and their derivatives."""


class Roots(NamedTuple):
    """Where searches ended: the best points (n, d), their residuals (n,), and whether space is inside out there (n,).

    `evaluations` counts the look-ups of the forward field.
    """

    x_rest: Tensor
    residual: Tensor
    inverted: Tensor
    evaluations: int


def newton(
    x: Tensor, start: Tensor, field: ForwardMap, blends: Tensor, *, iterations: int, accuracy: float | None = None
) -> Roots:
    """Rest points that forward skinning maps to posed points (n, d), by Newton's method from starts (n, d).

    The forward map is piecewise multilinear and its exact derivative comes with its value. A step is no longer than a
    tenth of the body, and one that increases the residual is repeated shorter. Points with a residual below
    `accuracy`, by default a hundred times the precision of x, are done. The result has no graph of derivatives.
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
            trial = x_rest[active] + step
            posed, jacobian = field.pose(trial, blends)
            evaluations += len(trial)
            missing = x[active] - posed
            residual = missing.norm(dim=-1)
            better = residual < best[active]
            improved = active[better]
            x_rest[improved], best[improved] = trial[better], residual[better]
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
    """Roots (n, d) as functions of the posed points and of the pose.

    They are the same points, one Newton step on, with first derivatives by the implicit function theorem: d x_rest =
    J^-1 (d x - d posed), J being the derivative of posed by rest coordinates. `blends` carries the graph if
    derivatives by the pose are needed.
    """
    posed, jacobian = field.pose(root.detach(), blends)
    return root.detach() + cramer(jacobian.detach().unbind(-1), x - posed, dim=-1)
