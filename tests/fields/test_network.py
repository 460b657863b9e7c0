import numpy as np
import pytest
import torch

from nilbs.fields.encoding import DistanceEncoding, LocalEncoding, ParameterEncoding
from nilbs.fields.network import WeightNetwork
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices

BONES = 3


def network(d: int, *, parameters: bool = False, **options) -> WeightNetwork:
    torch.manual_seed(3)
    centers = torch.linspace(-1, 1, BONES * d, dtype=torch.float64).reshape(BONES, d)
    encoding = ParameterEncoding(torch.tensor([-1, 0, 1]), d) if parameters else LocalEncoding(centers)
    return WeightNetwork(encoding, BONES, **options).double()


def poses(d: int, n: int, rng: np.random.Generator) -> np.ndarray:
    theta = rng.normal(size=(n, BONES, 3 if d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), rng.normal(size=(n, BONES, d)))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("depth", [2, 5])
def test_folding_equals_the_encoding_written_out(d: int, depth: int, rng: np.random.Generator) -> None:
    net, B, x = network(d, width=8, depth=depth), poses(d, 2, rng), rng.normal(size=(2, 4, d))
    logits = net(torch.as_tensor(x), torch.as_tensor(B)).detach().numpy()
    assert logits.shape == (2, 4, BONES + 1)
    assert len(net.layers) == depth
    centers = net.encoding.centers.numpy()
    for p in range(2):
        for i in range(4):
            local = [(np.linalg.inv(B[p, b]) @ [*x[p, i], 1])[:d] - centers[b] for b in range(BONES)]
            hidden = np.concatenate(local)
            for k, layer in enumerate(net.layers):
                hidden = layer.weight.detach().numpy() @ hidden + layer.bias.detach().numpy()
                if k < depth - 1:
                    hidden = np.maximum(hidden, 0)
            np.testing.assert_allclose(logits[p, i], hidden, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_distances_follow_the_coordinates(d: int, rng: np.random.Generator) -> None:
    centers, ends = torch.as_tensor(rng.normal(size=(2, BONES, d)))
    net = WeightNetwork(DistanceEncoding(centers, ends), BONES, width=8, depth=2).double()
    x, B = torch.as_tensor(rng.normal(size=(2, 4, d))), torch.as_tensor(poses(d, 2, rng))
    linear, offset = net.encoding(B)
    given = torch.cat([x @ linear.mT + offset[:, None], net.encoding.features(x, B)], dim=-1)
    expected = net.layers[1](torch.relu(net.layers[0](given)))
    torch.testing.assert_close(net(x, B), expected)


@pytest.mark.parametrize("d", [2, 3])
def test_the_world_moves_and_the_weights_stay(d: int, rng: np.random.Generator) -> None:
    net, B, x = network(d), poses(d, 1, rng), rng.normal(size=(1, 9, d))
    world = poses(d, 1, rng)[0, 0]
    moved = x @ world[:d, :d].T + world[:d, d]
    logits = net(torch.as_tensor(x), torch.as_tensor(B))
    torch.testing.assert_close(net(torch.as_tensor(moved), torch.as_tensor(world @ B)), logits, rtol=0, atol=1e-12)
    # And they are weights of the place: another place has others.
    assert (net(torch.as_tensor(moved), torch.as_tensor(B)) - logits).abs().max() > 1e-3


@pytest.mark.parametrize("d", [2, 3])
def test_pose_parameters_stand_after_the_point(d: int, rng: np.random.Generator) -> None:
    net, x = network(d, parameters=True, width=8, depth=3), rng.normal(size=(2, 4, d))
    theta = 0.7 * rng.normal(size=(2, BONES, 3 if d == 3 else 1))
    C, BE, P = rng.normal(size=(BONES + 1, d)), np.array([[0, 1], [1, 2], [2, 3]]), np.array([-1, 0, 1])
    B = forward_kinematics(C, BE, P, theta)
    logits = net(torch.as_tensor(x), torch.as_tensor(B)).detach()
    for p in range(2):
        for i in range(4):
            hidden = torch.as_tensor(np.concatenate([x[p, i], theta[p].ravel()]))
            for k, layer in enumerate(net.layers):
                hidden = layer(torch.relu(hidden) if k else hidden)
            torch.testing.assert_close(logits[p, i], hidden.detach(), rtol=0, atol=1e-10)


@pytest.mark.parametrize("parameters", [False, True])
def test_without_a_ghost_bone_its_weight_is_zero(parameters: bool, rng: np.random.Generator) -> None:
    net, B = network(3, parameters=parameters, ghost=False), torch.as_tensor(poses(3, 1, rng))
    assert net.layers[-1].out_features == BONES
    W = torch.softmax(net(torch.as_tensor(rng.normal(size=(1, 9, 3))), B), dim=-1)
    assert W.shape == (1, 9, BONES + 1)
    assert (W[..., -1] == 0).all()
    torch.testing.assert_close(W[..., :-1].sum(dim=-1), torch.ones((1, 9), dtype=torch.float64))


def test_no_points(rng: np.random.Generator) -> None:
    B = torch.as_tensor(poses(2, 1, rng))
    assert network(2)(torch.zeros((1, 0, 2), dtype=torch.float64), B).shape == (1, 0, BONES + 1)


def test_a_single_layer_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^a network needs at least 2 layers, got 1$"):
        network(2, depth=1)
