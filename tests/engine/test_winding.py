import numpy as np
import pytest

from nilbs.engine.winding import is_closed, winding_number
from nilbs.geometry import winding
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface


def ball() -> tuple[np.ndarray, np.ndarray]:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 14)
    return isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)


def overlapping() -> tuple[np.ndarray, np.ndarray]:
    """Two balls that overlap, one of them twice, and one inside out."""
    V, F = ball()
    n = len(V)
    parts = [F, F + n, F + n, (F + 2 * n)[:, ::-1]]
    shifts = np.array([[0.0, 0, 0], [0.5, 0.1, 0.2], [3, 0, 0]])
    return (V + shifts[:, None]).reshape(-1, 3), np.concatenate(parts)


@pytest.mark.parametrize("surface", [ball, overlapping])
def test_closed_surfaces_have_the_generalized_winding_number(surface, rng: np.random.Generator) -> None:
    V, F = surface()
    assert is_closed(F)
    x = rng.uniform(-1.5, 4, (4000, 3))
    x = np.concatenate([x, V[F].mean(axis=1) + 1e-4 * rng.normal(size=(len(F), 3))])
    twin = winding.winding_number(V, F, x, exact=True)
    np.testing.assert_allclose(winding_number(V, F, x), twin, atol=1e-6)
    assert len(set(np.round(twin).tolist())) >= (2 if surface is ball else 5)


def test_rays_through_corners_and_edges_count_once() -> None:
    V, F = ball()
    inner = 0.5 * V  # rays from here meet no corner; those from below meet one each
    below = V - np.array([3.0, 0, 0])
    middles = (V[F[:, 0]] + V[F[:, 1]]) / 2 - np.array([3.0, 0, 0])
    assert (winding_number(V, F, np.concatenate([below, middles])) == 0).all()
    assert (winding_number(V, F, inner) == 1).all()
    axis = np.array([[0.0, 0, 0], [-0.5, 0, 0], [0.5, 0, 0], [0, 0.3, 0], [0, 0, -0.3]])
    assert (winding_number(V, F, axis) == 1).all()


def test_open_and_plane_surfaces_are_those_of_the_twin(rng: np.random.Generator) -> None:
    V, F = ball()
    assert not is_closed(F[:-1])
    x = rng.uniform(-1, 1, (50, 3))
    np.testing.assert_array_equal(winding_number(V, F[:-1], x), winding.winding_number(V, F[:-1], x))
    square, edges = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    assert winding_number(square, edges, np.array([[0.5, 0.5], [2, 2]])).tolist() == [1, 0]
    assert winding_number(V, F[:0], x).tolist() == [0] * 50
