import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from nilbs.geometry.distance import closest_points, signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import volume_interpolation
from nilbs.geometry.rest_grids import distance_bricks, distance_grid, weight_grid
from nilbs.geometry.winding import occupancy


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cells", [5, 37, 64])
def test_exact_at_the_surface_and_of_the_right_sign_elsewhere(d: int, cells: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, cells)
    found = distance_grid(c.V, c.F, grid)
    exact = signed_distance(c.V, c.F, grid.points()).reshape(grid.shape)
    near = np.abs(exact) < 2 * grid.spacing * np.sqrt(d)
    assert near.any()
    np.testing.assert_allclose(found[near], exact[near], atol=1e-12)
    np.testing.assert_array_equal(found < 0, exact < 0)
    # Away from the surface the error is that of linear interpolation on coarser grids.
    assert np.abs(found - exact).max() < 0.05 * c.L


def test_far_fewer_distances_are_computed_than_there_are_nodes(characters, monkeypatch) -> None:
    c, computed = characters[2], []

    def counted(V, F, x):
        computed.append(len(x))
        return closest_points(V, F, x)

    monkeypatch.setattr("nilbs.geometry.rest_grids.closest_points", counted)
    grid = Grid.box(c.V, 512)
    distance_grid(c.V, c.F, grid)
    assert sum(computed) < 0.4 * grid.size


def linear(x: np.ndarray) -> np.ndarray:
    """Three weights that sum to one, linear in position."""
    slopes = np.array([[0.3, -0.2, 0.1], [-0.1, 0.3, 0.2]])[:, : x.shape[1]]
    first, second = 0.3 + x @ slopes.T[:, 0], 0.3 + x @ slopes.T[:, 1]
    return np.stack([first, second, 1 - first - second], axis=1)


@pytest.mark.parametrize("d", [2, 3])
def test_linear_weights_continue_linearly_outside(d: int, characters) -> None:
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
    # The mirrored point lies beyond the closest place; weights bend if it is outside again.
    assert np.quantile(np.abs(W_node[close] - linear(x[close])), 0.95) < 2e-3
    assert np.abs(W_node[close] - linear(x[close])).max() < 0.05


def test_inside_weights_are_those_of_the_volume(characters) -> None:
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
def test_cells_that_the_surface_may_cross_are_divided(d: int, characters) -> None:
    c, parts = characters[d], 3
    grid = Grid.box(c.V, 12)
    values, brick, finer = distance_bricks(c.V, c.F, grid, parts=[parts], tolerance=0.0, relative=0.0)
    assert brick.shape == tuple(n - 1 for n in grid.shape)
    assert len(finer) == 0
    np.testing.assert_array_equal(values[: grid.size].reshape(grid.shape), distance_grid(c.V, c.F, grid))
    bricks = values[grid.size :].reshape(-1, *(parts + 1,) * d)
    # A slow twin: every cell by itself.
    number, within = 0, within_brick(parts, d)
    for cell in np.ndindex(*brick.shape):
        corner = grid.origin + grid.spacing * np.array(cell)
        exact = signed_distance(c.V, c.F, corner + grid.spacing * within / parts)
        crossed = exact.min() < 0 < exact.max()
        if brick[cell] < 0:
            assert not crossed
            continue
        assert brick[cell] == number
        number += 1
        # Values change by less than a cell of the brick, because distance changes no faster than position.
        assert np.abs(bricks[brick[cell]].ravel() - exact).max() < d / 6 * grid.spacing / parts
    assert number == len(bricks)
    assert 0 < (brick >= 0).mean() < 1


def within_brick(parts: int, d: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(parts + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)


@pytest.mark.parametrize("d", [2, 3])
def test_cells_of_bricks_are_divided_where_distance_bends(d: int, characters) -> None:
    c, parts, tolerance, relative = characters[d], (3, 2), 1e-3, 0.02
    grid = Grid.box(c.V, 10)
    values, brick, finer = distance_bricks(c.V, c.F, grid, parts=parts, tolerance=tolerance, relative=relative)
    finer = finer.reshape(-1, *(3,) * d)
    assert len(finer) == (brick >= 0).sum() == brick.max() + 1
    assert len(values) == grid.size + len(finer) * 4**d + (finer.max() + 1) * 3**d
    # A slow twin: every brick by itself.
    number = 0
    for place in np.argwhere(brick >= 0):
        corner = grid.origin + grid.spacing * place
        exact = signed_distance(c.V, c.F, corner + grid.spacing * within_brick(3, d) / 3).reshape((4,) * d)
        for cell in np.ndindex(*(3,) * d):
            nodes = exact[tuple(slice(i, i + 2) for i in cell)]
            bends = []
            for axis in range(d):
                bend = np.abs(np.diff(exact, 2, axis=axis))
                bend = np.concatenate([bend.take([0], axis), bend, bend.take([-1], axis)], axis)
                bends.append(bend[tuple(slice(i, i + 2) for i in cell)].mean())
            divided = finer[(brick[tuple(place)], *cell)]
            if abs(sum(bends) / 8 - (allowed := tolerance + relative * abs(nodes.mean()))) > 1e-12:
                assert (divided >= 0) == (sum(bends) / 8 > allowed)
            assert divided in (-1, number)
            number += divided >= 0
    assert 0 < number < finer.size
    # The second division holds distances about its own nodes.
    corner = np.empty((number, d))
    for place in np.argwhere(brick >= 0):
        for cell in np.argwhere(finer[brick[tuple(place)]] >= 0):
            corner[finer[(brick[tuple(place)], *cell)]] = grid.origin + grid.spacing * (place + cell / 3)
    exact = signed_distance(c.V, c.F, (corner[:, None] + grid.spacing * within_brick(2, d) / 6).reshape(-1, d))
    assert np.abs(values[-number * 3**d :] - exact).max() < d / 6 * grid.spacing / 6
    assert np.median(np.abs(values[-number * 3**d :] - exact)) < 5e-3 * grid.spacing


@pytest.mark.parametrize("d", [2, 3])
def test_between_nodes_distance_is_right_on_average(d: int, rng: np.random.Generator) -> None:
    # A ball that is a few cells thick; its distance is convex everywhere.
    V, F = ball(d)
    grid, parts = Grid([-1.6] * d, 0.4, (9,) * d), 4
    values, brick, _ = distance_bricks(V, F, grid, parts=[parts], tolerance=0.0, relative=0.0)
    bricks = values[grid.size :].reshape(-1, *(parts + 1,) * d)
    x = rng.normal(size=(4000, d))
    x *= rng.uniform(0.9, 1.1, (4000, 1)) / np.linalg.norm(x, axis=1, keepdims=True)
    cell = ((x - grid.origin) / grid.spacing).astype(int)
    at = parts * ((x - grid.origin) / grid.spacing - cell)
    number = brick[tuple(cell.T)]
    assert (number >= 0).all()
    exact = signed_distance(V, F, x)
    axes = [np.arange(len(bricks)), *[np.arange(parts + 1)] * d]
    missed = RegularGridInterpolator(axes, bricks)(np.column_stack([number, at])) - exact
    nodes = grid.origin + grid.spacing * (np.argwhere(brick >= 0)[:, None] + within_brick(parts, d) / parts)
    plain = signed_distance(V, F, nodes.reshape(-1, d)).reshape(bricks.shape)
    plainly = RegularGridInterpolator(axes, plain)(np.column_stack([number, at])) - exact
    assert plainly.mean() > 5 * abs(missed.mean())
    assert np.abs(plainly).mean() > 1.5 * np.abs(missed).mean()


def ball(d: int) -> tuple[np.ndarray, np.ndarray]:
    if d == 2:
        angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack(
            [np.arange(200), (np.arange(200) + 1) % 200], axis=1
        )
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=4)
    return np.asarray(sphere.vertices), np.asarray(sphere.faces)


def test_far_from_the_origin_signs_are_right() -> None:
    # There rounding makes some neighbours on either side of an edge a little farther from it than from each other.
    V = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + 1e6 * np.array([1, 0.7])
    F = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    grid = Grid.box(V, 40)
    found, exact = distance_grid(V, F, grid), signed_distance(V, F, grid.points()).reshape(grid.shape)
    np.testing.assert_array_equal(found < 0, exact < 0)


def test_parts_of_cells_are_at_least_two(characters) -> None:
    c = characters[2]
    with pytest.raises(ValueError, match=r"parts must be at least 2, got \[4, 1\]"):
        distance_bricks(c.V, c.F, Grid.box(c.V, 8), parts=[4, 1], tolerance=0.0, relative=0.0)
    whole = distance_bricks(c.V, c.F, Grid.box(c.V, 8), parts=[], tolerance=0.0, relative=0.0)
    assert (whole.brick == -1).all()
    assert len(whole.values) == Grid.box(c.V, 8).size


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("closed", [True, False])
def test_signs_are_those_of_the_winding_number(d: int, *, closed: bool, characters, monkeypatch) -> None:
    c, computed = characters[d], []
    # A hole connects inside and outside, so the sign is computed at every node.
    F = c.F if closed else c.F[len(c.F) // 50 :]

    def counted(V, F, x):
        computed.append(len(x))
        return occupancy(V, F, x)

    monkeypatch.setattr("nilbs.geometry.rest_grids.occupancy", counted)
    grid = Grid.box(c.V, 8)
    values, brick, _ = distance_bricks(c.V, F, grid, parts=[6], tolerance=0.0, relative=0.0)
    bricks = values[grid.size :].reshape(-1, 7**d)
    nodes = grid.origin + grid.spacing * (np.argwhere(brick >= 0)[:, None] + within_brick(6, d) / 6)
    exact = signed_distance(c.V, F, nodes.reshape(-1, d)).reshape(bricks.shape)
    sure = np.abs(exact) > d / 6 * grid.spacing / 6
    np.testing.assert_array_equal((bricks < 0)[sure], (exact < 0)[sure])
    if closed:
        assert sum(computed) < 0.6 * len(np.unique(nodes.reshape(-1, d).round(9), axis=0))
