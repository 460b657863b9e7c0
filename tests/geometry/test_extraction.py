import numpy as np
import pytest

from nilbs.geometry.extraction import field_surface, node_levels
from nilbs.geometry.grids import Grid
from nilbs.geometry.metrics import surface_scores
from nilbs.geometry.winding import occupancy
from nilbs.methods.mesh_lbs.field import PosedMesh


def ball(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x, axis=1) - 0.6


def two_balls(x: np.ndarray) -> np.ndarray:
    shift = np.zeros(x.shape[1])
    shift[0] = 0.45
    return np.minimum(np.linalg.norm(x - shift, axis=1) - 0.4, np.linalg.norm(x + shift, axis=1) - 0.25)


def shell(x: np.ndarray) -> np.ndarray:
    """A ring or hollow ball whose wall is thinner than a block."""
    return np.abs(np.linalg.norm(x, axis=1) - 0.7) - 0.03


def speck(x: np.ndarray) -> np.ndarray:
    """A ball in the middle of a block of the grid with 40 cells."""
    return np.linalg.norm(x - 0.11, axis=1) - 0.045


def slope(x: np.ndarray) -> np.ndarray:
    """A half-space whose border crosses that of a block of the grid with 24 cells."""
    return x[:, 0] + 0.05 * x[:, 1] + 0.02


def field_of(function):
    return lambda x: (function(x), function(x))


@pytest.mark.parametrize("function", [ball, two_balls, shell, speck])
@pytest.mark.parametrize("resolution", [40, 37])
@pytest.mark.parametrize("d", [2, 3])
def test_coarse_queries_first_give_the_same_surface(d: int, resolution: int, function) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), resolution)
    U, F = field_surface(field_of(function), grid, stride=4)
    everywhere = field_surface(field_of(function), grid, stride=1)
    assert len(F)
    np.testing.assert_array_equal(U, everywhere[0])
    np.testing.assert_array_equal(F, everywhere[1])


@pytest.mark.parametrize("d", [2, 3])
def test_few_queries_give_right_signs_everywhere_and_exact_values_near_the_surface(d: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), {2: 128, 3: 64}[d])
    levels, count = node_levels(field_of(ball), grid, stride=4)
    true = ball(grid.points()).reshape(grid.shape)
    np.testing.assert_array_equal(levels < 0, true < 0)
    near = np.abs(true) < 1.5 * grid.spacing
    np.testing.assert_array_equal(levels[near], true[near])
    assert count < 0.6 * grid.size
    assert node_levels(field_of(ball), grid, stride=1)[1] >= grid.size


def test_the_count_of_queries_is_right() -> None:
    grid, seen = Grid.cube(np.array([[-1.0, -1], [1, 1]]), 50), []

    def values(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(len(x))
        assert np.abs(x).max() <= 1.1 + 1e-9
        return ball(x), ball(x)

    assert node_levels(values, grid, stride=4)[1] == sum(seen)


@pytest.mark.parametrize("function", [ball, slope])
@pytest.mark.parametrize("d", [2, 3])
def test_a_sign_change_is_followed_although_the_distance_is_large(d: int, function) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 24)
    far = field_surface(lambda x: (function(x), np.full(len(x), 9.0)), grid, stride=4)
    for found, true in zip(far, field_surface(field_of(function), grid, stride=1), strict=True):
        np.testing.assert_array_equal(found, true)


@pytest.mark.parametrize("d", [2, 3])
def test_all_outside_is_an_empty_surface(d: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 9)
    U, F = field_surface(lambda x: (np.ones(len(x)), np.ones(len(x))), grid)
    assert U.shape == (0, d)
    assert F.shape == (0, d)


@pytest.mark.parametrize("d", [2, 3])
def test_a_grid_smaller_than_a_block(d: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 2)
    for found, true in zip(
        field_surface(field_of(ball), grid), field_surface(field_of(ball), grid, stride=1), strict=True
    ):
        np.testing.assert_array_equal(found, true)


@pytest.mark.parametrize("d", [2, 3])
def test_the_field_of_a_mesh_gives_the_mesh_back(d: int, rng: np.random.Generator) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 24)
    U, F = field_surface(field_of(two_balls), grid)
    mesh, x = PosedMesh(U, F), rng.uniform(-1, 1, (200, d))
    np.testing.assert_array_equal(mesh.inside(x), occupancy(U, F, x))
    finer = Grid.cube(U, 48)
    scores = surface_scores(*mesh.extract_on(finer), U, F, unit=2.0, n=2000, rng=rng)
    assert scores["chamfer_l1"] < 0.2
    assert scores["normal_consistency"] > 0.98
    assert scores["components"] == 2
    assert scores["watertight"]


def knob(x: np.ndarray) -> np.ndarray:
    """A half-space with a small ball on it, within the blocks beside the border of the grid with 40 cells."""
    height = np.zeros(x.shape[1])
    height[0] = 0.1
    return np.minimum(x[:, 0], np.linalg.norm(x - height, axis=1) - 0.08)


@pytest.mark.parametrize("d", [2, 3])
def test_without_a_distance_blocks_beside_the_surface_are_refined(d: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 40)
    queries_at = []

    def values(x: np.ndarray) -> tuple[np.ndarray, None]:
        queries_at.append(x)
        return knob(x), None

    U, F = field_surface(values, grid, stride=4)
    everywhere = field_surface(field_of(knob), grid, stride=1)
    np.testing.assert_array_equal(U, everywhere[0])
    np.testing.assert_array_equal(F, everywhere[1])
    assert sum(map(len, queries_at)) < 0.6 * grid.size
