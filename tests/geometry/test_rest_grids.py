from collections.abc import Sequence

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from nilbs.geometry.distance import closest_points, signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import volume_interpolation
from nilbs.geometry.rest_grids import distance_bricks, distance_grid, weight_grid
from nilbs.geometry.sampling import facet_samples
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
    x, W_node = grid.points()[node], W_node.toarray()
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
    np.testing.assert_allclose(W_node.toarray(), expected, atol=1e-12)


def test_a_grid_that_misses_the_body_has_the_nearest_node(characters) -> None:
    c = characters[2]
    grid = Grid(c.V.max(axis=0) + 3 * c.L, 0.1 * c.L, (3, 3))
    node, W_node = weight_grid(c.V, c.F, c.W, c.V_volume, c.T, c.W_volume, grid, band=0.1 * c.L, depth=0.0)
    assert node.tolist() == [0]
    np.testing.assert_allclose(W_node.sum(axis=1), 1)


def divided(
    V: np.ndarray, F: np.ndarray, grid: Grid, parts: Sequence[int], *, tolerance: float = 0.0, most: int = 10**8
):
    """Bricks, and the values of the bricks of each division (k, part + 1, .., part + 1)."""
    d, seed = len(grid.shape), np.random.default_rng(3)
    found = distance_bricks(V, F, grid, parts=parts, tolerance=tolerance, most=most, rng=seed)
    begin, above, cell, bricks = grid.size, found.brick, 0, []
    for part in parts:
        k = above.max(initial=-1) + 1
        bricks.append(found.values[begin : begin + k * (part + 1) ** d].reshape(k, *(part + 1,) * d))
        begin += k * (part + 1) ** d
        above = found.finer[cell : cell + k * part**d]
        cell += len(above)
    assert begin == len(found.values)
    assert cell == len(found.finer)
    return found, bricks


@pytest.mark.parametrize("d", [2, 3])
def test_cells_in_which_the_surface_lies_are_divided(d: int, characters) -> None:
    c, parts = characters[d], 3
    grid = Grid.box(c.V, 12)
    (values, brick, finer), (bricks,) = divided(c.V, c.F, grid, [parts])
    assert brick.shape == tuple(n - 1 for n in grid.shape)
    assert len(finer) == 0
    np.testing.assert_array_equal(values[: grid.size].reshape(grid.shape), distance_grid(c.V, c.F, grid))
    # A slow twin: every cell by itself.
    number, within = 0, within_brick(parts, d)
    for cell in np.ndindex(*brick.shape):
        corner = grid.origin + grid.spacing * np.array(cell)
        exact = signed_distance(c.V, c.F, corner + grid.spacing * within / parts)
        if brick[cell] < 0:
            # There is no more than the tip of a corner in it.
            assert not exact.min() < -0.2 * grid.spacing < 0.2 * grid.spacing < exact.max()
            continue
        assert np.abs(exact).min() < grid.spacing / parts * np.sqrt(d) / 2
        assert brick[cell] == number
        number += 1
        fitted = bricks[brick[cell]].ravel()
        assert np.abs(fitted - exact).max() <= grid.spacing / parts / 2 + 1e-12
        assert ((fitted <= 0) == (exact < 0))[np.abs(fitted) > 0].all()
    assert number == len(bricks)
    assert 0 < (brick >= 0).mean() < 1


def within_brick(parts: int, d: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(parts + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)


@pytest.mark.parametrize("d", [2, 3])
def test_cells_of_bricks_are_divided_where_the_surface_is_missed(d: int, characters) -> None:
    c, parts = characters[d], (3, 2)
    grid = Grid.box(c.V, 10)
    x, _ = facet_samples(c.V, c.F, 4000, rng=np.random.default_rng(5))
    missed, counts = [], []
    for share in (1e9, 1, 0.2, 0.0):
        tolerance = share * (missed[0] if missed else 1.0)
        found, bricks = divided(c.V, c.F, grid, parts, tolerance=tolerance)
        finer = found.finer.reshape(-1, *(3,) * d)
        assert len(finer) == len(bricks[0]) == (found.brick >= 0).sum()
        chosen = finer[finer >= 0]
        np.testing.assert_array_equal(chosen, np.arange(len(bricks[1])))
        missed.append(np.abs(read(found, bricks, grid, parts, x)).mean())
        counts.append(len(bricks[1]))
    assert counts[0] == 0
    assert counts[0] < counts[1] < counts[2] < counts[3]
    assert missed[0] > missed[1] > missed[2]
    assert missed[3] < 1.02 * missed[2]  # the last cells that are divided hold the smallest errors
    assert missed[2] < 0.6 * missed[0]


def read(found, bricks, grid: Grid, parts: Sequence[int], x: np.ndarray) -> np.ndarray:
    """Values at points, one after the other: a slow twin of what reads bricks."""
    values = []
    for point in (x - grid.origin) / grid.spacing:
        cell = point.astype(int)
        table, number, cells = found.values[: grid.size].reshape(grid.shape), found.brick[tuple(cell)], 0
        for division, part in enumerate(parts):
            if number < 0:
                break
            point = part * (point - cell)
            table = bricks[division][number]
            cell = np.minimum(point.astype(int), part - 1)
            if division == len(parts) - 1:
                break
            flat = np.ravel_multi_index(tuple(cell), (part,) * len(cell))
            number, cells = (
                found.finer[cells + number * part ** len(cell) + flat],
                cells + len(bricks[division]) * part ** len(cell),
            )
        share = point - cell
        values.append(
            sum(
                table[tuple(cell + corner)] * np.where(corner, share, 1 - share).prod()
                for corner in np.ndindex(*(2,) * len(cell))
            )
        )
    return np.array(values)


@pytest.mark.parametrize("d", [2, 3])
def test_there_are_no_more_values_than_were_asked_for(d: int, characters) -> None:
    c, parts, tolerance = characters[d], (3, 2), 1e-4 * characters[d].L
    grid = Grid.box(c.V, 10)
    x, _ = facet_samples(c.V, c.F, 4000, rng=np.random.default_rng(5))
    whole, bricks = divided(c.V, c.F, grid, parts, tolerance=tolerance)
    least = grid.size + bricks[0].size
    most = least + bricks[1].size // 2
    some, fewer = divided(c.V, c.F, grid, parts, tolerance=tolerance, most=most)
    assert most - 3**d < len(some.values) <= most
    # Half of the bricks correct most of what is missed.
    none, no_bricks = divided(c.V, c.F, grid, parts, tolerance=tolerance, most=0)
    assert len(none.values) == least
    errors = [
        np.abs(read(found, of, grid, parts, x)).mean()
        for found, of in ((none, no_bricks), (some, fewer), (whole, bricks))
    ]
    assert errors[1] - errors[2] < 0.5 * (errors[0] - errors[2])


@pytest.mark.parametrize("d", [2, 3])
def test_between_nodes_distance_is_right_on_average(d: int, rng: np.random.Generator) -> None:
    # A ball that is a few cells thick; its distance is convex everywhere.
    V, F = ball(d)
    grid, parts = Grid([-1.6] * d, 0.4, (9,) * d), 4
    (_, brick, _), (bricks,) = divided(V, F, grid, [parts])
    x = rng.normal(size=(4000, d))
    x *= 0.9995 / np.linalg.norm(x, axis=1, keepdims=True)
    there = brick[tuple(((x - grid.origin) / grid.spacing).astype(int).T)] >= 0
    assert there.mean() > 0.99
    x = x[there]
    cell = ((x - grid.origin) / grid.spacing).astype(int)
    at = parts * ((x - grid.origin) / grid.spacing - cell)
    number = brick[tuple(cell.T)]
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


def test_parts_of_cells_are_at_least_two(characters, rng: np.random.Generator) -> None:
    c = characters[2]
    with pytest.raises(ValueError, match=r"parts must be at least 2, got \[4, 1\]"):
        distance_bricks(c.V, c.F, Grid.box(c.V, 8), parts=[4, 1], tolerance=0.0, most=9, rng=rng)
    whole = distance_bricks(c.V, c.F, Grid.box(c.V, 8), parts=[], tolerance=0.0, most=9, rng=rng)
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
    (_, brick, _), (bricks,) = divided(c.V, F, grid, [6])
    bricks = bricks.reshape(-1, 7**d)
    nodes = grid.origin + grid.spacing * (np.argwhere(brick >= 0)[:, None] + within_brick(6, d) / 6)
    exact = signed_distance(c.V, F, nodes.reshape(-1, d)).reshape(bricks.shape)
    sure = bricks != 0
    assert sure.mean() > 0.9
    np.testing.assert_array_equal((bricks < 0)[sure], (exact < 0)[sure])
    if closed:
        assert sum(computed) < 0.6 * len(np.unique(nodes.reshape(-1, d).round(9), axis=0))
