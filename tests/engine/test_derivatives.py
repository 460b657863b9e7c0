from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.compiled import set_threads
from nilbs.engine.derivatives import PIECE, SkinGradients, _slope, root_gradients
from nilbs.engine.unit_frame import UnitFrame
from nilbs.fields.newton import implicit, newton
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices
from nilbs.models.torch_field import field_of

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


@pytest.fixture
def case(models, rng) -> Callable:
    """Of a dimension: the engine, its field in double precision, a pose, rest points and gradients by answers there."""

    def of(d: int, n: int) -> tuple:
        model = models[d]
        field = field_of(model.character, model.method, model.parameters, model.rest).double()
        B = UnitFrame(model.character, model.motion[3]).B
        unit = (model.character.V - model.character.V.min(axis=0)) / model.character.L
        at = unit[rng.integers(len(unit), size=n)] - unit.max(axis=0) / 2
        x_rest = (at + 0.015 * rng.normal(size=(n, d))).astype(np.float32)
        return model.engine(), field, B, x_rest, rng.normal(size=n), rng.normal(size=(n, d))

    return of


def total(field, root: Tensor, of_distance: np.ndarray, of_x_rest: np.ndarray) -> Tensor:
    """For each point what has these gradients by its distance and its root."""
    return field.inverse.cache.distance(root) * torch.from_numpy(of_distance) + (
        root * torch.from_numpy(of_x_rest)
    ).sum(dim=-1)


def same(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@DIMENSIONS
@pytest.mark.parametrize("scale", [1, 0.02])  # of a small pose the determinant is below what is divided by
def test_gradients_of_roots_are_those_of_the_field(d: int, scale: float, case) -> None:
    engine, field, B, x_rest, *given = case(d, 400)
    B = B.copy()
    B[:, :d] *= scale
    pose, root = torch.from_numpy(B).requires_grad_(), torch.from_numpy(x_rest.astype(np.float64))
    blends = field.skinning.blends(pose)
    x = field.skinning.pose(root, blends).x.detach().requires_grad_()
    assert bool((field.inverse.cache.distance(root) < 0).any())
    total(field, implicit(x, root, field.skinning, blends), *given).sum().backward()
    by_x, by_B = root_gradients(engine, B, x_rest, *given)
    assert by_x.dtype == by_B.dtype == np.float64
    same(by_x, x.grad.numpy())
    same(by_B, pose.grad.numpy())


@DIMENSIONS
def test_gradients_of_roots_are_differences(d: int, case) -> None:
    engine, field, B, x_rest, *given = case(d, 60)
    start = torch.from_numpy(x_rest.astype(np.float64))
    x = field.skinning.pose(start, field.skinning.blends(torch.from_numpy(B))).x

    def moved(x: Tensor, B: np.ndarray) -> np.ndarray:
        roots = newton(x, start, field.skinning, field.skinning.blends(torch.from_numpy(B)), iterations=20)
        assert float(roots.residual.max()) < 1e-12
        return total(field, roots.x_rest, *given).numpy()

    h, by_x, by_B = 1e-6, np.zeros(x.shape), np.zeros(B.shape)
    for r in range(d):
        step = h * torch.eye(d, dtype=torch.float64)[r]
        by_x[:, r] = (moved(x + step, B) - moved(x - step, B)) / (2 * h)
    for index in np.ndindex(len(B), d, d + 1):
        ends = []
        for sign in (1, -1):
            pose = B.copy()
            pose[index] += sign * h
            ends.append(moved(x, pose).sum())
        by_B[index] = (ends[0] - ends[1]) / (2 * h)
    found = root_gradients(engine, B, x_rest, *given)
    same(found[0], by_x)
    same(found[1], by_B)


@DIMENSIONS
def test_slopes_of_the_rest_distance_inside_and_beyond_its_grid(d: int, case, rng) -> None:
    engine, field, *_ = case(d, 0)
    x = torch.from_numpy(rng.uniform(-0.8, 0.8, (300, d)).astype(np.float32)).double().requires_grad_()
    field.inverse.cache.distance(x).sum().backward()
    padded = np.zeros((300, 3), dtype=np.float32)
    padded[:, :d] = x.numpy(force=True)
    found = np.array([_slope(*point, engine.distances) for point in padded])
    np.testing.assert_allclose(found[:, :d], x.grad.numpy(), atol=1e-4)
    assert not found[:, d:].any()


@DIMENSIONS
def test_sums_depend_neither_on_threads_nor_on_points_without_a_root(d: int, case) -> None:
    n = 2 * PIECE + 7
    engine, _, B, x_rest, *given = case(d, n)
    x_rest[::5] = np.nan
    found = []
    for count in (1, 2, 3):
        set_threads(count)
        try:
            found.append(root_gradients(engine, B, x_rest, *given))
        finally:
            set_threads(None)
    by_x, by_B = found[0]
    for other in found[1:]:
        np.testing.assert_array_equal(other[0], by_x)
        np.testing.assert_array_equal(other[1], by_B)
    assert not by_x[::5].any()
    rooted = ~np.isnan(x_rest[:, 0])
    alone = root_gradients(engine, B, x_rest[rooted], given[0][rooted], given[1][rooted])
    np.testing.assert_array_equal(by_x[rooted], alone[0])
    np.testing.assert_allclose(by_B, alone[1], rtol=1e-12, atol=1e-9)


@DIMENSIONS
def test_no_points(d: int, case) -> None:
    engine, _, B, x_rest, *given = case(d, 0)
    by_x, by_B = root_gradients(engine, B, x_rest, *given)
    assert by_x.shape == (0, d)
    np.testing.assert_array_equal(by_B, np.zeros_like(B))


@DIMENSIONS
def test_gradients_of_the_distance_to_the_skin(d: int, rng) -> None:
    b, n = 4, PIECE + 30
    V, F = rng.normal(size=(30, d)), rng.integers(30, size=(20, d))
    W = rng.dirichlet(np.ones(b), 30) * (rng.uniform(size=(30, b)) < 0.6)
    B = rigid_transforms(rotation_matrices(rng.normal(size=(b, 3 if d == 3 else 1))), rng.normal(size=(b, d)))
    facet, share, given = rng.integers(20, size=n), rng.dirichlet(np.ones(d), n), rng.normal(size=n)
    pose, x = torch.from_numpy(B).requires_grad_(), torch.from_numpy(rng.normal(size=(n, d))).requires_grad_()
    V1 = torch.from_numpy(np.concatenate([V, np.ones((30, 1))], axis=1))
    U = torch.einsum("nb,bij,nj->ni", torch.from_numpy(W), pose, V1)[:, :d]
    place = torch.einsum("nc,ncd->nd", torch.from_numpy(share), U[torch.from_numpy(F[facet])])
    distance = (x - place).norm(dim=-1)
    (distance * torch.from_numpy(given)).sum().backward()
    places = ClosestPoints(distance.numpy(force=True), facet, place.numpy(force=True), share)
    by_x, by_B = SkinGradients(V, F, W)(x.numpy(force=True), places, given)
    np.testing.assert_allclose(by_x, x.grad.numpy(), atol=1e-12)
    np.testing.assert_allclose(by_B, pose.grad.numpy(), atol=1e-10)
    # A point on the skin has no direction.
    on = ClosestPoints(np.zeros(n), facet, place.numpy(force=True), share)
    for found in SkinGradients(V, F, W)(on.point, on, given):
        np.testing.assert_array_equal(found, np.zeros_like(found))
