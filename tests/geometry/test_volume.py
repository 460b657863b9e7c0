import itertools

import numpy as np
import pytest

from nilbs.geometry.volume import boundary_facets, element_volumes


def block(d: int, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """The unit square or cube in positively oriented simplices: each cell along its diagonal (Kuhn)."""
    index = np.stack(np.meshgrid(*[np.arange(cells + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    place = np.arange(len(index)).reshape((cells + 1,) * d)
    T = []
    for corner in itertools.product(range(cells), repeat=d):
        for axes in itertools.permutations(range(d)):
            walk = [np.array(corner)]
            for axis in axes:
                walk.append(walk[-1] + np.eye(d, dtype=int)[axis])
            T.append([place[tuple(node)] for node in walk])
    V, T = index / cells, np.array(T)
    return V, np.where((np.linalg.det(V[T[:, 1:]] - V[T[:, :1]]) < 0)[:, None], T[:, [1, 0, *range(2, d + 1)]], T)


def test_a_right_triangle_and_a_corner_of_a_cube() -> None:
    np.testing.assert_allclose(element_volumes([[0, 0], [2, 0], [0, 3]], [[0, 1, 2], [0, 2, 1]]), [3, -3])
    V = [[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]]
    np.testing.assert_allclose(element_volumes(V, [[0, 1, 2, 3], [1, 0, 2, 3]]), [5, -5])


@pytest.mark.parametrize("d", [2, 3])
def test_volumes_grow_with_the_power_d_and_do_not_move(d: int, rng: np.random.Generator) -> None:
    V, T = rng.normal(size=(9, d)), rng.integers(0, 9, (20, d + 1))
    np.testing.assert_allclose(element_volumes(7 * V + 3, T), 7**d * element_volumes(V, T), atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_parts_of_a_block_sum_to_it_and_its_boundary_closes_around_it(d: int, rng: np.random.Generator) -> None:
    V, T = block(d, 3)
    inside = ((V > 0) & (V < 1)).all(axis=1)
    V = V + 0.05 * rng.uniform(-1, 1, V.shape) * inside[:, None]
    assert element_volumes(V, T).min() > 0
    np.testing.assert_allclose(element_volumes(V, T).sum(), 1)
    F = boundary_facets(T)
    assert len(F) == (4 * 3 if d == 2 else 6 * 9 * 2)
    # Every facet lies in one side of the block, and turns such that the block lies behind it (divergence theorem).
    corners = V[F]
    assert ((corners == 0).all(axis=1) | (corners == 1).all(axis=1)).any(axis=1).all()
    away = V.mean(axis=0) - 10
    cones = np.concatenate([F, np.full((len(F), 1), len(V))], axis=1)
    np.testing.assert_allclose(element_volumes(np.concatenate([V, [away]]), cones).sum() * (-1) ** d, 1)


@pytest.mark.parametrize("d", [2, 3])
def test_the_boundary_of_one_element_looks_away_from_it(d: int) -> None:
    V = np.concatenate([np.zeros((1, d)), np.eye(d)])
    (element,) = T = np.arange(d + 1)[None]
    F = boundary_facets(T)
    assert len(F) == d + 1
    for facet in F:
        (opposite,) = set(element) - set(facet)
        if d == 2:
            a, b, c = *V[facet], V[opposite]
            assert np.linalg.det([b - a, c - a]) > 0  # the inside is on the left
        else:
            a, b, c = V[facet]
            assert np.cross(b - a, c - a) @ (V[opposite] - a) < 0


def test_an_edge_is_shared_whichever_way_it_runs() -> None:
    assert boundary_facets([[0, 1, 2], [2, 1, 3]]).tolist() == [[0, 1], [2, 0], [1, 3], [3, 2]]


@pytest.mark.parametrize("d", [2, 3])
def test_no_elements(d: int) -> None:
    T = np.zeros((0, d + 1), dtype=int)
    assert element_volumes(np.zeros((0, d)), T).shape == (0,)
    assert boundary_facets(T).shape == (0, d)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^T must be \(t, d\+1\) = \(1, 3\), got \(1, 4\)$"):
        element_volumes(np.zeros((4, 2)), [[0, 1, 2, 3]])
    with pytest.raises(ValueError, match=r"^T\[0\] = \[0, 1, 4\] does not index the 4 vertices$"):
        element_volumes(np.zeros((4, 2)), [[0, 1, 4]])
    with pytest.raises(ValueError, match="d must be 2 or 3"):
        boundary_facets([[0, 1]])
