import numpy as np
import pytest

from nilbs.geometry.facets import components, facet_areas, facet_normals, is_watertight, seamless

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def square() -> tuple[np.ndarray, np.ndarray]:
    return np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


def test_areas_and_normals_of_a_tetrahedron() -> None:
    np.testing.assert_allclose(facet_areas(CORNERS, TETRAHEDRON), [0.5, 0.5, 0.5, np.sqrt(3) / 2])
    third = 1 / np.sqrt(3)
    outward = [[0, 0, -1], [0, -1, 0], [-1, 0, 0], [third, third, third]]
    np.testing.assert_allclose(facet_normals(CORNERS, TETRAHEDRON), outward)


def test_lengths_and_normals_of_a_square() -> None:
    V, F = square()
    np.testing.assert_array_equal(facet_areas(V, F), 2.0)
    np.testing.assert_array_equal(facet_normals(V, F), [[0, -1], [1, 0], [0, 1], [-1, 0]])


@pytest.mark.parametrize("d", [2, 3])
def test_area_vectors_of_a_closed_surface_sum_to_zero(d: int, rng: np.random.Generator) -> None:
    V, F = square() if d == 2 else (CORNERS, TETRAHEDRON)
    V = V + 0.1 * rng.normal(size=V.shape)
    total = facet_areas(V, F) @ facet_normals(V, F)
    np.testing.assert_allclose(total, 0, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_a_facet_without_area_has_no_normal(d: int) -> None:
    V, F = np.ones((3, d)), np.arange(d)[None]
    np.testing.assert_array_equal(facet_areas(V, F), [0])
    np.testing.assert_array_equal(facet_normals(V, F), np.zeros((1, d)))


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets(d: int) -> None:
    V, F = np.empty((0, d)), np.empty((0, d), dtype=int)
    assert facet_areas(V, F).shape == (0,)
    assert facet_normals(V, F).shape == (0, d)
    assert components(F, 0) == 0
    assert components(F, 4) == 0
    assert is_watertight(F)


@pytest.mark.parametrize("F", [square()[1], TETRAHEDRON], ids=["2D", "3D"])
def test_pieces_are_counted_whatever_the_order(F: np.ndarray, rng: np.random.Generator) -> None:
    many = np.concatenate([F + 4 * k for k in range(5)])
    number = rng.permutation(30)
    assert components(rng.permutation(number[many]), 30) == 5


def test_two_triangles_that_touch_at_a_vertex_are_one_piece() -> None:
    assert components([[0, 1, 2], [2, 3, 4]], 5) == 1


@pytest.mark.parametrize("F", [square()[1], TETRAHEDRON], ids=["2D", "3D"])
def test_closed_oriented_surfaces_are_watertight(F: np.ndarray) -> None:
    flipped = F.copy()
    flipped[0] = flipped[0, ::-1]
    assert is_watertight(F)
    assert is_watertight(F[:, ::-1])
    assert is_watertight(np.concatenate([F, F + 4]))
    assert not is_watertight(F[1:]), "a hole"
    assert not is_watertight(flipped), "one facet inside out"
    assert not is_watertight(np.concatenate([F, F])), "every facet twice"


def test_two_tetrahedra_on_one_edge_are_not_manifold() -> None:
    assert not is_watertight(np.concatenate([TETRAHEDRON, np.array([0, 1, 4, 5])[TETRAHEDRON]]))


@pytest.mark.parametrize("F", [[[1, 1]], [[0, 0, 1], [0, 1, 0]]], ids=["2D", "3D"])
def test_a_facet_that_repeats_a_vertex_is_not_watertight(F: list) -> None:
    assert not is_watertight(F)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=r"F\[0\] = \[0, 4\] does not index the 4 vertices"):
        facet_areas(square()[0], [[0, 4]])
    with pytest.raises(ValueError, match=r"F must be \(m, d\) = .*, got \(4, 3\)"):
        facet_normals(square()[0], TETRAHEDRON)
    with pytest.raises(ValueError, match="does not index the 3 vertices"):
        components(TETRAHEDRON, 3)
    with pytest.raises(ValueError, match="does not index"):
        is_watertight([[0, -1]])


def test_facets_share_the_first_vertex_that_is_used_at_each_place() -> None:
    V = [[1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0], [1, -0.0, 0], [1, 1, 0], [0, 1, 0]]
    np.testing.assert_array_equal(seamless(V, [[1, 2, 3], [4, 5, 6]]), [[1, 2, 3], [2, 5, 3]])
    assert seamless(V, np.zeros((0, 3), int)).shape == (0, 3)
    with pytest.raises(ValueError, match=r"\[7, 1, 2\] does not index the 7 vertices"):
        seamless(V, [[7, 1, 2]])
