import numpy as np
import pytest
import torch

from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.network import EncodedNetwork, NetworkField
from nilbs.geometry.kinematics import forward_kinematics

BE, P = np.array([[0, 1], [1, 2], [1, 3]]), np.array([-1, 0, 0])


def field(d: int, **options: int) -> NetworkField:
    torch.manual_seed(3)
    sizes = {"width": 8, "depth": 3} | options
    return NetworkField(EncodedNetwork(ParameterEncoding(torch.as_tensor(P), d), 1, **sizes)).double()


def poses(d: int, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and the transforms they make."""
    theta = rng.normal(scale=0.5, size=(n, 3, 3 if d == 3 else 1))
    C = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0.2, 0.1], [0.7, -0.4, 0.3]])[:, :d]
    return theta, forward_kinematics(C, BE, P, theta)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("depth", [2, 4])
def test_folding_equals_the_network_written_out(d: int, depth: int, rng: np.random.Generator) -> None:
    net, x = field(d, depth=depth), rng.normal(size=(2, 5, d))
    theta, B = poses(d, 2, rng)
    logit = net.logit(torch.as_tensor(x), torch.as_tensor(B)).detach().numpy()
    assert logit.shape == (2, 5)
    assert len(net.network.layers) == depth
    for p in range(2):
        for i in range(5):
            hidden = np.concatenate([x[p, i], theta[p].ravel()])
            for k, layer in enumerate(net.network.layers):
                hidden = layer.weight.detach().numpy() @ hidden + layer.bias.detach().numpy()
                if k < depth - 1:
                    hidden = np.maximum(hidden, 0)
            np.testing.assert_allclose(logit[p, i], hidden[0], atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_in_a_pose_it_answers_with_the_logit_alone(d: int, rng: np.random.Generator) -> None:
    net, x, B = field(d), torch.as_tensor(rng.normal(size=(5, d))), torch.as_tensor(poses(d, 1, rng)[1])
    answer = net.posed(B[0])(x)
    torch.testing.assert_close(-answer.level, net.logit(x[None], B)[0])
    assert answer.distance.isnan().all()
    assert answer.x_rest.isnan().all()
    assert net.posed(B[0])(x[:0]).level.shape == (0,)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_by_points_and_parameters(d: int, rng: np.random.Generator) -> None:
    net, B = field(d), torch.as_tensor(poses(d, 2, rng)[1])
    x = torch.as_tensor(rng.normal(size=(2, 3, d))).requires_grad_()
    # The parameters are changed in place, so they need not be passed to the field.
    assert torch.autograd.gradcheck(lambda x, *parameters: net.logit(x, B), (x, *net.parameters()))


def test_single_precision_and_too_few_layers(rng: np.random.Generator) -> None:
    B, x = torch.as_tensor(poses(3, 2, rng)[1]), torch.as_tensor(rng.normal(size=(2, 4, 3)))
    logit = field(3).float().logit(x.float(), B.float())
    assert logit.dtype == torch.float32
    torch.testing.assert_close(logit.double(), field(3).logit(x, B), rtol=0, atol=1e-5)
    with pytest.raises(ValueError, match=r"^a network needs at least 2 layers, got 1$"):
        field(2, depth=1)
