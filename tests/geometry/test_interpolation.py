import numpy as np
import pytest
from scipy.spatial import Delaunay

from nilbs.geometry.interpolation import facet_values, surface_interpolation, volume_interpolation
from nilbs.geometry.sampling import element_samples, facet_samples
from nilbs.geometry.volume import boundary_facets, element_volumes

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def block(d: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A cube filled with irregular elements."""
    corners = np.array(list(np.ndindex(*(2,) * d)), dtype=float)
    V = np.concatenate([corners, rng.uniform(0.1, 0.9, (30, d))])
    T = Delaunay(V).simplices.astype(np.int64)
    turned = element_volumes(V, T) < 0
    T[turned] = T[turned][:, [1, 0, *range(2, d + 1)]]
    return V, T[np.abs(element_volumes(V, T)) > 1e-12]


def linear(x: np.ndarray) -> np.ndarray:
    """Two linear functions."""
    slopes = np.array([[1.0, -2.0], [0.5, 3.0], [-0.25, 1.0]])[: x.shape[1]]
    return x @ slopes + [0.3, -7]


@DIMENSIONS
def test_linear_functions_are_reproduced_inside(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    x, _, _ = element_samples(V, T, 400, rng=rng)
    np.testing.assert_allclose(volume_interpolation(V, T, linear(V), x), linear(x), atol=1e-9)
    np.testing.assert_allclose(volume_interpolation(V, T, linear(V), V), linear(V), atol=1e-9)


@DIMENSIONS
def test_linear_functions_are_reproduced_on_a_surface(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    F = boundary_facets(T)
    x, facet = facet_samples(V, F, 300, rng=rng)
    np.testing.assert_allclose(facet_values(V, F, linear(V), x, facet), linear(x), atol=1e-9)
    np.testing.assert_allclose(surface_interpolation(V, F, linear(V), x), linear(x), atol=1e-9)


@DIMENSIONS
def test_a_point_outside_has_the_value_of_the_closest_place(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    x = rng.uniform(-2, 3, (500, d))
    # In a cube that is the point with clipped coordinates.
    closest = linear(np.clip(x, 0, 1))
    np.testing.assert_allclose(volume_interpolation(V, T, linear(V), x), closest, atol=1e-6)
    outside = ((x < 0) | (x > 1)).any(axis=1)
    assert 100 < outside.sum() < 500
    surface = surface_interpolation(V, boundary_facets(T), linear(V), x[outside])
    np.testing.assert_allclose(surface, closest[outside], atol=1e-6)


@DIMENSIONS
def test_a_value_in_an_element_is_that_of_its_corners_alone(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    values = rng.normal(size=(len(V), 3))
    x, element, barycentric = element_samples(V, T, 200, rng=rng)
    slow = np.array([b @ values[T[e]] for e, b in zip(element, barycentric, strict=True)])
    np.testing.assert_allclose(volume_interpolation(V, T, values, x), slow, atol=1e-8)


@DIMENSIONS
def test_values_stay_between_those_of_the_vertices(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    values = np.stack([np.zeros(len(V)), np.ones(len(V)), rng.choice([0.0, 1.0], len(V))], axis=1)
    x = np.concatenate([V, rng.uniform(-1, 2, (300, d)), V[T].mean(axis=1), V[T[:, :2]].mean(axis=1)])
    found = volume_interpolation(V, T, values, x)
    np.testing.assert_array_equal(found[:, 0], 0)
    np.testing.assert_allclose(found[:, 1], 1, atol=1e-15)
    assert found.min() >= 0
    assert found.max() <= 1 + 1e-15


@DIMENSIONS
@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0), (1e9, 0), (1, 1e5)])
def test_neither_unit_nor_place_changes_the_values(
    d: int, scale: float, shift: float, rng: np.random.Generator
) -> None:
    V, T = block(d, rng)
    x = rng.uniform(-0.5, 1.5, (200, d))
    there = volume_interpolation(scale * V + shift, T, linear(V), scale * x + shift)
    np.testing.assert_allclose(there, volume_interpolation(V, T, linear(V), x), atol=1e-5)


def test_overlapping_and_turned_triangles_in_the_plane() -> None:
    V, T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), [[0, 1, 2], [0, 3, 2], [0, 1, 3]]
    x = np.random.default_rng(0).uniform(size=(100, 2))
    np.testing.assert_allclose(volume_interpolation(V, T, linear(V), x), linear(x), atol=1e-9)


@DIMENSIONS
def test_facets_without_area_give_a_value_of_their_corners(d: int) -> None:
    # All corners in one place, and all on a line with the point between.
    V = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 0, 0], [2, 0, 0]])[:, :d]
    values = np.array([[0.0], [1.0], [2.0], [2.0], [2.0]])
    F = np.array([[2, 3, 4], [0, 1, 2]])[:, :d]
    found = facet_values(V, F, values, np.array([[2, 0, 0], [0.5, 0, 0]])[:, :d], [0, 1])
    assert found[0, 0] == pytest.approx(2)
    assert 0 <= found[1, 0] <= 2
    np.testing.assert_allclose(surface_interpolation(V, F[:1], values, np.ones((1, d))), 2)


@DIMENSIONS
def test_no_points_and_no_values(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, rng)
    assert volume_interpolation(V, T, linear(V), np.zeros((0, d))).shape == (0, 2)
    assert surface_interpolation(V, boundary_facets(T), linear(V), np.zeros((0, d))).shape == (0, 2)


@DIMENSIONS
def test_wrong_arguments_are_refused(d: int) -> None:
    V, values = np.eye(d + 1)[:, :d], np.ones((d + 1, 1))
    T, F = np.arange(d + 1)[None], np.arange(d)[None]
    x = np.zeros((1, d))
    for call, message in (
        (lambda: volume_interpolation(V, T[:0], values, x), "^a volume mesh without elements has no values$"),
        (lambda: surface_interpolation(V, F[:0], values, x), "^a surface without facets has no values$"),
        (lambda: volume_interpolation(V, T + 1, values, x), r"^T\[0\] = .* does not index"),
        (lambda: surface_interpolation(V, F + 2, values, x), r"^F\[0\] = .* does not index"),
        (lambda: facet_values(V, F, values, x, [1]), r"^facet\[0\] = 1 does not index the 1 facets$"),
        (lambda: facet_values(V, F, values, x, [0, 0]), r"^facet must be \(p,\) = \(1,\), got \(2,\)$"),
        (lambda: facet_values(V, F, values, x[:, :1], [0]), r"^x must be \(p, d\)"),
        (lambda: volume_interpolation(V, T, values[1:], x), r"^values must be \(n, k\)"),
        (lambda: volume_interpolation(V, T, values, np.full((1, d), np.inf)), r"^x\[0, 0\] is inf"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
