from collections.abc import Callable

import numpy as np
import pytest
import torch

from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.samples import RestSamples
from nilbs.fields.weight_term import ForwardWeightTerm, WeightTerm, cross_entropy
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning


def samples(d: int, points: int) -> RestSamples:
    rng = np.random.default_rng(4)
    return RestSamples(rng.normal(size=(points, d)).astype(np.float32), rng.dirichlet(np.ones(2), points))


@pytest.fixture
def term(chain) -> Callable[..., WeightTerm]:
    """The weight loss on a few rest points."""

    def made(
        d: int, *, frames: int = 3, points: int = 20, random: bool = True, posed: bool = True, **changes
    ) -> WeightTerm:
        options = {
            "random_poses": chain.motion(d, 7) if random else None,
            "poses_per_step": 4,
            "points_per_pose": 6,
            "factor": 0.7,
        } | changes
        return WeightTerm(chain.field(d), chain.motion(d, frames) if posed else None, samples(d, points), **options)

    return made


def generator() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.mark.parametrize("d", [2, 3])
def test_the_paper_s_own_loss_is_that_of_the_rest_pose(d: int, term) -> None:
    loss = term(d, points=1, posed=False)
    rest = torch.eye(d + 1, dtype=torch.float64).expand(1, 2, d + 1, d + 1)
    W = torch.softmax(loss.field.network(loss.x_rest[None], rest), dim=-1)
    torch.testing.assert_close(loss(generator()), -0.7 * (loss.W * torch.log(W[0, :, :-1])).sum())


@pytest.mark.parametrize("d", [2, 3])
def test_rest_points_are_posed_by_skinning(d: int, term, chain) -> None:
    # All poses are the rest pose or the one frame; the network sees points posed by either.
    still = torch.eye(d + 1, dtype=torch.float64).expand(5, 2, d + 1, d + 1)
    loss = term(d, frames=1, points=1, random_poses=still, poses_per_step=2, points_per_pose=1)
    x_rest, W, B = loss.x_rest.numpy(), loss.W.numpy(), loss.poses[0].numpy()
    expected = 0.0
    for pose in (np.broadcast_to(np.eye(d + 1), B.shape), B):
        x = torch.as_tensor(linear_blend_skinning(x_rest, W, pose))[None]
        weights = torch.softmax(loss.field.network(x, torch.as_tensor(pose.copy())[None]), dim=-1)
        expected -= (loss.W * torch.log(weights[0, :, :-1])).sum() / 2
    torch.testing.assert_close(loss(generator()), 0.7 * expected)


@pytest.mark.parametrize("d", [2, 3])
def test_poses_come_from_the_motion_and_from_the_generator(d: int, term, chain) -> None:
    frames = chain.motion(d, 3)
    known = lambda B: (B[:, None] == frames[None]).flatten(2).all(dim=-1).any(dim=-1)  # noqa: E731
    assert known(term(d, random=False).draw_poses(generator())).tolist() == [True] * 4
    more = chain.motion(d, 9)[3:]
    drawn = term(d, random_poses=more).draw_poses(generator())
    assert known(drawn).tolist() == [False, False, True, True]
    assert all((pose == more).flatten(1).all(dim=1).any() for pose in drawn[:2])


@pytest.mark.parametrize("d", [2, 3])
def test_the_position_loss_is_how_far_the_inverse_map_misses_the_rest_points(d: int, term) -> None:
    # In the rest pose, where every blend is the identity ...
    options = {"posed": False, "points": 1}
    assert term(d, position_loss=3.0, **options)(generator()).item() == pytest.approx(
        term(d, **options)(generator()).item()
    )
    # ... and in random poses, where it is not.
    without, loss = term(d, points=1), term(d, points=1, position_loss=3.0)
    missed = []
    for pose in loss.draw_poses(generator()).numpy():
        x_rest, W = loss.x_rest.numpy(), loss.W.numpy()
        x = linear_blend_skinning(x_rest, W, pose)
        predicted = torch.softmax(loss.field.network(torch.as_tensor(x)[None], torch.as_tensor(pose)[None]), -1)[0]
        back = inverse_linear_blend_skinning(x, predicted.detach().numpy(), np.concatenate([pose, pose[:1]]))
        missed.append(min(np.abs(back - x_rest).sum(), 1.0))
    assert np.mean(missed) > 1e-3
    assert loss(generator()).item() - without(generator()).item() == pytest.approx(3.0 * np.mean(missed), rel=1e-5)


def test_only_the_network_learns(term) -> None:
    loss = term(2)
    loss(generator()).backward()
    for name, parameter in loss.field.named_parameters():
        assert name.startswith("network.")
        assert torch.isfinite(parameter.grad).all()


@pytest.mark.parametrize("d", [2, 3])
def test_a_forward_network_learns_the_weights_of_rest_points(d: int) -> None:
    torch.manual_seed(0)
    network = ForwardNetwork(d, 2, width=8, depth=3).double()
    loss = ForwardWeightTerm(network, samples(d, 1), points=5)
    expected = -(loss.W * torch.log_softmax(network.logits(loss.x_rest), dim=-1)).sum()
    torch.testing.assert_close(loss(generator()), expected)


def test_cross_entropy_leaves_the_ghost_out() -> None:
    logits, W = torch.tensor([[0.2, -0.4, 1.0]]), torch.tensor([[0.25, 0.75]])
    log = torch.log_softmax(logits, dim=-1)[0]
    torch.testing.assert_close(cross_entropy(logits, W), -(0.25 * log[0] + 0.75 * log[1]))
    log = torch.log_softmax(logits[:, :2], dim=-1)[0]
    torch.testing.assert_close(cross_entropy(logits[:, :2], W), -(0.25 * log[0] + 0.75 * log[1]))
