"""Muon: momentum whose every update of a matrix is made orthogonal, for stacks of matrices as for single ones."""

from collections.abc import Iterable
from math import sqrt

import torch
from torch import Tensor, nn

# The odd polynomial whose iterates send singular values in (0, 1] to about one, and how often: as in [1].
_NEWTON_SCHULZ, _STEPS = (3.4445, -4.7750, 2.0315), 5


class Muon(torch.optim.Optimizer):
    """Stochastic gradient descent with Nesterov's momentum and orthogonal updates [1]_.

    torch's own takes single matrices; the many small networks of a body's parts lie side by side in stacks of them.

    Parameters
    ----------
    parameters : iterable of (..., m, n) parameters
        Matrices, or stacks of matrices, from n numbers to m.
    lr : float
        Every update has singular values of about this, times sqrt(m / n) where a matrix is tall.
    momentum : float

    References
    ----------
    .. [1] Jordan et al., Muon: an optimizer for hidden layers in neural networks, 2024.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], *, lr: float, momentum: float = 0.95) -> None:
        super().__init__(list(parameters), {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Change the parameters by the gradients that they hold."""
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                state = self.state[parameter]
                if not state:
                    state["momentum_buffer"] = torch.zeros_like(parameter)
                average = state["momentum_buffer"].lerp_(parameter.grad, 1 - group["momentum"])
                update = orthogonal(parameter.grad.lerp(average, group["momentum"]))
                m, n = parameter.shape[-2:]
                parameter.add_(update, alpha=-group["lr"] * sqrt(max(1.0, m / n)))


def orthogonal(G: Tensor) -> Tensor:
    """Matrices (..., m, n) with the singular vectors of those given, and singular values of about one.

    Examples
    --------
    >>> orthogonal(torch.diag(torch.tensor([4.0, 0.1]))).round()
    tensor([[1., 0.],
            [0., 1.]])
    """
    a, b, c = _NEWTON_SCHULZ
    wide = G if G.shape[-2] <= G.shape[-1] else G.mT
    wide = wide / wide.norm(dim=(-2, -1), keepdim=True).clamp_min(1e-12)
    for _ in range(_STEPS):
        gram = wide @ wide.mT
        wide = a * wide + (b * gram + c * gram @ gram) @ wide
    return wide if G.shape[-2] <= G.shape[-1] else wide.mT
