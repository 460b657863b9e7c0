import numpy as np
import pytest

from nilbs.geometry.grids import Grid


@pytest.mark.parametrize("shape", [(3, 4), (2, 3, 4)])
def test_points_run_like_nested_loops(shape: tuple[int, ...]) -> None:
    origin = np.arange(len(shape)) - 5.0
    grid = Grid(origin, 0.25, shape)
    slow = np.array([origin + 0.25 * np.array(index) for index in np.ndindex(*shape)])
    np.testing.assert_array_equal(grid.points(), slow)
    np.testing.assert_array_equal(grid.lower, slow[0])
    np.testing.assert_array_equal(grid.upper, slow[-1])
    assert grid.size == len(slow)


@pytest.mark.parametrize("size", [1, 7, 24, 100])
def test_chunks_are_the_points_in_order(size: int) -> None:
    grid = Grid([0.0, 1.0, 2.0], 0.1, (2, 3, 4))
    pieces = list(grid.chunks(size))
    assert all(len(x) <= size for _, x in pieces)
    assert sum(len(x) for _, x in pieces) == grid.size
    everything = grid.points()
    for part, x in pieces:
        np.testing.assert_array_equal(x, everything[part])


@pytest.mark.parametrize("d", [2, 3])
def test_cube_is_centred_with_its_edge_in_longest_edges(d: int, rng: np.random.Generator) -> None:
    V = rng.normal(size=(20, d)) * np.array([1.0, 5.0, 2.0])[:d]
    grid = Grid.cube(V, 8, scale=1.1)
    assert grid.shape == (9,) * d
    np.testing.assert_allclose(grid.upper - grid.lower, 1.1 * np.ptp(V, axis=0).max())
    np.testing.assert_allclose(grid.upper + grid.lower, V.max(axis=0) + V.min(axis=0))


@pytest.mark.parametrize("d", [2, 3])
def test_box_covers_the_padded_box_with_few_cells(d: int, rng: np.random.Generator) -> None:
    V = rng.normal(size=(20, d)) * np.array([1.0, 5.0, 2.0])[:d]
    longest = np.ptp(V, axis=0).max()
    grid = Grid.box(V, 16, pad=0.1)
    assert max(grid.shape) == 17
    np.testing.assert_allclose(grid.spacing, 1.2 * longest / 16)
    np.testing.assert_allclose(grid.upper + grid.lower, V.max(axis=0) + V.min(axis=0))
    margin = np.concatenate([V.min(axis=0) - grid.lower, grid.upper - V.max(axis=0)])
    assert (margin >= 0.1 * longest - 1e-12).all()
    assert (margin <= 0.1 * longest + grid.spacing / 2 + 1e-12).all()


def test_a_flat_set_of_points_still_has_a_cell_across() -> None:
    assert Grid.box([[0, 0, 1], [4, 0, 1]], 4, pad=0.0).shape == (5, 2, 2)


@pytest.mark.parametrize(
    ("low", "high", "resolution", "pad"), [(-0.4, -0.2, 53, 0.05), (-0.6, 0.9, 7, 0.1), (-0.2, 0.8, 126, 0.05)]
)
def test_rounding_adds_no_cell(low: float, high: float, resolution: int, pad: float) -> None:
    # Here the padded edge over the spacing comes out a little above the resolution.
    assert Grid.box([[low, low], [high, high]], resolution, pad=pad).shape == (resolution + 1,) * 2


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="d must be 2 or 3"):
        Grid([0.0], 1.0, (2,))
    with pytest.raises(ValueError, match="shape must hold d = 2 positive numbers"):
        Grid([0.0, 0.0], 1.0, (2, 2, 2))
    with pytest.raises(ValueError, match="shape"):
        Grid([0.0, 0.0], 1.0, (2, 0))
    for spacing in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="spacing must be positive"):
            Grid([0.0, 0.0], spacing, (2, 2))
    with pytest.raises(ValueError, match="V is empty"):
        Grid.cube(np.empty((0, 3)), 4)
    with pytest.raises(ValueError, match="coincide"):
        Grid.box(np.ones((3, 2)), 4)
    for resolution in (0, 1.5, np.nan, "4", 50_000):
        with pytest.raises(ValueError, match="resolution must be a whole number from 1 to 46340 in 2 dimensions"):
            Grid.cube([[0, 0], [1, 1]], resolution)
    with pytest.raises(ValueError, match="resolution must be a whole number from 1 to 1290 in 3 dimensions, got 1300"):
        Grid.box([[0, 0, 0], [1, 1, 1]], 1300)
    with pytest.raises(ValueError, match="spacing must be positive"):
        Grid.cube([[0, 0], [1, 1]], 4, scale=0.0)
    with pytest.raises(ValueError, match="pad must not be negative"):
        Grid.box([[0, 0], [1, 1]], 4, pad=-0.1)
    with pytest.raises(ValueError, match="size must be positive"):
        next(Grid([0.0, 0.0], 1.0, (2, 2)).chunks(0))
