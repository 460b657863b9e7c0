"""SNARF where all roots are known: in rigidly moved bodies, and in a hinge that folds the line onto its half."""

import numpy as np
import pytest
import torch

from nilbs.geometry.kinematics import forward_kinematics, random_rotations
from nilbs.methods.snarf import field as snarf
from nilbs.methods.snarf.field import OUTSIDE, SnarfBoneTerm, SnarfField

BE = np.array([[0, 1], [1, 2], [1, 3]])
P = np.array([-1, 0, 0])


def joints(d: int) -> np.ndarray:
    return np.array([[-0.4, 0, 0], [0, 0.05, 0.1], [0.4, 0.1, 0], [0.1, -0.4, 0.1]])[:, :d]


def untrained(d: int, *, width: int = 12, iterations: int = 50) -> SnarfField:
    torch.manual_seed(3)
    field = SnarfField(
        torch.as_tensor(P), torch.as_tensor(joints(d)[BE[:, 0]]), width=width, depth=4, weight_width=8,
        weight_depth=3, iterations=iterations,
    )  # fmt: skip
    field = field.double()
    torch.nn.init.normal_(field.occupancy.entry.weight, std=0.1)  # a new field does not depend on the pose
    torch.nn.init.zeros_(field.weight.layers[-1].bias)  # no bone takes all
    return field


def poses(d: int, n: int, rng: np.random.Generator, std: float = 0.6) -> torch.Tensor:
    theta = random_rotations(P, d, n, std=std, rng=rng)
    return torch.as_tensor(forward_kinematics(joints(d), BE, P, theta))


def points(shape: tuple[int, ...], rng: np.random.Generator) -> torch.Tensor:
    return torch.as_tensor(rng.uniform(-0.5, 0.5, shape))


def homogeneous(x: torch.Tensor) -> torch.Tensor:
    return torch.cat([x, torch.ones_like(x[..., :1])], dim=-1)


def set_linear(network: torch.nn.Module, slope: torch.Tensor) -> None:
    """Make a network of two layers the linear map slope (outputs, d): ramp(h) - ramp(-h) is h to the last digit."""
    first, last = network.layers
    d = slope.shape[1]
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
        first.weight[:d], first.weight[d : 2 * d] = torch.eye(d), -torch.eye(d)
        last.weight[:, :d], last.weight[:, d : 2 * d] = slope, -slope


def hinge(d: int) -> tuple[SnarfField, torch.Tensor]:
    """A bone on either side of the origin and the second turned by pi; the half space of positive y is inside."""
    field = SnarfField(
        torch.tensor([-1, 0]), torch.zeros((2, d)), width=2 * d, depth=2, weight_width=2 * d, weight_depth=2,
        iterations=50,
    ).double()  # fmt: skip
    axes = torch.eye(d, dtype=torch.float64)
    set_linear(field.weight, torch.stack([-5 * axes[0], 5 * axes[0]]))
    set_linear(field.occupancy, 10 * axes[1:2])
    B = torch.eye(d + 1, dtype=torch.float64).repeat(2, 1, 1)
    B[1, 0, 0] = B[1, 1, 1] = -1
    return field, B


@pytest.mark.parametrize("d", [2, 3])
def test_forward_skinning_is_the_blend_and_has_the_derivative_of_autograd(d: int, rng: np.random.Generator) -> None:
    field, B = untrained(d), poses(d, 2, rng)
    with torch.no_grad():
        field.weight.layers[-1].weight *= 0.3
    x_rest = points((9, d), rng).requires_grad_()
    pose = torch.as_tensor(rng.integers(0, 2, 9))
    x, jacobian = field.derivative(x_rest, B, pose)
    W = field.weights(x_rest)
    np.testing.assert_allclose(W.sum(dim=-1).detach(), 1)
    assert W.std(dim=0).min() > 1e-3
    expected = torch.einsum("mb,mbij,mj->mi", W, B[pose], homogeneous(x_rest))[:, :d]
    torch.testing.assert_close(x, expected)
    torch.testing.assert_close(field.skinned(x_rest, B, pose), expected)
    torch.testing.assert_close(field.skinned(x_rest, B[1:], 0 * pose)[pose == 1], expected[pose == 1])
    truth = torch.stack([torch.autograd.grad(x[:, i].sum(), x_rest, retain_graph=True)[0] for i in range(d)], dim=1)
    torch.testing.assert_close(jacobian, truth)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("bone", [0, 2])
def test_a_body_that_follows_one_bone_is_moved_rigidly(d: int, bone: int, rng: np.random.Generator) -> None:
    field, B = untrained(d), poses(d, 1, rng)
    with torch.no_grad():
        last = field.weight.layers[-1]
        last.weight.zero_()
        last.bias.copy_(100 * torch.eye(3)[bone])
    x = points((200, d), rng)
    x_rest = (homogeneous(x) @ torch.linalg.inv(B[0, bone]).T)[:, :d]
    in_pose = field.posed(B[0])
    with torch.no_grad():
        answer = in_pose(x)
        truth = field.rest_logit(x_rest, B, torch.zeros(200, dtype=torch.int64))
        trained = field.logit(x[None], B)[0]
    torch.testing.assert_close(answer.x_rest, x_rest)
    torch.testing.assert_close(-answer.level, truth)
    torch.testing.assert_close(trained, truth)
    assert answer.distance.isnan().all()
    # The bone's own start is the root; from the others the map is affine, so that one step is enough.
    assert in_pose.queries == 200
    assert in_pose.evaluations == 200 * (2 * 3 - 1)


@pytest.mark.parametrize("d", [2, 3])
def test_at_rest_every_point_is_its_own_root(d: int, rng: np.random.Generator) -> None:
    field = untrained(d)
    rest = torch.eye(d + 1, dtype=torch.float64).repeat(1, 3, 1, 1)
    x = points((50, d), rng)
    with torch.no_grad():
        in_pose = field.posed(rest[0])
        answer = in_pose(x)
        truth = field.rest_logit(x, rest, torch.zeros(50, dtype=torch.int64))
        found = field.candidates(x, rest, torch.zeros(50, dtype=torch.int64))
    torch.testing.assert_close(answer.x_rest, x)
    torch.testing.assert_close(-answer.level, truth)
    assert in_pose.evaluations == found.evaluations == 3 * 50
    assert found.exists.sum(dim=0).tolist() == [50, 0, 0]  # the others find the same root


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_is_inside_if_one_root_is_and_outside_without_a_root(d: int) -> None:
    field, B = hinge(d)
    x = torch.tensor([[-0.3, 0.1, 0.2], [-0.3, -0.1, 0.2], [0.3, 0.1, 0.2]], dtype=torch.float64)[:, :d]
    with torch.no_grad():
        found = field.candidates(x, B[None], torch.zeros(3, dtype=torch.int64))
        answer, trained = field.posed(B)(x), field.logit(x[None], B[None])[0]
    mirrored = x * torch.tensor([-1.0, -1.0, 1.0])[:d]
    assert found.exists.tolist() == [[True, True], [True, True], [False, False]]
    torch.testing.assert_close(found.x_rest[:2, 0], x[:2], atol=1e-5, rtol=0)
    torch.testing.assert_close(found.x_rest[:2, 1], mirrored[:2], atol=1e-5, rtol=0)
    torch.testing.assert_close(-answer.level, torch.tensor([1.0, 1.0, OUTSIDE]).double(), atol=1e-3, rtol=0)
    torch.testing.assert_close(answer.x_rest[:2], torch.stack([x[0], mirrored[1]]), atol=1e-5, rtol=0)
    assert answer.x_rest[2].isnan().all()
    # In training: the mean of both occupancies, by a softmax of them.
    occupancy = 1 / (1 + np.exp([-1.0, 1.0]))
    share = np.exp(snarf.BLEND * occupancy) / np.exp(snarf.BLEND * occupancy).sum()
    mean = share @ occupancy
    np.testing.assert_allclose(trained[:2], np.log(mean / (1 - mean)), atol=1e-3)
    assert trained[2] == OUTSIDE


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_follow_the_implicit_function_theorem(
    d: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(snarf, "CONVERGED", 1e-13)
    field, B, x = untrained(d), poses(d, 2, rng, std=0.3), points((2, 4, d), rng)
    with torch.no_grad():
        for layer in field.weight.layers:  # smooth weights, so that finite differences see no corner
            layer.weight *= 0.4
        assert field.candidates(x[0], B[:1], torch.zeros(4, dtype=torch.int64)).exists.any(dim=-1).all()
    weight, bias = field.weight.layers[1].weight, field.weight.layers[2].bias
    for parameter in field.parameters():
        parameter.requires_grad_(parameter is weight or parameter is bias)

    def value(x: torch.Tensor, B: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
        return field.logit(x, B)

    def root(x: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
        return field.posed(B[0].detach())(x[0]).x_rest

    assert torch.autograd.gradcheck(value, (x.requires_grad_(), B.requires_grad_(), weight, bias), atol=1e-4)
    assert torch.autograd.gradcheck(root, (x, weight, bias), atol=1e-4)
    gradient = torch.autograd.grad(root(x)[0].sum(), weight)[0]
    assert gradient.abs().max() > 1e-4


@pytest.mark.parametrize("d", [2, 3])
def test_chunks_change_nothing(d: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    field, B, x = untrained(d), poses(d, 3, rng), points((3, 25, d), rng)
    with torch.no_grad():
        whole, in_pose = field.logit(x, B), field.posed(B[0])
        in_pose(x[0])
        monkeypatch.setattr(snarf, "STARTS", 20)
        torch.testing.assert_close(field.logit(x, B), whole)
        parts = field.posed(B[0])
        answer = parts(x[0])
        assert (parts.queries, parts.evaluations) == (in_pose.queries, in_pose.evaluations)
        # One pose after the other is the same as all together, and the maximum no less than the mean.
        torch.testing.assert_close(torch.stack([field.logit(x[i : i + 1], B[i : i + 1])[0] for i in range(3)]), whole)
        assert (-answer.level >= whole[0] - 1e-9).all()
        assert field.posed(B[0])(x[0, :0]).level.shape == (0,)
    single = field.float()
    with torch.no_grad():
        logit = single.logit(x.float(), B.float())
    assert logit.dtype == torch.float32
    np.testing.assert_allclose(logit, whole, atol=2e-3)


@pytest.mark.parametrize("d", [2, 3])
def test_start_terms_are_those_of_loops(d: int, rng: np.random.Generator) -> None:
    field, C = untrained(d), joints(d)
    B = poses(d, 4, rng)
    term = SnarfBoneTerm(field, C, BE, P, poses=B, factor=0.7, points=6)
    with torch.no_grad():
        value = term(np.random.default_rng(5)).item()
        again = np.random.default_rng(5)
        along, outside = again.uniform(size=(6, 3)), []
        which = again.integers(0, 4, 18).reshape(6, 3)
        for i, j in np.ndindex(6, 3):
            x_rest = torch.as_tensor((1 - along[i, j]) * C[BE[j, 0]] + along[i, j] * C[BE[j, 1]])[None]
            pose = B[which[i, j]][None]
            logit = field.rest_logit(x_rest, pose, torch.zeros(1, dtype=torch.int64))
            outside.append(-torch.log(torch.sigmoid(logit)).item())
        W = field.weights(torch.as_tensor(C[BE[:, 0]])).numpy()
    missed = ((W - [[1, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5]]) ** 2).mean()
    np.testing.assert_allclose(value, 0.7 * np.mean(outside) + 7 * missed)
    at_rest = SnarfBoneTerm(field, C, BE, P)
    assert at_rest.poses.shape == (1, 3, d + 1, d + 1)
    assert torch.isfinite(at_rest(rng))


@pytest.mark.parametrize("d", [2, 3])
def test_occupancy_alone_teaches_where_a_rod_bends(d: int, rng: np.random.Generator) -> None:
    # Two bones of a thick line that bends at the origin; training begins with other weights.
    torch.manual_seed(0)
    C = np.zeros((3, d))
    C[0, 0], C[2, 0] = -0.5, 0.5
    BE, P = np.array([[0, 1], [1, 2]]), np.array([-1, 0])
    field = SnarfField(torch.as_tensor(P), torch.as_tensor(C[:2]).float(), width=24, depth=3, weight_width=16,
                       weight_depth=3)  # fmt: skip
    theta = random_rotations(P, d, 12, std=0.8, rng=rng)
    B = torch.as_tensor(forward_kinematics(C, BE, P, theta)).float()
    x = torch.as_tensor(rng.uniform(-0.6, 0.6, (12, 120, d))).float()
    # Inside: near to either half of the line, each where its bone takes it.
    local = torch.einsum("pbij,pnj->pnbi", torch.linalg.inv(B), homogeneous(x))[..., :d]
    low = torch.tensor([-0.5, 0.0])[:, None]
    along = torch.minimum(torch.maximum(local[..., :1], low), low + 0.5)
    inside = torch.cat([local[..., :1] - along, local[..., 1:]], dim=-1).norm(dim=-1).amin(dim=-1) < 0.15
    start = SnarfBoneTerm(field, C, BE, P)
    optimizer = torch.optim.Adam(field.parameters(), lr=1e-2)
    history = []
    for _ in range(60):
        optimizer.zero_grad()
        occupancy = torch.nn.functional.binary_cross_entropy_with_logits(field.logit(x, B), inside.float())
        (occupancy + start(rng)).backward()
        optimizer.step()
        history.append(occupancy.item())
    assert np.mean(history[-5:]) < 0.4 * history[0]
    W = field.weights(torch.tensor([[-0.35] + [0.0] * (d - 1), [0.35] + [0.0] * (d - 1)])).detach()
    assert W[0, 0] > 0.8
    assert W[1, 1] > 0.8


def test_networks_need_two_layers() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        SnarfField(torch.tensor([-1]), torch.zeros((1, 2)), depth=1)
