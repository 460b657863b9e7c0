import numpy as np
import pytest
import torch

from nilbs.fields.cache import RestCache
from nilbs.fields.network import WeightNetwork
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.objective import NilbsObjective, RandomPoses
from nilbs.fields.samples import OccupancySamples, RestSamples
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.skinning import linear_blend_skinning

BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])


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


@pytest.mark.parametrize("random", [True, False])
def test_a_step_depends_on_its_number_alone(random: bool) -> None:
    loss = objective(3, random=random)
    forward = [loss(step).item() for step in range(6)]
    backward = [loss(step).item() for step in reversed(range(6))]
    assert forward == backward[::-1]
    assert len(set(forward)) == 6
    assert objective(3, random=random)(3).item() == forward[3]
    assert objective(3, random=random, seed=12)(3).item() != forward[3]


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
