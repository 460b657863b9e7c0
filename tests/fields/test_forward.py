import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from nilbs.fields.forward import Forward, ForwardField, packed_weights
from nilbs.fields.newton import implicit, newton
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import linear_blend_skinning

BONES = 5
SHAPES = {2: (9, 7), 3: (8, 6, 7)}


def poses(d: int, rng: np.random.Generator, *, angle: float = 0.5) -> np.ndarray:
    theta = angle * rng.uniform(-1, 1, (BONES, 3 if d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), 0.1 * rng.normal(size=(BONES, d)))


def forward_field(d: int, rng: np.random.Generator, *, smooth: float = 1.0) -> tuple[ForwardField, Grid, np.ndarray]:
    """A field with weights at every node, and those."""
    grid = Grid(np.full(d, -1.0), 0.25, SHAPES[d])
    logits = grid.points() @ rng.normal(size=(d, BONES)) * smooth
    W = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    return packed(np.arange(grid.size), W, grid), grid, W


def packed(node: np.ndarray, W_node: np.ndarray, grid: Grid) -> ForwardField:
    arrays = {name: torch.as_tensor(array) for name, array in packed_weights(node, W_node, grid.shape).items()}
    return ForwardField(**arrays, origin=torch.as_tensor(grid.origin), spacing=grid.spacing)


def within(grid: Grid, n: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(grid.lower + 0.2, grid.upper - 0.2, (n, len(grid.shape)))


@pytest.mark.parametrize("d", [2, 3])
def test_points_are_posed_by_the_weights_between_the_nodes(d: int, rng: np.random.Generator) -> None:
    field, grid, W = forward_field(d, rng)
    axes = [origin + grid.spacing * np.arange(n) for origin, n in zip(grid.origin, grid.shape, strict=True)]
    x_rest, B = within(grid, 200, rng), poses(d, rng)
    W_x = RegularGridInterpolator(axes, W.reshape(*grid.shape, BONES))(x_rest)
    found = field.pose(torch.as_tensor(x_rest), field.blends(torch.as_tensor(B)))
    np.testing.assert_allclose(found.x, linear_blend_skinning(x_rest, W_x, B), atol=1e-3)
    # Only weights below 1e-4 are left out.
    kept = np.where(W > 1e-4, W, 0)
    kept /= kept.sum(axis=1, keepdims=True)
    W_x = RegularGridInterpolator(axes, kept.reshape(*grid.shape, BONES))(x_rest)
    np.testing.assert_allclose(found.x, linear_blend_skinning(x_rest, W_x, B), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_the_derivative_is_that_of_the_posed_points(d: int, rng: np.random.Generator) -> None:
    field, grid, _ = forward_field(d, rng)
    blends = field.blends(torch.as_tensor(poses(d, rng)))
    x_rest = torch.as_tensor(within(grid, 30, rng))
    jacobian = field.pose(x_rest, blends).jacobian
    for axis in range(d):
        step = torch.zeros(d, dtype=torch.float64)
        step[axis] = 1e-7
        difference = (field.pose(x_rest + step, blends).x - field.pose(x_rest - step, blends).x) / 2e-7
        torch.testing.assert_close(jacobian[..., axis], difference, atol=1e-6, rtol=0)


@pytest.mark.parametrize("d", [2, 3])
def test_one_rigid_motion_on_every_bone_moves_the_whole_grid(d: int, rng: np.random.Generator) -> None:
    field, grid, _ = forward_field(d, rng)
    B = np.repeat(poses(d, rng)[:1], BONES, axis=0)
    x_rest = rng.uniform(grid.lower - 1, grid.upper + 1, (100, d))
    posed, jacobian = field.pose(torch.as_tensor(x_rest), field.blends(torch.as_tensor(B)))
    np.testing.assert_allclose(posed, transform_points(B[0], x_rest), atol=1e-12)
    np.testing.assert_allclose(jacobian, np.broadcast_to(B[0, :d, :d], (100, d, d)), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_a_node_without_weights_has_those_of_the_nearest(d: int, rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(d), 1.0, SHAPES[d])
    node = np.sort(rng.choice(grid.size, 6, replace=False))
    W_node = rng.dirichlet(np.ones(BONES), 6)
    row = packed_weights(node, W_node, grid.shape)["row"].ravel()
    x = grid.points()
    away = np.linalg.norm(x[:, None] - x[node], axis=2)
    np.testing.assert_allclose(away[np.arange(grid.size), row], away.min(axis=1))


@pytest.mark.parametrize("d", [2, 3])
def test_roots_are_found_and_look_ups_counted(d: int, rng: np.random.Generator) -> None:
    field, grid, _ = forward_field(d, rng)
    blends = field.blends(torch.as_tensor(poses(d, rng)))
    x_rest = torch.as_tensor(within(grid, 300, rng))
    x = field.pose(x_rest, blends).x
    start = x_rest + 0.05 * torch.as_tensor(rng.normal(size=x_rest.shape))
    roots = newton(x, start, field, blends, iterations=12, accuracy=1e-12)
    assert (roots.residual < 1e-10).all()
    torch.testing.assert_close(field.pose(roots.x_rest, blends).x, x, atol=1e-10, rtol=0)
    assert 300 * 2 < roots.evaluations < 300 * 8
    # A search that starts at the root makes one look-up.
    assert newton(x, x_rest, field, blends, iterations=6).evaluations == 300
    nowhere = newton(x + 100, start, field, blends, iterations=3)
    assert (nowhere.residual > 90).all()
    assert torch.isfinite(nowhere.x_rest).all()


@pytest.mark.parametrize("d", [2, 3])
def test_roots_have_the_derivatives_of_the_inverse(d: int, rng: np.random.Generator) -> None:
    field, grid, _ = forward_field(d, rng)
    x_rest = torch.as_tensor(within(grid, 10, rng))
    B = torch.as_tensor(poses(d, rng), dtype=torch.float64)
    x = field.pose(x_rest, field.blends(B)).x

    def root(x: torch.Tensor, B: torch.Tensor) -> torch.Tensor:
        blends = field.blends(B)
        found = newton(x, x_rest, field, blends, iterations=20, accuracy=1e-13).x_rest
        return implicit(x, found, field, blends)

    assert torch.autograd.gradcheck(root, (x.requires_grad_(), B.requires_grad_()), atol=1e-6)


class Arctangent:
    """A forward map with one canonical point per posed point, on which plain Newton's method diverges."""

    def pose(self, x_rest: torch.Tensor, blends: torch.Tensor) -> Forward:
        return Forward(torch.atan(80 * x_rest) / 80, torch.diag_embed(1 / (1 + (80 * x_rest) ** 2)))


@pytest.mark.parametrize("d", [2, 3])
def test_a_step_that_increases_the_residual_is_shortened(d: int, rng: np.random.Generator) -> None:
    x_rest = torch.as_tensor(rng.uniform(-0.05, 0.05, (200, d)))
    x = Arctangent().pose(x_rest, x_rest).x
    start = x_rest + torch.as_tensor(rng.choice([-0.05, 0.05], (200, d)))
    found = newton(x, start, Arctangent(), x_rest, iterations=25)
    assert (found.residual < 1e-10).double().mean() > 0.95
    solved = found.residual < 1e-10
    np.testing.assert_allclose(found.x_rest[solved], x_rest[solved], atol=1e-8)
