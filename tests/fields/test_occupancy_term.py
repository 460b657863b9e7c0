from collections.abc import Callable

import numpy as np
import pytest
import torch

from nilbs.fields import occupancy_term
from nilbs.fields.inverse_map import InverseField
from nilbs.fields.occupancy_term import STRIDE, OccupancyTerm
from nilbs.fields.samples import OccupancySamples


@pytest.fixture
def term(chain) -> Callable[..., tuple[InverseField, OccupancyTerm]]:
    """A field, and its occupancy loss on a few labelled points."""

    def made(d: int, *, frames: int = 3, points: int = 20, **changes) -> tuple[InverseField, OccupancyTerm]:
        rng = np.random.default_rng(4)
        x, inside = rng.normal(size=(frames, points, d)).astype(np.float32), rng.random((frames, points)) < 0.5
        nilbs = chain.field(d)
        options = {"poses_per_step": 4, "points_per_pose": 6, "adaptive": True} | changes
        return nilbs, OccupancyTerm(nilbs.logit, chain.motion(d, frames), OccupancySamples(x, inside), **options)

    return made


def occupancy(nilbs: InverseField, loss: OccupancyTerm) -> torch.Tensor:
    """Occupancy of all labelled points by eq. 8."""
    x, B = loss.x, loss.poses
    return (1 - nilbs.weights(x, B)[..., -1]) * nilbs.cache.occupancy(nilbs.canonical_points(x, B))


@pytest.mark.parametrize("d", [2, 3])
def test_points_are_drawn_by_the_squared_error_of_their_occupancy_at_the_last_refresh(d: int, term) -> None:
    nilbs, loss = term(d)
    with torch.no_grad():
        error = ((occupancy(nilbs, loss) - loss.inside) ** 2).numpy()
    assert error.max() > 2 * error.mean()
    np.testing.assert_array_equal(loss.sampler.mass, 1)
    for turn in range(1, 7):
        loss.refresh(turn)
        seen = np.arange(error.shape[1]) % STRIDE == turn % STRIDE
        np.testing.assert_allclose(loss.sampler.mass, 0.5 + 0.5 * seen * error * error.size / error[:, seen].sum())
    loss.refresh(0)
    np.testing.assert_array_equal(loss.sampler.mass, 1)


@pytest.mark.parametrize("changes", [{"adaptive": False}, {"factor": 0.0}])
def test_errors_are_not_evaluated_if_points_are_not_drawn_by_error(changes: dict, term) -> None:
    _, loss = term(2, **changes)
    loss.refresh(1)
    np.testing.assert_array_equal(loss.sampler.mass, 1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("factor", [1.0, 0.3])
def test_the_losses_of_a_single_point(d: int, factor: float, term, rng: np.random.Generator) -> None:
    # One frame and one labelled point: every draw is the same.
    nilbs, loss = term(d, frames=1, points=1, factor=factor)
    inside = occupancy(nilbs, loss)
    expected = -torch.log(inside if loss.inside.item() else 1 - inside).squeeze()
    torch.testing.assert_close(loss(rng), factor * expected)
    _, absolute = term(d, frames=1, points=1, factor=factor, absolute=True)
    torch.testing.assert_close(absolute(rng), factor * (inside - loss.inside).abs().squeeze())


def test_the_field_learns_from_it(term, rng: np.random.Generator) -> None:
    nilbs, loss = term(2)
    loss(rng).backward()
    for parameter in nilbs.parameters():
        assert torch.isfinite(parameter.grad).all()
    assert sum(parameter.grad.abs().sum() for parameter in nilbs.parameters()) > 0


def test_a_refresh_in_chunks_has_the_same_errors(term, monkeypatch) -> None:
    nilbs, loss = term(2, points=80)
    loss.refresh(1)
    whole, sizes, logit = loss.sampler.mass.copy(), [], nilbs.logit
    monkeypatch.setattr(occupancy_term, "CHUNK", 7)
    loss.logit = lambda x, B: (sizes.append(x.shape[1]), logit(x, B))[1]
    loss.refresh(1)
    np.testing.assert_allclose(loss.sampler.mass, whole)
    assert sizes == [7, 7, 6] * 3
