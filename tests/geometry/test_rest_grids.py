import numpy as np
import pytest

from nilbs.geometry.distance import signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import volume_interpolation
from nilbs.geometry.rest_grids import distance_bricks, distance_grid, weight_grid


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cells", [5, 37, 64])
def test_exact_at_the_skin_and_of_the_right_sign_elsewhere(d: int, cells: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, cells)
    found = distance_grid(c.V, c.F, grid)
    exact = signed_distance(c.V, c.F, grid.points()).reshape(grid.shape)
    near = np.abs(exact) < 2 * grid.spacing * np.sqrt(d)
    assert near.any()
    np.testing.assert_allclose(found[near], exact[near], atol=1e-12)
    np.testing.assert_array_equal(found < 0, exact < 0)
    # Away from it the error is that of linear interpolation on coarser grids.
    assert np.abs(found - exact).max() < 0.05 * c.L


def test_far_fewer_distances_are_asked_than_there_are_nodes(characters, monkeypatch) -> None:
    c, asked = characters[2], []

    def counted(V, F, x):
        asked.append(len(x))
        return signed_distance(V, F, x)

    monkeypatch.setattr("nilbs.geometry.rest_grids.signed_distance", counted)
    grid = Grid.box(c.V, 512)
    distance_grid(c.V, c.F, grid)
    assert sum(asked) < 0.4 * grid.size


def linear(x: np.ndarray) -> np.ndarray:
    """Three weights that sum to one, linear in position."""
    slopes = np.array([[0.3, -0.2, 0.1], [-0.1, 0.3, 0.2]])[:, : x.shape[1]]
    first, second = 0.3 + x @ slopes.T[:, 0], 0.3 + x @ slopes.T[:, 1]
    return np.stack([first, second, 1 - first - second], axis=1)


@pytest.mark.parametrize("d", [2, 3])
def test_linear_weights_go_on_linearly_beyond_the_skin(d: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, 40, pad=0.1)
    depth = 0.02 * c.L
    node, W_node = weight_grid(
        c.V, c.F, linear(c.V), c.V_volume, c.T, linear(c.V_volume), grid, band=0.08 * c.L, depth=depth
    )
    x = grid.points()[node]
    distance = signed_distance(c.V, c.F, x)
    assert 0.07 * c.L < distance.max() < 0.08 * c.L
    assert len(node) == (distance_grid(c.V, c.F, grid) < 0.08 * c.L).sum()
    np.testing.assert_allclose(W_node.sum(axis=1), 1, atol=1e-12)
    inside, close = distance < 0, (distance > 0) & (distance < depth)
    np.testing.assert_allclose(W_node[inside], linear(x[inside]), atol=1e-9)
    # The mirror image lies along the way to the closest place; where that leaves the body again weights bend.
    assert np.quantile(np.abs(W_node[close] - linear(x[close])), 0.95) < 2e-3
    assert np.abs(W_node[close] - linear(x[close])).max() < 0.05


def test_inside_they_are_those_of_the_volume(characters) -> None:
    c = characters[3]
    grid = Grid.box(c.V, 20)
    node, W_node = weight_grid(c.V, c.F, c.W, c.V_volume, c.T, c.W_volume, grid, band=0.0, depth=0.0)
    expected = volume_interpolation(c.V_volume, c.T, c.W_volume, grid.points()[node])
    np.testing.assert_allclose(W_node, expected, atol=1e-12)


def test_a_grid_that_misses_the_body_has_the_nearest_node(characters) -> None:
    c = characters[2]
    grid = Grid(c.V.max(axis=0) + 3 * c.L, 0.1 * c.L, (3, 3))
    node, W_node = weight_grid(c.V, c.F, c.W, c.V_volume, c.T, c.W_volume, grid, band=0.1 * c.L, depth=0.0)
    assert node.tolist() == [0]
    np.testing.assert_allclose(W_node.sum(axis=1), 1)


@pytest.mark.parametrize("d", [2, 3])
def test_cells_that_the_surface_may_cross_are_divided_and_exact(d: int, characters) -> None:
    c, parts = characters[d], 3
    grid = Grid.box(c.V, 12)
    values, brick = distance_bricks(c.V, c.F, grid, parts=parts)
    assert brick.shape == tuple(n - 1 for n in grid.shape)
    np.testing.assert_array_equal(values[: grid.size].reshape(grid.shape), distance_grid(c.V, c.F, grid))
    # A slow twin: every cell by itself.
    begins = grid.size
    within = np.stack(np.meshgrid(*[np.arange(parts + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    for cell in np.ndindex(*brick.shape):
        corner = grid.origin + grid.spacing * np.array(cell)
        nodes = corner + grid.spacing * within / parts
        exact = signed_distance(c.V, c.F, nodes)
        crossed = exact.min() < 0 < exact.max()
        if brick[cell] < 0:
            assert not crossed
            continue
        assert brick[cell] == begins
        begins += len(within)
        np.testing.assert_allclose(values[brick[cell] :][: len(within)], exact, atol=1e-12)
    assert begins == len(values)
    assert 0 < (brick >= 0).mean() < 1
