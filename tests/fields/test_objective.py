import numpy as np
import pytest
import torch

from nilbs.fields.cache import RestCache
from nilbs.fields.network import WeightNetwork
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.objective import NilbsObjective, RandomPoses
from nilbs.fields.samples import OccupancySamples, RestSamples
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning

BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])
REFRESH = 5


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nilbs.fields.objective.REFRESH", REFRESH)


def joints(d: int) -> np.ndarray:
    return np.array([[0, 0, 0], [0.5, 0, 0], [1, 0.2, 0.1]])[:, :d]


def field(d: int) -> NilbsField:
    torch.manual_seed(0)
    cache = RestCache(torch.linspace(-1, 1, 4**d).reshape((4,) * d), torch.full((d,), -1.0), 0.7, width=0.1)
    network = WeightNetwork(torch.as_tensor(joints(d)[:2]), scale=1.0, width=8, depth=3)
    return NilbsField(network, cache, root=0).double()


def motion(d: int, frames: int) -> np.ndarray:
    theta = np.random.default_rng(2).normal(size=(frames, 2, 3 if d == 3 else 1))
    return forward_kinematics(joints(d), BE, P, theta)


def objective(d: int, *, frames: int = 3, points: int = 20, random: bool = True, **changes) -> NilbsObjective:
    rng = np.random.default_rng(4)
    x, inside = rng.normal(size=(frames, points, d)).astype(np.float32), rng.random((frames, points)) < 0.5
    rest = RestSamples(rng.normal(size=(points, d)).astype(np.float32), rng.dirichlet(np.ones(2), points))
    options = {
        "random_poses": RandomPoses(joints(d), BE, P, 0.8) if random else None,
        "poses_per_step": 4,
        "points_per_pose": 6,
        "weight_loss": 0.7,
        "seed": 11,
    } | changes
    return NilbsObjective(field(d), motion(d, frames), OccupancySamples(x, inside), rest, **options)


def learn(loss: NilbsObjective) -> None:
    with torch.no_grad():
        for parameter in loss.field.parameters():
            parameter += 0.1


@pytest.mark.parametrize("random", [True, False])
def test_a_step_depends_on_its_number_and_the_last_look(random: bool) -> None:
    loss = objective(3, random=random)
    first = [loss(step).item() for step in range(REFRESH)]
    assert len(set(first)) == REFRESH
    # Whatever came before in the same stretch between two looks.
    again = objective(3, random=random)
    assert again(0).item() == first[0]
    assert [again(step).item() for step in reversed(range(1, REFRESH))] == first[:0:-1]
    assert objective(3, random=random, seed=12)(0).item() != first[0]


def test_the_loss_goes_on_at_a_look_as_if_it_had_never_stopped() -> None:
    loss, fresh = objective(3), objective(3)
    loss(0)
    learn(loss)
    learn(fresh)
    stretch = range(REFRESH, 2 * REFRESH)
    assert [loss(step).item() for step in stretch] == [fresh(step).item() for step in stretch]
    # Between two looks it cannot: a new objective has not seen what the old one saw.
    assert objective(3)(REFRESH + 1).item() != fresh(REFRESH + 1).item()


@pytest.mark.parametrize("d", [2, 3])
def test_points_are_drawn_by_the_squared_error_of_their_occupancy_at_the_last_look(d: int) -> None:
    loss = objective(d)
    with torch.no_grad():
        values = loss.field(loss.x, loss.poses)
    inside = (1 - values.weights[..., -1]) * torch.sigmoid(-values.distance / loss.field.cache.width)
    error = ((inside - loss.inside.double()) ** 2).numpy()
    assert error.max() > 2 * error.mean()
    loss(0)
    np.testing.assert_allclose(loss.sampler.mass, 0.5 + 0.5 * error / error.mean())
    seen = loss.sampler.mass
    learn(loss)
    for step in range(1, REFRESH):
        loss(step)
        np.testing.assert_array_equal(loss.sampler.mass, seen)
    loss(REFRESH)
    assert np.abs(loss.sampler.mass - seen).max() > 1e-3


@pytest.mark.parametrize("d", [2, 3])
def test_both_losses_of_the_paper_where_there_is_nothing_to_choose(d: int) -> None:
    # One frame, one labelled point and one rest point: every draw is the same.
    loss = objective(d, frames=1, points=1, random=False)
    nilbs, B = loss.field, loss.poses
    values = nilbs(loss.x, B)
    inside = (1 - values.weights[..., -1]) * torch.sigmoid(-values.distance / nilbs.cache.width)
    occupancy_loss = -torch.log(inside if loss.inside.item() else 1 - inside)
    rest = torch.eye(d + 1, dtype=torch.float64).expand(1, 2, d + 1, d + 1)
    weights = torch.softmax(nilbs.network(loss.x_rest[None], rest), dim=-1)
    weight_loss = -(loss.W * torch.log(weights[0, :, :-1])).sum()
    torch.testing.assert_close(loss(0), (occupancy_loss + 0.7 * weight_loss).squeeze())


@pytest.mark.parametrize("d", [2, 3])
def test_rest_points_are_posed_by_skinning(d: int) -> None:
    # Without random amplitude all poses are the rest pose or the one frame; the network sees points posed by either.
    still = RandomPoses(joints(d), BE, P, 0.0)
    loss = objective(d, frames=1, points=1, random_poses=still, poses_per_step=2, points_per_pose=1)
    x_rest, W, B = loss.x_rest.numpy(), loss.W.numpy(), loss.poses[0].numpy()
    expected = 0.0
    for pose in (np.broadcast_to(np.eye(d + 1), B.shape), B):
        x = torch.as_tensor(linear_blend_skinning(x_rest, W, pose))[None]
        weights = torch.softmax(loss.field.network(x, torch.as_tensor(pose.copy())[None]), dim=-1)
        expected -= (loss.W * torch.log(weights[0, :, :-1])).sum() / 2
    without = objective(d, frames=1, points=1, random_poses=still, poses_per_step=2, points_per_pose=1, weight_loss=0.0)
    torch.testing.assert_close(loss(0) - without(0), 0.7 * expected)


@pytest.mark.parametrize("d", [2, 3])
def test_random_poses_turn_all_bones_but_the_root_by_up_to_their_spread(d: int, rng: np.random.Generator) -> None:
    B = RandomPoses(joints(d), BE, P, 0.5).draw(2000, rng)
    np.testing.assert_array_equal(B[:, 0], np.broadcast_to(np.eye(d + 1), (2000, d + 1, d + 1)))
    trace = np.trace(B[:, 1, :d, :d], axis1=1, axis2=2)
    angle = np.arccos(np.clip((trace - (d - 2)) / 2, -1, 1))
    # The mean square of a normal angle whose spread is uniform up to 0.5 is 0.25 / 3.
    assert (angle**2).mean() == pytest.approx(0.25 / 3, rel=0.15)


def test_only_the_network_learns() -> None:
    loss = objective(2)
    loss(0).backward()
    for name, parameter in loss.field.named_parameters():
        assert name.startswith("network.")
        assert parameter.grad is not None
        assert torch.isfinite(parameter.grad).all()


@pytest.mark.parametrize("d", [2, 3])
def test_the_position_loss_is_how_far_the_inverse_map_misses_the_rest_points(d: int) -> None:
    # One frame, one labelled point and one rest point in the rest pose, where every blend is the identity ...
    options = {"frames": 1, "points": 1, "random": False}
    assert objective(d, position_loss=3.0, **options)(1).item() == pytest.approx(objective(d, **options)(1).item())
    # ... and in random poses, where it is not.
    without, loss = objective(d, points=1), objective(d, points=1, position_loss=3.0)
    step = 1
    rng = np.random.default_rng([loss.seed, step])
    loss.sampler.draw(loss.poses_per_step, loss.points_per_pose, rng)
    B = loss._weight_poses(rng).numpy()
    missed = []
    for pose in B:
        x_rest, W = loss.x_rest.numpy(), loss.W.numpy()
        x = linear_blend_skinning(x_rest, W, pose)
        predicted = torch.softmax(loss.field.network(torch.as_tensor(x)[None], torch.as_tensor(pose)[None]), -1)[0]
        back = inverse_linear_blend_skinning(x, predicted.detach().numpy(), np.concatenate([pose, pose[:1]]))
        missed.append(min(np.abs(back - x_rest).sum(), 1.0))
    assert np.mean(missed) > 1e-3
    assert loss(step).item() - without(step).item() == pytest.approx(3.0 * np.mean(missed), rel=1e-5)
