import itertools

import numpy as np
import pytest
import torch
from torch import nn

from nilbs.fields.training import MUON_RATE, TrainingState, one_cycle, train

STEPS = 40


def module() -> nn.Module:
    torch.manual_seed(1)
    return nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 2))


def loss_of(net: nn.Module, *, stop_at: int | None = None):
    """A regression whose batch depends on the step alone; it can be interrupted once, in the middle of a step."""
    pending = [stop_at]

    def loss(step: int) -> torch.Tensor:
        if pending[0] == step:
            pending[0] = None
            raise KeyboardInterrupt
        rng = np.random.default_rng(step)
        x = torch.as_tensor(rng.normal(size=(16, 3)), dtype=torch.float32)
        return ((net(x) - x[:, :2] ** 2) ** 2).mean()

    return loss


def trained(steps: int = STEPS, **options) -> tuple[nn.Module, np.ndarray]:
    net = module()
    return net, train(net, loss_of(net), steps=steps, learning_rate=0.02, **options)


def assert_same(net: nn.Module, other: nn.Module) -> None:
    for a, b in zip(net.parameters(), other.parameters(), strict=True):
        np.testing.assert_array_equal(a.detach(), b.detach())


def test_the_loss_falls_and_is_remembered() -> None:
    net, history = trained()
    assert history.shape == (STEPS,)
    assert history[-10:].mean() < 0.7 * history[:10].mean()
    fresh = module()
    assert history[0] == loss_of(fresh)(0).item()
    assert not torch.equal(net[0].weight, fresh[0].weight)


def test_vectors_follow_plain_adam_and_matrices_take_orthogonal_steps() -> None:
    states: list[TrainingState] = []
    net, history = trained(save=states.append, save_seconds=-1.0)
    other = module()
    loss = loss_of(other)
    moments = {name: (torch.zeros_like(p), torch.zeros_like(p)) for name, p in other.named_parameters()}
    for step in range(STEPS):
        before = {name: p.detach().clone() for name, p in other.named_parameters()}
        value = loss(step)
        assert value.item() == pytest.approx(history[step], rel=1e-4)
        rate = one_cycle(step, STEPS, 0.02)
        gradients = torch.autograd.grad(value, list(other.parameters()))
        with torch.no_grad():
            for (name, p), g in zip(other.named_parameters(), gradients, strict=True):
                after = torch.from_numpy(states[step].tensors[f"value.{name}"])
                if p.ndim == 2:
                    # The direction is a partial isometry; Newton-Schulz reaches it only roughly, to within a third.
                    stretch = torch.linalg.svdvals(after - before[name])
                    size = MUON_RATE * rate * max(1.0, p.shape[0] / p.shape[1]) ** 0.5
                    assert 0.5 * size < stretch.max() < 1.4 * size
                else:
                    m, v = moments[name]
                    m.mul_(0.9).add_(0.1 * g)
                    v.mul_(0.999).add_(0.001 * g * g)
                    mean, square = m / (1 - 0.9 ** (step + 1)), v / (1 - 0.999 ** (step + 1))
                    p -= rate * mean / (square.sqrt() + 1e-8)
                    torch.testing.assert_close(p, after, rtol=1e-3, atol=1e-4)
                p.copy_(after)
    assert_same(other, net)


def test_a_training_continued_from_any_saved_state_ends_bit_for_bit_the_same() -> None:
    states: list[TrainingState] = []
    net, history = trained(save=states.append, save_seconds=-1.0)
    assert [state.step for state in states] == list(range(1, STEPS + 1))
    for state in (states[0], states[17], states[-1]):
        assert state.history.shape == (state.step,)
        again, continued = trained(state=state)
        np.testing.assert_array_equal(continued, history)
        assert_same(again, net)


def test_a_state_does_not_change_after_it_was_saved() -> None:
    states: list[TrainingState] = []
    trained(save=states.append, save_seconds=-1.0)
    weights = [state.tensors["value.0.weight"] for state in states]
    for a, b in itertools.pairwise(weights):
        assert np.abs(a - b).max() > 0


@pytest.mark.parametrize("stop_at", [1, 25])
def test_an_interrupt_saves_and_is_raised_again(stop_at: int, monkeypatch) -> None:
    seconds = itertools.count(step=1.5)
    monkeypatch.setattr("nilbs.fields.training.monotonic", lambda: next(seconds))
    net, history = trained()
    states: list[TrainingState] = []
    stopped = module()
    with pytest.raises(KeyboardInterrupt):
        train(
            stopped,
            loss_of(stopped, stop_at=stop_at),
            steps=STEPS,
            learning_rate=0.02,
            save=states.append,
            save_seconds=99.0,
        )
    (state,) = states
    assert state.step == stop_at
    again, continued = trained(state=state)
    np.testing.assert_array_equal(continued, history)
    assert_same(again, net)


def test_an_interrupt_before_the_first_step_saves_nothing() -> None:
    states: list[TrainingState] = []
    net = module()
    with pytest.raises(KeyboardInterrupt):
        train(net, loss_of(net, stop_at=0), steps=STEPS, learning_rate=0.02, save=states.append)
    assert not states


def remembering(net: nn.Module, *, every: int, stop_at: int | None = None):
    """A loss that keeps the network's output at the last multiple of a step; it can be interrupted once."""
    loss, seen = loss_of(net, stop_at=stop_at), [torch.full((), torch.nan)]

    def remembered(step: int) -> torch.Tensor:
        if step % every == 0:
            seen[0] = net[0].weight.detach().abs().mean()
        return loss(step) * seen[0]

    return remembered


def test_states_to_continue_from_are_some_steps_apart() -> None:
    states: list[TrainingState] = []
    net = module()
    history = train(
        net, remembering(net, every=6), steps=STEPS, learning_rate=0.02, save=states.append, save_every=6,
        save_seconds=-1.0,
    )  # fmt: skip
    assert [state.step for state in states] == [6, 12, 18, 24, 30, 36]
    for state in states:
        again = module()
        continued = train(again, remembering(again, every=6), steps=STEPS, learning_rate=0.02, state=state)
        np.testing.assert_array_equal(continued, history)
        assert_same(again, net)


@pytest.mark.parametrize(("stop_at", "saved"), [(5, []), (6, [6]), (23, [18])])
def test_an_interrupt_saves_the_last_state_to_continue_from(stop_at: int, saved: list[int]) -> None:
    states: list[TrainingState] = []
    net = module()
    loss = remembering(net, every=6, stop_at=stop_at)
    with pytest.raises(KeyboardInterrupt):
        train(net, loss, steps=STEPS, learning_rate=0.02, save=states.append, save_every=6)
    assert [state.step for state in states] == saved


def test_saving_waits_for_its_time() -> None:
    states: list[TrainingState] = []
    trained(save=states.append, save_seconds=1000.0)
    assert not states


def test_a_loss_that_is_not_finite_stops_with_the_step() -> None:
    net = module()
    before = [p.detach().clone() for p in net.parameters()]
    scale = {7: float("nan")}
    with pytest.raises(FloatingPointError, match=r"^the loss at step 7 is nan; try a lower learning rate$"):
        train(net, lambda step: scale.get(step, 0.0) * net[0].weight.sum(), steps=STEPS, learning_rate=0.02)
    # The step that failed left the parameters alone.
    for a, b in zip(net.parameters(), before, strict=True):
        assert torch.equal(a, b)


def test_parameters_that_are_not_finite_at_the_end_are_refused() -> None:
    net = module()
    with pytest.raises(
        FloatingPointError, match=r"^parameters are not finite after 1 steps; try a lower learning rate$"
    ):
        train(net, lambda step: net[0].bias.sum(), steps=1, learning_rate=1e300)


@pytest.mark.parametrize("damage", ["missing", "shape"])
def test_a_state_of_another_network_is_refused(damage: str) -> None:
    states: list[TrainingState] = []
    trained(save=states.append, save_seconds=-1.0)
    tensors = dict(states[3].tensors)
    if damage == "missing":
        del tensors["exp_avg_sq.2.bias"]
    else:
        tensors["exp_avg.2.bias"] = np.zeros(5, dtype=np.float32)
    with pytest.raises(ValueError, match=r"^the saved training does not fit: 2.bias is missing or has another shape$"):
        trained(state=TrainingState(4, tensors, states[3].history))


def test_progress_does_not_go_to_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    trained(progress=True)
    assert capsys.readouterr().out == ""


def test_the_rate_rises_for_a_tenth_and_falls_by_half_a_cosine() -> None:
    rates = np.array([one_cycle(step, 200, 0.5) for step in range(200)])
    np.testing.assert_allclose(rates[:20], 0.5 * np.arange(1, 21) / 20)
    done = np.arange(180) / 180
    np.testing.assert_allclose(rates[20:], 0.5 * (0.001 + 0.999 * (1 + np.cos(np.pi * done)) / 2))
    assert rates.max() == 0.5
    assert one_cycle(0, 1, 0.5) == 0.5
