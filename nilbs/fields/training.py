"""One training loop for every method, of parameters, a loss and a step number."""

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi
from time import monotonic

import numpy as np
import torch
from torch import Tensor, nn

from nilbs.fields.muon import Muon

# Muon's learning rate in terms of Adam's: its updates have unit singular values, whatever the gradient's size.
MUON_RATE = 2.0


@dataclass(frozen=True)
class TrainingState:
    """All that a training needs in order to go on as if it had never stopped.

    `step` counts the steps done, `tensors` are the parameters and the optimisers' moments, `history` (step,) the
    losses.
    """

    step: int
    tensors: dict[str, np.ndarray]
    history: np.ndarray


def train(
    module: nn.Module,
    loss: Callable[[int], Tensor],
    *,
    steps: int,
    learning_rate: float,
    state: TrainingState | None = None,
    save: Callable[[TrainingState], None] | None = None,
    save_every: int = 1,
    save_seconds: float = 20.0,
    progress: bool = False,
) -> np.ndarray:
    """Minimise a loss over a module's parameters with a one-cycle learning rate.

    Matrices and stacks of them are trained by Muon, which orthogonalises each update; vectors, and all that is called a
    bias, by Adam.

    Parameters
    ----------
    module : torch.nn.Module
        Its parameters are changed in place.
    loss : function of int
        Loss at a step. It must depend on nothing but the step, the parameters and what it saw since the last multiple
        of `save_every`, so that a training continued from a saved state ends where one left alone ends.
    steps : int
        Steps in all, those of `state` included.
    learning_rate : float
        Largest rate of Adam, reached after a tenth of the steps; Muon's is `MUON_RATE` times it.
    state : TrainingState, optional
        Where to go on from.
    save : function of TrainingState, optional
        Called with the state at a multiple of `save_every` steps, every `save_seconds` and when the training is
        interrupted.
    progress : bool
        Show a bar with loss, rate and time left on standard error.

    Returns
    -------
    history : (steps,) float array
        Loss at each step.

    Raises
    ------
    FloatingPointError
        If the loss or a parameter is not finite.
    ValueError
        If the state does not fit the module.
    """
    from nilbs.geometry.progress import progress_bar

    parameters = dict(module.named_parameters())
    optimizers = _optimizers(parameters, learning_rate)
    history = np.zeros(steps)
    first = 0
    if state is not None:
        _restore(parameters, optimizers, state)
        first = min(state.step, steps)
        history[:first] = state.history[:first]
    saved_at = captured_at = monotonic()
    step = first
    latest: TrainingState | None = None
    with progress_bar(total=steps, initial=first, desc="training", unit="step", shown=progress) as bar:
        try:
            while step < steps:
                for optimizer in optimizers:
                    factor = MUON_RATE if isinstance(optimizer, Muon) else 1.0
                    optimizer.param_groups[0]["lr"] = factor * one_cycle(step, steps, learning_rate)
                value = loss(step)
                module.zero_grad(set_to_none=True)
                value.backward()
                history[step] = value.item()
                if not np.isfinite(history[step]):
                    raise FloatingPointError(f"the loss at step {step} is {history[step]}; try a lower learning rate")
                for optimizer in optimizers:
                    optimizer.step()
                step += 1
                if step % 20 == 0 or step == steps:
                    bar.set_postfix(loss=f"{history[max(0, step - 100) : step].mean():.4f}", refresh=False)
                bar.update()
                # States are copies: where every step may have one, a step a second does.
                due = save_every > 1 or monotonic() - captured_at > min(1.0, save_seconds)
                if save is not None and step % save_every == 0 and due:
                    latest = _capture(parameters, optimizers, step, history)
                    captured_at = monotonic()
                    if captured_at - saved_at > save_seconds:
                        save(latest)
                        saved_at = monotonic()
        except KeyboardInterrupt:
            if save is not None and latest is not None:
                save(latest)
            raise
    if not all(bool(torch.isfinite(parameter).all()) for parameter in parameters.values()):
        raise FloatingPointError(f"parameters are not finite after {steps} steps; try a lower learning rate")
    return history


def one_cycle(step: int, steps: int, learning_rate: float) -> float:
    """Rate at a step: linear growth over the first tenth, then half a cosine down to a thousandth.

    References
    ----------
    .. [1] Smith and Topin, Super-convergence, 2017, arXiv:1708.07120.

    Examples
    --------
    >>> [round(one_cycle(step, 100, 1.0), 3) for step in (0, 9, 70, 99)]
    [0.1, 1.0, 0.251, 0.001]
    """
    warm = max(steps // 10, 1)
    if step < warm:
        return learning_rate * (step + 1) / warm
    done = (step - warm) / max(steps - warm, 1)
    return learning_rate * (1e-3 + (1 - 1e-3) * 0.5 * (1 + cos(pi * done)))


def _optimizers(parameters: dict[str, nn.Parameter], learning_rate: float) -> list[torch.optim.Optimizer]:
    """Muon for matrices, Adam for all else; their rates are set at every step."""
    matrices = [p for name, p in parameters.items() if p.ndim > 1 and "bias" not in name]
    others = [p for name, p in parameters.items() if p.ndim < 2 or "bias" in name]
    optimizers: list[torch.optim.Optimizer] = []
    if matrices:
        optimizers.append(Muon(matrices, lr=MUON_RATE * learning_rate))
    if others:
        optimizers.append(torch.optim.Adam(others, lr=learning_rate, fused=True))
    return optimizers


def _moments(optimizers: list[torch.optim.Optimizer], parameter: nn.Parameter) -> dict[str, Tensor]:
    """What an optimiser remembers of a parameter."""
    return next(optimizer.state[parameter] for optimizer in optimizers if parameter in optimizer.state)


def _capture(
    parameters: dict[str, nn.Parameter], optimizers: list[torch.optim.Optimizer], step: int, history: np.ndarray
) -> TrainingState:
    tensors = {}
    for name, parameter in parameters.items():
        for what, tensor in {"value": parameter, **_moments(optimizers, parameter)}.items():
            if what == "step":  # Adam's own count, the same for every parameter
                continue
            tensors[f"{what}.{name}"] = tensor.detach().cpu().numpy().copy()
    return TrainingState(step, tensors, history[:step].copy())


def _restore(
    parameters: dict[str, nn.Parameter], optimizers: list[torch.optim.Optimizer], state: TrainingState
) -> None:
    for optimizer in optimizers:
        for parameter in optimizer.param_groups[0]["params"]:
            name = next(name for name, known in parameters.items() if known is parameter)
            muon = isinstance(optimizer, Muon)
            tensors = {}
            for what in ("value", "momentum_buffer") if muon else ("value", "exp_avg", "exp_avg_sq"):
                array = state.tensors.get(f"{what}.{name}")
                if array is None or array.shape != tuple(parameter.shape):
                    raise ValueError(f"the saved training does not fit: {name} is missing or has another shape")
                tensors[what] = torch.from_numpy(array).to(parameter, copy=True)
            with torch.no_grad():
                parameter.copy_(tensors.pop("value"))
            if not muon:
                tensors["step"] = torch.tensor(float(state.step), dtype=torch.float32, device=parameter.device)
            optimizer.state[parameter] = tensors
