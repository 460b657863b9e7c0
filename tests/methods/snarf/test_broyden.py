"""Broyden's method against maps whose inverse is known, and against a slow twin that updates the Jacobian itself."""

import numpy as np
import pytest
import torch
from torch import Tensor

from nilbs.methods.snarf.broyden import broyden


def bend(x_rest: Tensor) -> Tensor:
    """A smooth map that is one to one: its derivative is near a turn."""
    turned = torch.roll(x_rest, 1, dims=-1) * torch.tensor([-1.0] + [1.0] * (x_rest.shape[-1] - 1)).to(x_rest)
    return turned + 0.15 * torch.sin(2 * x_rest) + 0.3


def jacobian(x_rest: Tensor) -> Tensor:
    return torch.stack([torch.autograd.functional.jacobian(bend, point) for point in x_rest])


def twin(x: np.ndarray, start: np.ndarray, J: np.ndarray, iterations: int, threshold: float) -> tuple[np.ndarray, int]:
    """One point at a time, by the update of the Jacobian that Broyden's paper begins with."""
    value = bend(torch.as_tensor(start)).numpy() - x
    evaluations = 1
    while np.linalg.norm(value) >= threshold and evaluations <= iterations:
        step = -np.linalg.solve(J, value)
        start, before = start + step, value
        value = bend(torch.as_tensor(start)).numpy() - x
        evaluations += 1
        J = J + np.outer(value - before - J @ step, step) / (step @ step)
    return start, evaluations


@pytest.mark.parametrize("d", [2, 3])
def test_roots_of_a_known_map_are_those_of_the_slow_twin(d: int, rng: np.random.Generator) -> None:
    truth = torch.as_tensor(rng.uniform(-0.5, 0.5, (40, d)))
    start = truth + torch.as_tensor(rng.normal(0, 0.1, (40, d)))
    x, J = bend(truth), jacobian(start)
    roots = broyden(lambda z, _: bend(z), x, start, torch.linalg.inv(J), iterations=20, convergence=1e-9)
    assert roots.converged.all()
    np.testing.assert_allclose(roots.x_rest, truth, atol=1e-8)
    np.testing.assert_allclose(roots.residual, (bend(roots.x_rest) - x).norm(dim=-1), atol=1e-15)
    slow = [twin(a.numpy(), s.numpy(), j.numpy(), 20, 1e-9) for a, s, j in zip(x, start, J, strict=True)]
    np.testing.assert_allclose(roots.x_rest, np.stack([point for point, _ in slow]), atol=1e-10)
    assert roots.evaluations == sum(evaluations for _, evaluations in slow)


@pytest.mark.parametrize("d", [2, 3])
def test_a_root_found_is_not_evaluated_again(d: int, rng: np.random.Generator) -> None:
    truth = torch.as_tensor(rng.uniform(-0.5, 0.5, (30, d)))
    start = truth + torch.linspace(0, 0.2, 30)[:, None].double()  # the first is a root already
    x, seen = bend(truth), torch.zeros(30, dtype=torch.int64)

    def counted(z: Tensor, which: Tensor) -> Tensor:
        seen[which] += 1
        return bend(z)

    inverse = torch.linalg.inv(jacobian(start))
    roots = broyden(counted, x, start, inverse, iterations=20)
    assert seen[0] == 1
    assert seen[1] < seen[-1] < 21
    assert roots.evaluations == seen.sum()
    given = broyden(counted, x, start, inverse, iterations=20, x_start=bend(start))
    assert given.evaluations == roots.evaluations - 30
    np.testing.assert_array_equal(given.x_rest, roots.x_rest)
    few = broyden(counted, x, start, inverse, iterations=1)
    assert few.converged.sum() < 30 == roots.converged.sum()
    assert few.evaluations <= 60


@pytest.mark.parametrize("d", [2, 3])
def test_an_affine_map_takes_one_step(d: int, rng: np.random.Generator) -> None:
    A = torch.as_tensor(rng.normal(size=(d, d)) + 3 * np.eye(d))
    x = torch.as_tensor(rng.normal(size=(20, d)))
    inverse = torch.linalg.inv(A).expand(20, d, d)
    roots = broyden(lambda z, _: z @ A.T, x, torch.zeros_like(x), inverse, iterations=9, convergence=1e-12)
    assert roots.evaluations == 40
    np.testing.assert_allclose(roots.x_rest @ A.T, x, atol=1e-12)


def test_a_search_without_a_root_keeps_its_best_point_and_is_not_converged() -> None:
    # x^2 + 1 has no zero: the best is near the origin. From 2 the steps stay small, from 0.01 the first leads far away.
    start = torch.tensor([[2.0], [0.01]]).double()
    seen = []

    def forward(z: Tensor, which: Tensor) -> Tensor:
        seen.append(which.tolist())
        return z**2 + 1

    roots = broyden(forward, 0 * start, start, 0.5 / start[:, :, None], iterations=8, divergence=10.0)
    assert not roots.converged.any()
    assert seen[:3] == [[0, 1], [0, 1], [0]]
    assert 1 <= roots.residual[0] < 1.6
    np.testing.assert_allclose(roots.x_rest[1], [0.01])
    assert roots.evaluations == sum(map(len, seen))


def test_what_is_not_finite_stays_so_and_no_graph_is_kept() -> None:
    x = torch.tensor([[1.0, 2.0], [torch.nan, 0.0]], requires_grad=True)
    roots = broyden(lambda z, _: z, x, torch.zeros(2, 2), torch.eye(2).expand(2, 2, 2), iterations=3)
    assert roots.converged.tolist() == [True, False]
    assert not roots.x_rest.requires_grad
    empty = broyden(lambda z, _: z, torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0, 3, 3), iterations=3)
    assert empty.x_rest.shape == (0, 3)
    assert empty.evaluations == 0
