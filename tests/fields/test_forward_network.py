import numpy as np
import pytest
import torch

from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.newton import newton
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices
from nilbs.geometry.skinning import linear_blend_skinning

BONES = 3


def network(d: int) -> ForwardNetwork:
    torch.manual_seed(2)
    return ForwardNetwork(d, BONES, width=8, depth=3).double()


def pose(d: int, rng: np.random.Generator) -> torch.Tensor:
    theta = 0.5 * rng.normal(size=(BONES, 3 if d == 3 else 1))
    return torch.as_tensor(rigid_transforms(rotation_matrices(theta), 0.1 * rng.normal(size=(BONES, d))))


@pytest.mark.parametrize("d", [2, 3])
def test_points_are_skinned_with_the_weights_of_the_network(d: int, rng: np.random.Generator) -> None:
    net, B, x_rest = network(d), pose(d, rng), rng.normal(size=(30, d))
    with torch.no_grad():
        W = torch.softmax(net.logits(torch.as_tensor(x_rest)), dim=-1).numpy()
        moved = net.pose(torch.as_tensor(x_rest), net.blends(B)).x.numpy()
        blend = net.blend(torch.as_tensor(x_rest), net.blends(B)).numpy()
    np.testing.assert_allclose(moved, linear_blend_skinning(x_rest, W, B.numpy()), atol=1e-12)
    np.testing.assert_allclose(blend, np.einsum("nb,bij->nij", W, B.numpy()[:, :d]), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_the_derivative_carried_along_is_that_of_autograd(d: int, rng: np.random.Generator) -> None:
    net, B = network(d), pose(d, rng)
    x_rest = torch.as_tensor(rng.normal(size=(10, d)))
    blends = net.blends(B)
    jacobian = net.pose(x_rest, blends).jacobian
    for i in range(10):
        expected = torch.autograd.functional.jacobian(lambda x: net.pose(x[None], blends).x[0], x_rest[i])
        torch.testing.assert_close(jacobian[i], expected)


@pytest.mark.parametrize("d", [2, 3])
def test_a_search_works_on_it_as_on_a_grid(d: int, rng: np.random.Generator) -> None:
    net, B, x_rest = network(d), pose(d, rng), torch.as_tensor(0.5 * rng.normal(size=(50, d)))
    blends = net.blends(B)
    with torch.no_grad():
        x = net.pose(x_rest, blends).x
    found = newton(x, x_rest + 0.02, net, blends, iterations=20)
    assert found.residual.max() < 1e-9
