import numpy as np
import pytest
import torch

from nilbs.contacts.losses import MovingSkin, contact_loss, penetration_depth, penetration_loss, self_contact_loss
from nilbs.contacts.pairs import skin_places
from nilbs.contacts.penetration import penetration
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.fields.kinematics import forward_kinematics


def bent(moved, rng, d: int) -> np.ndarray:
    """A pose whose bones differ a little."""
    return moved(d) + 0.05 * np.concatenate([rng.normal(size=(2, d, d + 1)), np.zeros((2, 1, d + 1))], axis=1)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_depth(capsules, moved, rng, d) -> None:
    model, pose = capsules[d], bent(moved, rng, d)
    x = rng.uniform(-0.5, 0.5, (400, d))
    # Clear of the skin, where depth has a corner, and of the middle, where the closest place jumps.
    depth = penetration(model, x, pose).depth
    x = np.concatenate([x[(depth > 0.01) & (depth < 0.1)][:6], [[2.0] * d]])
    assert len(x) == 7
    points, poses = (torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (x, pose))
    assert torch.autograd.gradcheck(lambda a, b: penetration_depth(model, a, b), (points, poses), eps=1e-7, atol=1e-5)
    assert torch.autograd.gradcheck(lambda a, b: penetration_loss(model, a, b), (points, poses), eps=1e-7, atol=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_places_move_with_the_skin(capsules, moved, rng, d) -> None:
    model, pose = capsules[d], bent(moved, rng, d)
    c = model.character
    skin = skin_places(c.V, c.F, samples=40)
    moving = MovingSkin(model, skin)
    poses = torch.tensor(pose, requires_grad=True)
    np.testing.assert_allclose(moving(poses).detach().numpy(), skin.at(model.posed(pose).U, c.F), atol=1e-12)
    assert torch.autograd.gradcheck(moving, (poses,))


@pytest.mark.parametrize("d", [2, 3])
def test_the_loss_of_two_bodies_depends_on_both_poses(capsules, moved, rng, d) -> None:
    model = capsules[d]
    skin = MovingSkin(model, skin_places(model.character.V, model.character.F, samples=30))
    poses = [torch.tensor(pose, requires_grad=True) for pose in (bent(moved, rng, d), bent(moved, rng, d))]
    poses[1].data[:, 0, d] += 0.25
    loss = contact_loss(model, poses[0], model, poses[1], skins=(skin, skin))
    loss.backward()
    direction = [torch.tensor(rng.normal(size=pose.shape)) for pose in poses]
    for pose, along in zip(poses, direction, strict=True):
        along[:, -1] = 0
        there, back = (pose.detach() + h * along for h in (1e-6, -1e-6))
        others = [p.detach() for p in poses]
        values = []
        for moved_pose in (there, back):
            both = [moved_pose if p is pose else q for p, q in zip(poses, others, strict=True)]
            values.append(contact_loss(model, both[0], model, both[1], skins=(skin, skin)).item())
        assert loss > 0
        assert (values[0] - values[1]) / 2e-6 == pytest.approx((pose.grad * along).sum().item(), rel=1e-3, abs=1e-9)


def test_a_step_down_the_loss_moves_bodies_apart(capsules, moved) -> None:
    model = capsules[3]
    a = torch.tensor(moved(3))
    b = torch.tensor(moved(3, 0.35), requires_grad=True)
    loss = contact_loss(model, a, model, b)
    loss.backward()
    assert loss > 0
    assert (b.grad[:, 0, 3].sum() < 0).item()  # to the side that is free
    further = b.detach() - 20 * b.grad
    assert contact_loss(model, a, model, further) < 0.5 * loss


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_the_loss_of_one_body(chains, rolled, d) -> None:
    chain = chains[d]
    finder = SelfContactFinder(chain, samples=300)
    pose = torch.tensor(rolled(chain, 62), requires_grad=True)
    loss = self_contact_loss(chain, pose, finder=finder)
    found = finder(pose.detach().numpy())
    assert len(found.depth) > 5
    assert loss.item() == pytest.approx((found.depth**2).sum() / 300, rel=1e-3)
    assert torch.autograd.gradcheck(
        lambda p: self_contact_loss(chain, p, finder=finder), (pose,), eps=1e-7, atol=1e-7, rtol=1e-3
    )
    assert self_contact_loss(chain, torch.tensor(rolled(chain, 20)), finder=finder) == 0
    single = self_contact_loss(chain, pose.detach().float(), finder=finder)
    assert single.dtype == torch.float32
    assert single.item() == pytest.approx(loss.item(), rel=1e-3)


def test_steps_down_the_loss_of_one_body_unroll_it(chains, rolled) -> None:
    chain = chains[3]
    s, finder = chain.character.skeleton, SelfContactFinder(chain, samples=2000)
    theta = torch.zeros((len(s.BE), 3), dtype=torch.float64)
    theta[1:, 2] = np.radians(62)
    theta.requires_grad_()
    losses = []
    for _ in range(4):
        loss = self_contact_loss(chain, forward_kinematics(torch.tensor(s.C), s.BE, s.P, theta), finder=finder)
        losses.append(loss.item())
        (slope,) = torch.autograd.grad(loss, theta)
        theta.data -= 0.06 * slope / slope.norm()
    assert (np.diff(losses) < 0).all()
    assert losses[-1] < 0.5 * losses[0]
