import numpy as np
import pytest
import torch

from nilbs.contacts.losses import MovingSkin, contact_loss, penetration_depth, penetration_loss
from nilbs.contacts.pairs import skin_places
from nilbs.contacts.penetration import penetration


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
