import numpy as np
import pytest
import torch

from nilbs.fields.samples import RestSamples
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.nasa.field import LEAK, POSE_SIZE, NasaField, NasaWeightTerm

BONES = 3


def field(d: int, deformable: bool, **options: int) -> NasaField:
    torch.manual_seed(3)
    centers = torch.linspace(-1, 1, BONES * d, dtype=torch.float64).reshape(BONES, d)
    return NasaField(centers, deformable=deformable, **({"width": 6, "depth": 3} | options)).double()


def poses(d: int, n: int, rng: np.random.Generator) -> np.ndarray:
    theta = rng.normal(size=(n, BONES, 3 if d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), rng.normal(size=(n, BONES, d)))


def apply(transform: np.ndarray, x: np.ndarray) -> np.ndarray:
    return (transform @ [*x, 1])[:-1]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("deformable", [False, True])
@pytest.mark.parametrize("depth", [1, 4])
def test_stacked_parts_equal_one_network_after_the_other(d: int, deformable: bool, depth: int, rng) -> None:
    net, B, x = field(d, deformable, depth=depth, root=1), poses(d, 2, rng), rng.normal(size=(2, 4, d))
    parts = net.part_logits(torch.as_tensor(x), torch.as_tensor(B)).detach().numpy()
    assert parts.shape == (2, BONES, 4)
    c = net.encoding.centers.numpy()
    weight = {name: value.detach().numpy() for name, value in net.named_parameters()}
    for p in range(2):
        inverse = np.linalg.inv(B[p])
        root = apply(B[p, 1], c[1])
        seen = np.concatenate([apply(inverse[b], root) - c[b] for b in range(BONES)])
        for b in range(BONES):
            for i in range(4):
                values = apply(inverse[b], x[p, i]) - c[b]
                if deformable:
                    values = np.concatenate([values, weight["projection"][b] @ seen])
                assert len(values) == d + POSE_SIZE * deformable
                hidden = weight["first_weight"][b] @ values + weight["first_bias"][b][:, 0]
                hidden = np.where(hidden > 0, hidden, LEAK * hidden)
                for k in range(depth - 1):
                    hidden = hidden + hidden @ weight[f"weights.{k}"][b] + weight[f"biases.{k}"][b, 0]
                    hidden = np.where(hidden > 0, hidden, LEAK * hidden)
                logit = weight["last_weight"][b] @ hidden + weight["last_bias"][b, 0]
                np.testing.assert_allclose(parts[p, b, i], logit[0], atol=1e-12)
    logit = net.logit(torch.as_tensor(x), torch.as_tensor(B)).detach().numpy()
    np.testing.assert_array_equal(logit, parts.max(axis=1))


@pytest.mark.parametrize("n", [0, 1, 129, 300])
def test_chunks_of_points_have_the_answers_of_all_at_once(n: int, rng: np.random.Generator) -> None:
    net, B, x = field(3, True, width=2048), torch.as_tensor(poses(3, 1, rng)), torch.as_tensor(rng.normal(size=(n, 3)))
    assert net.piece == 128
    with torch.no_grad():
        answer = net.posed(B[0])(x)
        np.testing.assert_allclose(-answer.level, net.logit(x[None], B)[0], rtol=1e-12)
    assert answer.distance.shape == (n,)
    assert answer.x_rest.shape == (n, 3)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("deformable", [False, True])
def test_the_world_moves_and_the_answers_stay(d: int, deformable: bool, rng: np.random.Generator) -> None:
    net, B, x = field(d, deformable), poses(d, 1, rng), rng.normal(size=(1, 9, d))
    world = poses(d, 1, rng)[0, 0]
    moved = x @ world[:d, :d].T + world[:d, d]
    logit = net.logit(torch.as_tensor(x), torch.as_tensor(B))
    torch.testing.assert_close(net.logit(torch.as_tensor(moved), torch.as_tensor(world @ B)), logit, rtol=0, atol=1e-11)
    assert (net.logit(torch.as_tensor(moved), torch.as_tensor(B)) - logit).abs().max() > 1e-3


@pytest.mark.parametrize("d", [2, 3])
def test_only_a_deformable_part_depends_on_the_other_bones(d: int, rng: np.random.Generator) -> None:
    B, x = poses(d, 2, rng), torch.as_tensor(rng.normal(size=(2, 9, d)))
    B[1] = B[0]
    B[1, 2] = poses(d, 1, rng)[0, 0]  # another place for the last bone alone
    x[1] = x[0]
    for deformable in (False, True):
        first, second = field(d, deformable).part_logits(x, torch.as_tensor(B)).detach()
        felt = (first - second).abs().amax(dim=1)
        assert felt[2] > 1e-3
        assert (felt[:2] > 1e-6).all() == deformable
        assert (felt[:2] == 0).all() != deformable


@pytest.mark.parametrize("deformable", [False, True])
def test_in_the_unit_frame_the_root_joint_stays(deformable: bool, rng: np.random.Generator) -> None:
    # Parts of bones that do not move do not depend on the others.
    net, B = field(3, deformable), torch.as_tensor(poses(3, 1, rng))
    B[:, 0] = torch.eye(4)
    linear, offset = net.encoding(B)
    seen = net._root_joint(B, linear, offset).reshape(1, BONES, 3)
    torch.testing.assert_close(seen[0, 0], torch.zeros(3, dtype=torch.float64))
    centers = net.encoding.centers
    expected = (torch.linalg.inv(B[0, 1]) @ torch.cat([centers[0], torch.ones(1)]))[:3] - centers[1]
    torch.testing.assert_close(seen[0, 1], expected)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("deformable", [False, True])
def test_derivatives_by_points_and_parameters(d: int, deformable: bool, rng: np.random.Generator) -> None:
    net, B = field(d, deformable, width=3, depth=2), torch.as_tensor(poses(d, 2, rng))
    x = torch.as_tensor(rng.normal(size=(2, 2, d))).requires_grad_()
    parameters = list(net.parameters())
    # The parameters are changed in place, so they need not be passed to the field.
    assert torch.autograd.gradcheck(lambda x, *_: net.logit(x, B), (x, *parameters))
    assert all(parameter.ndim == 3 for parameter in parameters)


@pytest.mark.parametrize("d", [2, 3])
def test_the_weight_loss_written_out(d: int, rng: np.random.Generator) -> None:
    # One pose and one vertex: every draw is the same.
    net, B = field(d, True), poses(d, 1, rng)
    V, W = rng.normal(size=(1, d)), np.array([[0.2, 0.7, 0.1]])
    options = {"poses_per_step": 2, "points_per_pose": 3}
    term = NasaWeightTerm(net, RestSamples(V, W), torch.as_tensor(B), **options, factor=0.4)
    x = linear_blend_skinning(V, W, B[0])
    occupancy = torch.sigmoid(net.part_logits(torch.as_tensor(x)[None], torch.as_tensor(B)))[0, :, 0].detach().numpy()
    expected = 0.4 * ((occupancy - [0, 0.5, 0]) ** 2).mean()
    assert term(rng).item() == pytest.approx(expected, rel=1e-12)
    # Several: a mean over what is drawn, the same for the same generator.
    V, W, B = rng.normal(size=(5, d)), rng.dirichlet(np.ones(BONES), 5), poses(d, 4, rng)
    term = NasaWeightTerm(
        net, RestSamples(V, W), torch.as_tensor(B), poses_per_step=3000, points_per_pose=2, factor=1.0
    )
    expected = 0.0
    for pose in B:
        x = linear_blend_skinning(V, W, pose)
        parts = net.part_logits(torch.as_tensor(x)[None], torch.as_tensor(pose)[None])[0].detach()
        expected_parts = 0.5 * np.eye(BONES)[W.argmax(axis=1)].T
        expected += ((torch.sigmoid(parts).numpy() - expected_parts) ** 2).mean() / len(B)
    assert term(np.random.default_rng(1)).item() == pytest.approx(expected, rel=0.03)
    assert term(np.random.default_rng(1)).item() == term(np.random.default_rng(1)).item()


@pytest.mark.parametrize("d", [2, 3])
def test_the_weight_loss_is_learned(d: int, rng: np.random.Generator) -> None:
    net, B = field(d, False, width=16), poses(d, 2, rng)
    V = rng.normal(size=(BONES, d))
    term = NasaWeightTerm(
        net, RestSamples(V, np.eye(BONES)), torch.as_tensor(B), poses_per_step=4, points_per_pose=8, factor=1.0
    )
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-2)
    for _ in range(400):
        optimizer.zero_grad()
        term(rng).backward()
        optimizer.step()
    for pose in B:
        x = torch.as_tensor(linear_blend_skinning(V, np.eye(BONES), pose))[None]
        occupancy = torch.sigmoid(net.part_logits(x, torch.as_tensor(pose)[None]))[0].detach()
        torch.testing.assert_close(occupancy, 0.5 * torch.eye(BONES).double(), rtol=0, atol=0.1)


def test_types_no_points_and_too_few_layers(rng: np.random.Generator) -> None:
    B, x = torch.as_tensor(poses(3, 2, rng)), torch.as_tensor(rng.normal(size=(2, 4, 3)))
    for deformable in (False, True):
        single = field(3, deformable).float()
        logit = single.logit(x.float(), B.float())
        assert logit.dtype == torch.float32
        torch.testing.assert_close(logit.double(), field(3, deformable).logit(x, B), rtol=0, atol=1e-4)
        answer = single.posed(B[0].float())(torch.zeros((0, 3)))
        assert answer.level.shape == (0,)
        assert answer.distance.shape == (0,)
        assert answer.x_rest.shape == (0, 3)
    with pytest.raises(ValueError, match=r"^a part needs at least 1 hidden layer, got 0$"):
        field(2, False, depth=0)
