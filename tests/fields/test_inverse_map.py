import numpy as np
import pytest
import torch

from nilbs.fields.cache import RestCache
from nilbs.fields.encoding import LocalEncoding
from nilbs.fields.inverse_map import InverseField, ghost_logit, inverse_map, reverse_map
from nilbs.fields.network import WeightNetwork
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning

BONES, ROOT, WIDTH = 3, 1, 0.05


def poses(d: int, n: int, rng: np.random.Generator, *, angle: float = 1.0) -> np.ndarray:
    theta = angle * rng.uniform(-1, 1, (n, BONES, 3 if d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), rng.normal(size=(n, BONES, d)))


def weights(p: int, n: int, rng: np.random.Generator) -> np.ndarray:
    return rng.dirichlet(np.ones(BONES + 1), (p, n))


def mapped(x: np.ndarray, W: np.ndarray, B: np.ndarray) -> np.ndarray:
    return inverse_map(torch.as_tensor(x), torch.as_tensor(W), torch.as_tensor(B), root=ROOT).numpy()


def field(d: int) -> InverseField:
    torch.manual_seed(0)
    centers = torch.linspace(-1, 1, BONES * d).reshape(BONES, d)
    values = torch.linspace(-1, 1, 4**d).reshape((4,) * d)
    cache = RestCache.of_grid(values, torch.full((d,), -1.0), 0.7, width=WIDTH)
    return InverseField(
        WeightNetwork(LocalEncoding(centers), len(centers), width=16, depth=3), cache, root=ROOT
    ).double()


@pytest.mark.parametrize("d", [2, 3])
def test_the_ghost_goes_with_the_root_and_the_blend_is_inverted(d: int, rng: np.random.Generator) -> None:
    x, W, B = rng.normal(size=(2, 50, d)), weights(2, 50, rng), poses(d, 2, rng)
    x_rest = mapped(x, W, B)
    for p in range(2):
        bones = W[p, :, :BONES].copy()
        bones[:, ROOT] += W[p, :, BONES]
        np.testing.assert_allclose(x_rest[p], inverse_linear_blend_skinning(x[p], bones, B[p]), atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, np.pi - 1e-7])
def test_one_rigid_motion_of_every_bone_is_inverted(d: int, angle: float, rng: np.random.Generator) -> None:
    V, W = rng.normal(size=(1, 300, d)), weights(1, 300, rng)
    B = np.repeat(poses(d, 1, rng, angle=angle)[:, :1], BONES, axis=1)
    np.testing.assert_allclose(mapped(transform_points(B[0, 0], V), W, B), V, atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_a_singular_blend_sends_the_point_far_away_with_a_finite_gradient(d: int) -> None:
    turn = np.diag([-1.0, -1.0, 1.0][:d])
    B = torch.as_tensor(rigid_transforms(np.stack([np.eye(d), np.eye(d), turn]), np.zeros((3, d))))[None]
    W = torch.tensor([[[0.5, 0, 0.5, 0], [1, 0, 0, 0]]], dtype=torch.float64, requires_grad=True)
    x = torch.ones((1, 2, d), dtype=torch.float64, requires_grad=True)
    x_rest = inverse_map(x, W, B, root=0)
    x_rest.sum().backward()
    assert torch.isfinite(x_rest).all()
    assert torch.isfinite(x.grad).all()
    assert torch.isfinite(W.grad).all()
    torch.testing.assert_close(x_rest[0, 1], torch.ones(d, dtype=torch.float64))


@pytest.mark.parametrize("d", [2, 3])
def test_a_mirrored_blend_keeps_its_side(d: int) -> None:
    # Determinants just below zero are held below zero.
    B = rigid_transforms(np.diag([-1e-6, 1.0, 1.0][:d])[None].repeat(3, axis=0), np.zeros((3, d)))[None]
    x_rest = mapped(np.ones((1, 1, d)), np.array([[[1, 0, 0, 0.0]]]), B)
    assert x_rest[0, 0, 0] == pytest.approx(-1e4)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_the_inverse_map(d: int, rng: np.random.Generator) -> None:
    inputs = [rng.normal(size=(2, 3, d)), weights(2, 3, rng), poses(d, 2, rng)]
    tensors = [torch.tensor(array, requires_grad=True) for array in inputs]
    assert torch.autograd.gradcheck(lambda x, W, B: inverse_map(x, W, B, root=ROOT), tensors)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_the_field_by_place_and_by_pose(d: int, rng: np.random.Generator) -> None:
    nilbs = field(d)
    x = torch.tensor(0.3 * rng.normal(size=(1, 4, d)), requires_grad=True)
    B = torch.tensor(poses(d, 1, rng, angle=0.3), requires_grad=True)
    assert torch.autograd.gradcheck(nilbs.logit, (x, B))
    assert torch.autograd.gradcheck(nilbs.canonical_points, (x, B))


@pytest.mark.parametrize("d", [2, 3])
def test_the_field_joins_weights_map_and_cache(d: int, rng: np.random.Generator) -> None:
    nilbs, x, B = field(d), torch.as_tensor(rng.normal(size=(2, 20, d))), torch.as_tensor(poses(d, 2, rng))
    W = torch.softmax(nilbs.network(x, B), dim=-1)
    torch.testing.assert_close(nilbs.weights(x, B), W)
    torch.testing.assert_close(W.sum(dim=-1), torch.ones_like(W[..., 0]))
    x_rest = inverse_map(x, W, B, root=ROOT)
    torch.testing.assert_close(nilbs.canonical_points(x, B), x_rest)
    for p in range(2):
        answer = nilbs.posed(B[p])(x[p])
        torch.testing.assert_close(answer.x_rest, x_rest[p])
        torch.testing.assert_close(answer.occupancy, torch.sigmoid(nilbs.logit(x, B))[p])
        without = nilbs.posed(B[p], ghost=False)(x[p])
        torch.testing.assert_close(without.distance, nilbs.cache.distance(x_rest[p]))
        torch.testing.assert_close(without.occupancy, nilbs.cache.occupancy(x_rest[p]))
        # The ghost bone only makes a point one outside.
        torch.testing.assert_close(answer.distance < 0, answer.level < 0)
        reverse = nilbs.posed(B[p], reverse=True)(x[p]).x_rest
        torch.testing.assert_close(reverse, reverse_map(x, W, B, root=ROOT)[p])


def test_the_logit_is_that_of_equation_eight(rng: np.random.Generator) -> None:
    logits = torch.as_tensor(2 * rng.normal(size=(1, 200, BONES + 1)))
    inside = torch.as_tensor(rng.uniform(-10, 10, (1, 200)))
    ghost = torch.softmax(logits, dim=-1)[..., -1]
    torch.testing.assert_close(torch.sigmoid(ghost_logit(inside, logits)), (1 - ghost) * torch.sigmoid(inside))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("ghost", [-80.0, 0.0, 80.0])
@pytest.mark.parametrize("distance", [-1e4, -1.0, 1.0, 1e4])
def test_the_logit_is_finite_and_has_a_gradient_where_occupancy_has_saturated(
    dtype: torch.dtype, ghost: float, distance: float
) -> None:
    logits = torch.tensor([[[0.0, 0.0, 0.0, ghost]]], dtype=dtype, requires_grad=True)
    far = torch.tensor([[distance]], dtype=dtype, requires_grad=True)
    logit = ghost_logit(-far / WIDTH, logits)
    logit.sum().backward()
    assert torch.isfinite(logit).all()
    assert torch.isfinite(logits.grad).all()
    assert torch.isfinite(far.grad).all()
    # A point is inside if it is inside the rest shape and does not belong to the ghost.
    assert (logit > 0).item() == (distance < 0 and ghost < 1)
    slope = logits.grad.abs().sum() + far.grad.abs().sum()
    assert slope > 1e-3


@pytest.mark.parametrize("d", [2, 3])
def test_the_reverse_map_blends_the_inverses(d: int, rng: np.random.Generator) -> None:
    x, W, B = rng.normal(size=(2, 50, d)), weights(2, 50, rng), poses(d, 2, rng)
    found = reverse_map(torch.as_tensor(x), torch.as_tensor(W), torch.as_tensor(B), root=ROOT).numpy()
    for p in range(2):
        unposed = [transform_points(np.linalg.inv(B[p, b]), x[p]) for b in [*range(BONES), ROOT]]
        expected = sum(W[p, :, b, None] * point for b, point in enumerate(unposed))
        np.testing.assert_allclose(found[p], expected, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_both_maps_agree_where_one_bone_has_all_weight_and_differ_where_two_share_it(d: int) -> None:
    theta = np.zeros((BONES, 3 if d == 3 else 1))
    theta[0, -1], theta[1, -1] = 0.8, -0.8
    B = rigid_transforms(rotation_matrices(theta), np.zeros((BONES, d)))[None]
    x = np.ones((1, 2, d))
    W = np.array([[[1, 0, 0, 0], [0.5, 0.5, 0, 0.0]]])
    inverse = mapped(x, W, B)[0]
    reverse = reverse_map(torch.as_tensor(x), torch.as_tensor(W), torch.as_tensor(B), root=ROOT).numpy()[0]
    np.testing.assert_allclose(reverse[0], inverse[0], atol=1e-12)
    # Turned by 0.8 either way: the blend shrinks by cos 0.8; its inverse undoes that, the blend of inverses repeats it.
    np.testing.assert_allclose(inverse[1, :2], 1 / np.cos(0.8))
    np.testing.assert_allclose(reverse[1, :2], np.cos(0.8))
