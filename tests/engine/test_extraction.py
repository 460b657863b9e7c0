import numpy as np
import pytest

from nilbs.engine.blocks import near
from nilbs.engine.extraction import dense_surface, surface_near
from nilbs.engine.marching_cubes import _table
from nilbs.engine.polishing import on_zero_set
from nilbs.geometry.distance import closest_points
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.surface import Surface

Edge = tuple[int, ...]


def ball(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x, axis=1) - 0.61


def torus(x: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.65, x[:, 2]) - 0.25


def triangles(surface: Surface, grid: Grid) -> set[tuple[Edge, ...]]:
    """Triangles by the edges or cells of the grid that their corners lie on or in, the smallest first."""
    index = (surface[0] - grid.origin) / grid.spacing
    between = np.abs(index - np.round(index)) > 1e-5
    place = np.where(between, np.floor(index), np.round(index))
    names = [tuple(row) for row in np.concatenate([place, between], axis=1).astype(int).tolist()]
    found = set()
    for a, b, c in surface[1].tolist():
        corners = names[a], names[b], names[c]
        first = corners.index(min(corners))
        found.add(corners[first:] + corners[:first])
    return found


def skin_of(function, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    return isosurface(function(grid.points()), grid)


@pytest.mark.parametrize("function", [ball, torus])
@pytest.mark.parametrize("resolution", [13, 32, 40])
def test_blocks_near_the_skin_give_the_triangles_of_the_dense_grid(function, resolution: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), resolution)
    queries = []

    def values(x: np.ndarray) -> np.ndarray:
        queries.append(len(x))
        return function(x)

    found = surface_near(*skin_of(function, Grid.cube(grid.points(), 20)), values, grid)
    twin = dense_surface(lambda x: (function(x), None), grid, stride=1)
    assert triangles(found, grid) == triangles(twin, grid)
    assert len(found[0]) == len(twin[0])
    assert len(found[1]) == len(twin[1])
    assert resolution < 40 or sum(queries) < 0.3 * grid.size


def test_where_values_decide_cells_are_those_of_the_dense_grid(rng: np.random.Generator) -> None:
    grid = Grid([0.0] * 3, 1.0, (14, 15, 16))
    for _ in range(3):
        levels = rng.normal(size=grid.shape)
        skin = isosurface(levels, grid)
        node = lambda x: levels[tuple(np.round(x).astype(int).T)]  # noqa: B023, E731
        found, twin = surface_near(*skin, node, grid), Surface(*skin)
        assert is_watertight(found[1])
        assert triangles(found, grid) == triangles(twin, grid)
        assert len(found[1]) == len(twin[1])


def test_a_surface_is_followed_away_from_the_skin() -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 40)
    V = np.array([[0.0, 0, 0.6], [0.1, 0, 0.6], [0, 0.1, 0.6]])
    found = surface_near(V, np.array([[0, 1, 2]]), ball, grid)
    assert triangles(found, grid) == triangles(dense_surface(lambda x: (ball(x), None), grid, stride=1), grid)


@pytest.mark.parametrize("tolerance", [None, 1e-6])
def test_a_surface_that_meets_the_border_is_closed_there(tolerance: float | None) -> None:
    grid = Grid.box(np.array([[-0.4] * 3, [0.7] * 3]), 21, pad=0.0)
    found = surface_near(*skin_of(ball, grid), ball, grid, tolerance=tolerance)
    assert is_watertight(found[1])
    assert (found[0] > grid.lower - 0.01).all()
    twin = dense_surface(lambda x: (ball(x), None), grid, stride=1)
    assert triangles(found, grid) == triangles(twin, grid)


def test_nothing_inside_is_an_empty_surface() -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 20)
    U, F = surface_near(*skin_of(ball, grid), lambda x: np.ones(len(x)), grid, tolerance=1e-6)
    assert U.shape == F.shape == (0, 3)


def test_levels_that_are_not_finite_are_refused() -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), 20)
    with pytest.raises(ValueError, match=r"^levels must be finite, got inf"):
        surface_near(*skin_of(ball, grid), lambda x: np.full(len(x), np.inf), grid)


def bent(x: np.ndarray) -> np.ndarray:
    """A ball with a level that bends, saturates and jumps."""
    distance = np.linalg.norm(x, axis=1) - 0.6
    level = np.where(x[:, 0] > 0, np.tanh(30 * distance), distance + 0.5 * np.maximum(distance, 0))
    return np.where(x[:, 1] > 0.3, np.where(distance < 0, -1.0, 2.0), level)


@pytest.mark.parametrize("d", [2, 3])
def test_polished_vertices_are_where_the_sign_changes(d: int) -> None:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 24)
    twin = dense_surface(lambda x: (bent(x), None), grid, stride=1, tolerance=1e-6)
    surfaces = [twin]
    if d == 3:
        surfaces.append(surface_near(*skin_of(ball, grid), bent, grid, tolerance=1e-6))
        assert triangles(surfaces[0], grid) == triangles(surfaces[1], grid)
    for U, _ in surfaces:
        assert np.abs(np.linalg.norm(U, axis=1) - 0.6).max() < 1e-6


def test_polishing_needs_few_queries_and_stays_between_the_ends(rng: np.random.Generator) -> None:
    low = rng.normal(size=(500, 3))
    high = low + 0.1 * rng.normal(size=(500, 3))
    zero = rng.uniform(0, 1, 500)
    zero[:20] = 0.0
    count = []

    def values(x: np.ndarray) -> np.ndarray:
        count.append(len(x))
        # Each segment is recognised by where it is.
        part = np.einsum("ni,kni->kn", high - low, x[:, None] - low) / np.sum((high - low) ** 2, axis=1)
        off = np.linalg.norm(x[:, None] - low - part[:, :, None] * (high - low), axis=2).argmin(axis=1)
        s = part[np.arange(len(x)), off] - zero[off]
        return s + 0.3 * s**2

    x = on_zero_set(low, high, -zero + 0.3 * zero**2, 1.3 - zero, values, tolerance=1e-6)
    assert np.linalg.norm(x - low - zero[:, None] * (high - low), axis=1).max() < 1e-6
    assert sum(count) < 12 * 500
    assert (np.linalg.norm(x - low, axis=1) > 1e-8).all()


def test_cases_that_signs_decide_are_those_with_connected_corners() -> None:
    table = _table()
    assert table.number[[0, 255]].tolist() == [0, 0]
    assert np.count_nonzero(table.number < 0) == 128  # of Lewiner's cases 3, 4, 6, 7, 10, 12 and 13
    assert table.number.max() == 4


@pytest.mark.parametrize(("resolution", "reach"), [(17, 0.0), (40, 0.0), (40, 0.15)])
def test_blocks_near_a_surface_are_those_whose_centre_is_within_reach(resolution: int, reach: float, rng) -> None:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), resolution)
    V, F = rng.uniform(-1.2, 1.2, (30, 3)), rng.integers(0, 30, (12, 3))  # also flat and beyond the grid
    F[0], F[1, 1] = F[0, 0], F[1, 0]
    shape = (np.array(grid.shape) + 2) // 2
    every = 2 * np.argwhere(np.ones(shape))
    distance, _, _ = closest_points(V, F, grid.origin + grid.spacing * every)
    expected = distance <= max(3**0.5 * grid.spacing, reach) * (1 - 1e-9)
    corner = near(V, F, grid, reach)
    found = np.zeros(shape, dtype=bool)
    found[tuple(corner.T // 2)] = True
    assert len(corner) == found.sum()
    assert found.ravel()[expected].all()
    assert found.sum() < 1.5 * expected.sum()
