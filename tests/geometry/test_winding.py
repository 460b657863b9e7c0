from pathlib import Path

import numpy as np
import pytest

from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.winding import occupancy, winding_number


def ball(d: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A polygon or polyhedron with its corners on the circle or sphere."""
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 24)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)
    return radius * V / np.linalg.norm(V, axis=1, keepdims=True), F


def angle_sum(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> float:
    """Winding number of a curve around one point, edge by edge."""
    total = 0.0
    for i, j in F:
        a, b = V[i] - x, V[j] - x
        total += np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
    return total / (2 * np.pi)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_one_inside_a_ball_and_zero_outside(d: int, exact: bool, rng: np.random.Generator) -> None:
    V, F = ball(d)
    x = rng.normal(size=(500, d))
    radius = np.linalg.norm(x, axis=1)
    x = x[np.abs(radius - 1) > 0.05]
    w = winding_number(V, F, x, exact=exact)
    np.testing.assert_allclose(w, np.linalg.norm(x, axis=1) < 1, atol=1e-12 if exact else 0.01)


def test_a_curve_agrees_with_the_sum_of_angles(rng: np.random.Generator) -> None:
    # Random edges: crossings, loose ends, vertices with several edges.
    V, F = rng.normal(size=(9, 2)), rng.integers(0, 9, (14, 2))
    x = rng.normal(size=(200, 2))
    np.testing.assert_allclose(winding_number(V, F, x), [angle_sum(V, F, point) for point in x], atol=1e-12)


def test_points_level_with_vertices_count_every_crossing_once() -> None:
    V, F = np.array([[0, 0], [1, -1], [2, 0], [1, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    x = [[1, 0], [0.5, 0], [-1, 0], [3, 0], [0, 1], [2, 1], [0, -1], [2, -1]]
    np.testing.assert_array_equal(winding_number(V, F, x), [1, 1, 0, 0, 0, 0, 0, 0])


def test_half_a_circle_seen_from_its_centre() -> None:
    angle = np.linspace(0, np.pi, 7)
    V, F = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([np.arange(6), np.arange(1, 7)], axis=1)
    np.testing.assert_allclose(np.abs(winding_number(V, F, [[0.0, 1e-9]])), 0.5, atol=1e-8)


def test_one_face_of_a_cube_is_a_sixth_of_the_view() -> None:
    V, F = [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]], [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(winding_number(V, F, [[0, 0, 0]], exact=True), [1 / 6])


@pytest.mark.parametrize("d", [2, 3])
def test_covered_twice_counts_two_and_is_inside(d: int) -> None:
    V, F = ball(d)
    V, F = np.concatenate([V, V + 0.5]), np.concatenate([F, F + len(V)])
    x = np.array([[0.25], [-0.3], [0.8], [1.6]]) * np.ones(d) / np.sqrt(d / 2)
    np.testing.assert_allclose(winding_number(V, F, x)[[0, 1, 3]], [2, 1, 0], atol=0.01)
    np.testing.assert_array_equal(occupancy(V, F, x), [True, True, True, False])


@pytest.mark.parametrize("d", [2, 3])
def test_inside_out_is_minus_one_and_still_inside(d: int) -> None:
    V, F = ball(d)
    np.testing.assert_allclose(winding_number(V, F[:, ::-1], np.zeros((1, d))), [-1], atol=0.01)
    assert occupancy(V, F[:, ::-1], np.zeros((1, d))).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1.0, 1e7), (1e6, -1e9)])
def test_scale_and_place_of_the_world_do_not_matter(
    d: int, scale: float, shift: float, rng: np.random.Generator
) -> None:
    V, F = ball(d)
    x = rng.uniform(-1.2, 1.2, (2000, d))
    x = x[np.abs(np.linalg.norm(x, axis=1) - 1) > 0.03]
    truth = np.linalg.norm(x, axis=1) < 1
    np.testing.assert_array_equal(occupancy(scale * V + shift, F, scale * x + shift), truth)


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets_and_no_points(d: int) -> None:
    V, F = ball(d)
    empty = np.empty((0, d), dtype=int)
    np.testing.assert_array_equal(winding_number(np.empty((0, d)), empty, V[:3]), np.zeros(3))
    assert not occupancy(V, empty, V[:3]).any()
    assert winding_number(V, F, np.empty((0, d))).shape == (0,)
    assert occupancy(V, F, np.empty((0, d))).dtype == bool


@pytest.mark.parametrize("d", [2, 3])
def test_facets_shrunk_to_a_point_are_seen_from_nowhere(d: int) -> None:
    np.testing.assert_array_equal(winding_number(np.ones((d, d)), np.arange(d)[None], np.zeros((2, d))), [0, 0])


def test_wrong_arguments_are_named() -> None:
    V, F = ball(3)
    with pytest.raises(ValueError, match=r"x must be \(p, d\) = .*, got \(4, 2\)"):
        occupancy(V, F, np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"F.*does not index"):
        occupancy(V, F + 1, np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"x.*finite"):
        winding_number(V, F, [[0, np.nan, 0]])


def test_tree_and_sum_agree_on_an_elephant(data: Path, rng: np.random.Generator) -> None:
    import igl

    V, F = igl.read_triangle_mesh(str(data / "elephant" / "elephant.obj"))
    x = V[rng.integers(0, len(V), 1000)] + 0.01 * np.ptp(V, axis=0).max() * rng.normal(size=(1000, 3))
    exact = winding_number(V, F, x, exact=True)
    np.testing.assert_allclose(winding_number(V, F, x), exact, atol=0.01)
    np.testing.assert_array_equal(occupancy(V, F, x), exact > 0.5)
