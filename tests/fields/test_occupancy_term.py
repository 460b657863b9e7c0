import numpy as np
import pytest
import torch

from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import LocalEncoding
from nilbs.fields.network import WeightNetwork
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.occupancy_term import OccupancyTerm
from nilbs.fields.samples import OccupancySamples
from nilbs.geometry.kinematics import forward_kinematics

BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])


def joints(d: int) -> np.ndarray:
    return np.array([[0, 0, 0], [0.5, 0, 0], [1, 0.2, 0.1]])[:, :d]


def field(d: int) -> NilbsField:
    torch.manual_seed(0)
    cache = RestCache.of_grid(torch.linspace(-1, 1, 4**d).reshape((4,) * d), torch.full((d,), -1.0), 0.7, width=0.1)
    network = WeightNetwork(LocalEncoding(torch.as_tensor(joints(d)[:2])), 2, width=8, depth=3)
    return NilbsField(network, cache, root=0).double()


def motion(d: int, frames: int) -> torch.Tensor:
    theta = np.random.default_rng(2).normal(size=(frames, 2, 3 if d == 3 else 1))
    return torch.as_tensor(forward_kinematics(joints(d), BE, P, theta))


def term(d: int, *, frames: int = 3, points: int = 20, **changes) -> tuple[NilbsField, OccupancyTerm]:
    rng = np.random.default_rng(4)
    x, inside = rng.normal(size=(frames, points, d)).astype(np.float32), rng.random((frames, points)) < 0.5
    nilbs = field(d)
    options = {"poses_per_step": 4, "points_per_pose": 6} | changes
    return nilbs, OccupancyTerm(nilbs.logit, motion(d, frames), OccupancySamples(x, inside), **options)


def occupancy(nilbs: NilbsField, loss: OccupancyTerm) -> torch.Tensor:
    """Occupancy of all labelled points by eq. 8."""
    values = nilbs(loss.x, loss.poses)
    return (1 - values.weights[..., -1]) * torch.sigmoid(-values.distance / nilbs.cache.width)


@pytest.mark.parametrize("d", [2, 3])
def test_points_are_drawn_by_the_squared_error_of_their_occupancy_at_the_last_look(d: int) -> None:
    nilbs, loss = term(d)
    with torch.no_grad():
        error = ((occupancy(nilbs, loss) - loss.inside) ** 2).numpy()
    assert error.max() > 2 * error.mean()
    np.testing.assert_array_equal(loss.sampler.mass, 1)
    loss.look()
    np.testing.assert_allclose(loss.sampler.mass, 0.5 + 0.5 * error / error.mean())


@pytest.mark.parametrize("changes", [{"adaptive": False}, {"factor": 0.0}])
def test_where_points_are_not_drawn_by_error_nobody_looks(changes: dict) -> None:
    _, loss = term(2, **changes)
    loss.look()
    np.testing.assert_array_equal(loss.sampler.mass, 1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("factor", [1.0, 0.3])
def test_the_losses_where_there_is_nothing_to_choose(d: int, factor: float, rng: np.random.Generator) -> None:
    # One frame and one labelled point: every draw is the same.
    nilbs, loss = term(d, frames=1, points=1, factor=factor)
    inside = occupancy(nilbs, loss)
    expected = -torch.log(inside if loss.inside.item() else 1 - inside).squeeze()
    torch.testing.assert_close(loss(rng), factor * expected)
    _, absolute = term(d, frames=1, points=1, factor=factor, absolute=True)
    torch.testing.assert_close(absolute(rng), factor * (inside - loss.inside).abs().squeeze())


def test_the_field_learns_from_it(rng: np.random.Generator) -> None:
    nilbs, loss = term(2)
    loss(rng).backward()
    for parameter in nilbs.parameters():
        assert torch.isfinite(parameter.grad).all()
    assert sum(parameter.grad.abs().sum() for parameter in nilbs.parameters()) > 0
