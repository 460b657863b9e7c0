import numpy as np
import pytest
from scipy.spatial import Delaunay

from nilbs.geometry.triangles import conforming_triangles
from nilbs.geometry.volume import boundary_facets, element_volumes

# A comb with two teeth: a shape that is not convex.
COMB = np.array([[0, 0], [4, 0], [4, 3], [3, 3], [3, 1], [1, 1], [1, 3], [0, 3.0]])
COMB_T = np.array([[5, 7, 0], [5, 6, 7], [5, 0, 1], [5, 1, 4], [4, 1, 2], [4, 2, 3]])
NO_POINTS = np.zeros((0, 2))


def assert_sound(V: np.ndarray, T: np.ndarray, V2: np.ndarray, T2: np.ndarray) -> None:
    """Check what holds for every refinement: first vertices, orientation, area, outline, Delaunay inside."""
    np.testing.assert_array_equal(V2[: len(V)], V)
    used = V2[np.unique(T2)]
    assert len(np.unique(used, axis=0)) == len(used)
    area = element_volumes(V2, T2)
    assert area.min() > 0
    np.testing.assert_allclose(area.sum(), np.abs(element_volumes(V, T)).sum(), rtol=1e-9)
    opposite = {}
    for triangle in T2.tolist():
        for k in range(3):
            edge = triangle[k], triangle[(k + 1) % 3]
            assert edge not in opposite
            opposite[edge] = triangle[(k + 2) % 3]
    size = np.ptp(V, axis=0).max()
    for (a, b), c in opposite.items():
        if (b, a) in opposite:
            assert in_circle(V2[[a, b, c]] / size, V2[opposite[b, a]] / size) < 1e-8


def in_circle(triangle: np.ndarray, point: np.ndarray) -> float:
    """How deep a point lies inside a circumcircle, in units of its radius."""
    a, b, c = triangle
    center = a + np.linalg.solve(2 * np.stack([b - a, c - a]), [(b - a) @ (b - a), (c - a) @ (c - a)])
    radius = np.linalg.norm(a - center)
    return (radius - np.linalg.norm(point - center)) / radius


def test_a_long_diagonal_is_flipped() -> None:
    V, T = np.array([[0, 0], [2, -0.3], [4, 0], [2, 0.3]]), np.array([[0, 1, 2], [0, 2, 3]])
    V2, T2 = conforming_triangles(V, T, NO_POINTS, spacing=10.0)
    assert_sound(V, T, V2, T2)
    assert {frozenset(t) for t in T2.tolist()} == {frozenset((0, 1, 3)), frozenset((1, 2, 3))}


def test_the_outline_stays_edge_by_edge() -> None:
    V2, T2 = conforming_triangles(COMB, COMB_T, NO_POINTS, spacing=10.0)
    np.testing.assert_array_equal(V2, COMB)
    assert_sound(COMB, COMB_T, V2, T2)
    assert {frozenset(e) for e in boundary_facets(T2)} == {frozenset((k, (k + 1) % 8)) for k in range(8)}


@pytest.mark.parametrize("spacing", [0.05, 0.03])
def test_points_become_vertices_and_nothing_inside_is_far_from_one(spacing: float, rng: np.random.Generator) -> None:
    points = np.stack([np.linspace(0.5, 0.3, 9), np.linspace(2.5, 1.2, 9)], axis=1)
    V2, T2 = conforming_triangles(COMB, COMB_T, points, spacing=spacing)
    assert_sound(COMB, COMB_T, V2, T2)
    np.testing.assert_array_equal(V2[8:17], points)
    # No point is further than 0.58 steps from a hexagonal grid; grid points nearer than 0.7 to a vertex are left out.
    step = spacing * np.hypot(4, 3)
    x = rng.uniform([step, step], [4 - step, 1 - step], (500, 2))
    distance = np.linalg.norm(x[:, None] - V2, axis=2).min(axis=1)
    assert 0.5 * step < distance.max() < 1.28 * step
    new = V2[17:]
    assert np.linalg.norm(new[:, None] - V2, axis=2)[:, : len(V2) - len(new)].min() > 0.7 * step


def test_a_convex_shape_agrees_with_another_delaunay_triangulation(rng: np.random.Generator) -> None:
    angle = np.sort(rng.uniform(0, 2 * np.pi, 17))
    V = np.stack([np.cos(angle), np.sin(angle)], axis=1) * [2, 1]
    fan = np.array([[0, k, k + 1] for k in range(1, 16)])
    x = rng.uniform(-0.5, 0.5, (20, 2))
    V2, T2 = conforming_triangles(V, fan, x, spacing=10.0)
    other = Delaunay(V2).simplices
    assert {frozenset(t) for t in T2.tolist()} == {frozenset(t) for t in other.tolist()}


def test_orientation_of_the_input_does_not_matter(rng: np.random.Generator) -> None:
    turned = COMB_T.copy()
    turned[::2] = turned[::2, ::-1]
    points = np.stack([np.linspace(0.5, 3.5, 5), np.full(5, 0.5)], axis=1)
    V2, T2 = conforming_triangles(COMB, turned, points, spacing=0.2)
    assert_sound(COMB, turned, V2, T2)
    V3, T3 = conforming_triangles(COMB[::-1], 7 - COMB_T, points, spacing=0.2)
    assert len(V3) == len(V2)
    np.testing.assert_allclose(element_volumes(V3, T3).sum(), element_volumes(V2, T2).sum())


def test_degenerate_triangles_and_loose_vertices_are_left_out_and_keep_their_numbers() -> None:
    V = np.concatenate([COMB, [[2.0, 0.5]]])  # a vertex that no triangle uses
    T = np.concatenate([COMB_T, [[0, 0, 1], [1, 1, 1], [7, 0, 7]]])
    V2, T2 = conforming_triangles(V, T, [[1.5, 0.5], [2.5, 0.5], [2.0, 0.5]], spacing=10.0)
    assert_sound(V, T, V2, T2)
    assert len(V2) == 12
    # The last point is the place of the loose vertex; the mesh holds it, too.
    assert np.linalg.norm(V2[np.unique(T2)] - [2.0, 0.5], axis=1).min() < 1e-12


def test_points_on_edges_on_the_outline_on_vertices_and_outside() -> None:
    V, T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    on_diagonal, on_outline, on_vertex, outside = [0.3, 0.3], [0.5, 0.0], [1.0, 1.0], [2.0, 0.2]
    V2, T2 = conforming_triangles(V, T, [on_diagonal, on_outline, on_vertex, outside], spacing=10.0)
    assert_sound(V, T, V2, T2)
    np.testing.assert_array_equal(V2[4:], [on_diagonal, on_outline])
    outline = boundary_facets(T2)
    assert len(outline) == 5
    assert (V2[outline].min(axis=(0, 1)) == 0).all()


def test_many_points_make_the_arrays_grow(rng: np.random.Generator) -> None:
    V, T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    V2, T2 = conforming_triangles(V, T, rng.uniform(0.05, 0.95, (90, 2)), spacing=10.0)
    assert len(V2) == 94
    assert_sound(V, T, V2, T2)


@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0.0), (1e9, 0.0), (1.0, 1e4)])
def test_neither_unit_nor_place_changes_the_mesh(scale: float, shift: float) -> None:
    points = np.array([[0.5, 2.5], [0.505, 1.51], [0.51, 0.52], [2.005, 0.51], [3.5, 0.5]])
    V2, _ = conforming_triangles(COMB, COMB_T, points, spacing=0.15)
    V3, T3 = conforming_triangles(scale * COMB + shift, COMB_T, scale * points + shift, spacing=0.15)
    assert_sound(scale * COMB + shift, COMB_T, V3, T3)
    # Points on a common circle may be joined either way, so only the vertices are the same.
    np.testing.assert_allclose((V3 - shift) / scale, V2, atol=1e-10)


def test_two_pieces_and_a_hole_are_kept_apart() -> None:
    square = np.array([[0, 0], [3, 0], [3, 3], [0, 3.0]])
    V = np.concatenate([square, square / 3 + 1, square + 5])
    ring = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    T = np.array([*ring, [8, 9, 10], [8, 10, 11]])
    V2, T2 = conforming_triangles(V, T, [[0.5, 0.5], [1.5, 0.4], [2.5, 0.5]], spacing=0.1)
    assert_sound(V, T, V2, T2)
    centers = V2[T2].mean(axis=1)
    assert not ((centers > 1) & (centers < 2)).all(axis=1).any()


def test_no_triangles() -> None:
    V2, T2 = conforming_triangles(np.zeros((0, 2)), np.zeros((0, 3)), NO_POINTS)
    assert V2.shape == (0, 2)
    assert T2.shape == (0, 3)
    V2, T2 = conforming_triangles(COMB, np.zeros((0, 3)), [[1, 1], [2, 2]])
    np.testing.assert_array_equal(V2, COMB)
    assert T2.shape == (0, 3)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^V must be \(n, 2\).*got \(4, 3\)$"):
        conforming_triangles(np.zeros((4, 3)), [[0, 1, 2]], NO_POINTS)
    with pytest.raises(ValueError, match=r"^T\[0\] = \[0, 1, 8\] does not index the 8 vertices$"):
        conforming_triangles(COMB, [[0, 1, 8]], NO_POINTS)
    with pytest.raises(ValueError, match=r"^points must be \(s, 2\).*got \(2, 3\)$"):
        conforming_triangles(COMB, COMB_T, np.zeros((2, 3)))
