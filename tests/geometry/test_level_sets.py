import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from nilbs.geometry.facets import components, facet_areas, facet_normals, is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.winding import winding_number


def enclosed(V: np.ndarray, F: np.ndarray) -> float:
    """Area or volume, by the divergence theorem; positive for an outward surface."""
    return float(np.sum(facet_areas(V, F) * np.sum(facet_normals(V, F) * V[F].mean(axis=1), axis=1)) / V.shape[1])


def unit_grid(d: int, resolution: int) -> Grid:
    return Grid([-1.0] * d, 2 / resolution, (resolution + 1,) * d)


def assert_clean(V: np.ndarray, F: np.ndarray) -> None:
    assert is_watertight(F)
    assert len(np.unique(V, axis=0)) == len(V), "two vertices in one place"
    assert facet_areas(V, F).min() > 0
    assert set(F.ravel()) == set(range(len(V))), "a vertex that no facet uses"


@pytest.mark.parametrize("d", [2, 3])
def test_a_ball_converges_from_within(d: int) -> None:
    truth = np.pi * 0.49 if d == 2 else 4 / 3 * np.pi * 0.343
    errors = []
    for resolution in (16, 32, 64):
        grid = unit_grid(d, resolution)
        V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.7, grid)
        assert_clean(V, F)
        assert components(F, len(V)) == 1
        assert (np.abs(np.linalg.norm(V, axis=1) - 0.7) < grid.spacing**2).all()
        errors.append(truth - enclosed(V, F))
    # Chords and linear interpolation both lose volume of a convex body; halving the cells quarters the loss.
    assert errors[0] > errors[1] > errors[2] > 0
    assert 3.5 < errors[1] / errors[2] < 4.5


def test_a_plane_is_met_exactly() -> None:
    grid = unit_grid(3, 7)
    V, F = isosurface(grid.points()[:, 2] - 0.123, grid)
    assert_clean(V, F)
    inner = np.abs(V).max(axis=1) < 0.99
    np.testing.assert_allclose(V[inner, 2], 0.123, atol=1e-5)


def test_a_torus_has_a_hole() -> None:
    grid = Grid.cube([[-1, -1, -1], [1, 1, 1]], 32)
    x, y, z = grid.points().T
    V, F = isosurface(np.hypot(np.hypot(x, y) - 0.65, z) - 0.25, grid)
    assert_clean(V, F)
    edges = 3 * len(F) // 2
    assert len(V) - edges + len(F) == 0
    np.testing.assert_allclose(enclosed(V, F), 2 * np.pi**2 * 0.65 * 0.25**2, rtol=0.02)


@pytest.mark.parametrize("d", [2, 3])
def test_two_balls_and_a_shell(d: int) -> None:
    grid = unit_grid(d, 40)
    x = grid.points()
    apart = np.minimum(np.linalg.norm(x - 0.5, axis=1), np.linalg.norm(x + 0.5, axis=1)) - 0.3
    V, F = isosurface(apart, grid)
    assert_clean(V, F)
    assert components(F, len(V)) == 2
    shell = np.abs(np.linalg.norm(x, axis=1) - 0.6) - 0.15
    V, F = isosurface(shell, grid)
    assert_clean(V, F)
    np.testing.assert_allclose(np.round(winding_number(V, F, [[0.0] * d, [0.6] + [0.0] * (d - 1)])), [0, 1])


@pytest.mark.parametrize("d", [2, 3])
def test_a_body_beyond_the_grid_is_cut_off_and_closed(d: int) -> None:
    grid = unit_grid(d, 10)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 1.2, grid)
    assert_clean(V, F)
    assert (np.abs(V) < 1 + 2e-3 * grid.spacing).all()
    V, F = isosurface(np.full(grid.size, -1.0), grid)
    assert_clean(V, F)
    np.testing.assert_allclose(enclosed(V, F), 2.0**d, rtol=1e-3)


FIELDS = {
    "rough": lambda rng, shape: rng.normal(size=shape),
    "smooth": lambda rng, shape: gaussian_filter(rng.normal(size=shape), 1.5),
    "binary": lambda rng, shape: rng.choice([-1.0, 1.0], shape),
    "zeros and ties": lambda rng, shape: rng.integers(-2, 3, shape),
    "twenty orders of magnitude": lambda rng, shape: rng.choice([-1.0, 1.0], shape) * 10 ** rng.uniform(-10, 10, shape),
}


@pytest.mark.parametrize("kind", FIELDS)
@pytest.mark.parametrize("shape", [(40, 30), (15, 12, 14)])
def test_noise_gives_a_clean_surface_between_the_signs(
    kind: str, shape: tuple[int, ...], rng: np.random.Generator
) -> None:
    for _ in range(5):
        values = FIELDS[kind](rng, shape)
        grid = Grid([3.0] * len(shape), 0.5, shape)
        V, F = isosurface(values, grid)
        assert_clean(V, F)
        w = winding_number(V, F, grid.points(), exact=True)
        np.testing.assert_allclose(w, values.ravel() < 0, atol=1e-6)


def test_two_cells_that_share_a_diagonal_are_separated() -> None:
    # On these two cells marching cubes alone puts four triangles on an edge.
    values = [[[-0.8, -0.65, -1.33], [0.68, 0.04, 1.0]], [[0.24, 1.77, 0.43], [-0.73, -0.19, -1.37]]]
    V, F = isosurface(np.array(values), Grid([0.0] * 3, 1.0, (2, 2, 3)))
    assert_clean(V, F)


@pytest.mark.parametrize("kind", ["ties", "a peak far above the rest"])
def test_ties_need_no_repair(kind: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    # The repair is a loop over edges: slow on a binary volume, which needs it everywhere.
    monkeypatch.setattr("nilbs.geometry.level_sets.two_triangles_an_edge", lambda index, F: (index, F))
    shape = (20, 20, 20)
    values = rng.choice([-1.0, 1.0], shape) if kind == "ties" else 1e-4 * rng.normal(size=shape)
    values[0, 0, 0] = 1.0
    _, F = isosurface(values, Grid([0.0] * 3, 1.0, shape))
    assert is_watertight(F)


@pytest.mark.parametrize("d", [2, 3])
def test_values_at_the_level_are_outside(d: int) -> None:
    grid = Grid([0.0] * d, 1.0, (4,) * d)
    values = np.zeros(grid.shape)
    V, F = isosurface(values, grid)
    assert V.shape == F.shape == (0, d)
    values[(1,) * d] = -1.0
    V, F = isosurface(values, grid)
    assert_clean(V, F)
    np.testing.assert_allclose(np.linalg.norm(V - 1, axis=1), 1, atol=2e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_level_scale_and_place(d: int) -> None:
    grid = unit_grid(d, 12)
    values = np.linalg.norm(grid.points(), axis=1)
    V, F = isosurface(values - 0.6, grid)
    V_level, F_level = isosurface(values, grid, level=0.6)
    np.testing.assert_array_equal(F, F_level)
    np.testing.assert_allclose(V, V_level, atol=1e-6)
    moved = Grid(grid.origin + 7, grid.spacing * 3, grid.shape)
    V_moved, _ = isosurface(1e-8 * (values.reshape(grid.shape) - 0.6), moved)
    np.testing.assert_allclose(V_moved, moved.origin + 3 * (V - grid.origin), atol=1e-5)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_below_the_level_is_an_empty_surface(d: int) -> None:
    grid = unit_grid(d, 3)
    V, F = isosurface(np.ones(grid.shape), grid)
    assert V.shape == F.shape == (0, d)
    assert F.dtype == np.int64


def test_wrong_arguments_are_named() -> None:
    grid = unit_grid(2, 3)
    with pytest.raises(ValueError, match=r"values must be \(4, 4\) or \(16,\) like the grid, got \(4, 5\)"):
        isosurface(np.zeros((4, 5)), grid)
    with pytest.raises(ValueError, match=r"values.*finite"):
        isosurface(np.full((4, 4), np.nan), grid)
    with pytest.raises(ValueError, match=r"level.*finite"):
        isosurface(np.zeros((4, 4)), grid, level=np.inf)
