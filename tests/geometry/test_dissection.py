from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import sparse

from nilbs.geometry.dissection import LEAF, Dissection


def plate(d: int) -> tuple[sparse.csc_matrix, np.ndarray]:
    """Squared Laplacian of a grid in two parts, and its nodes in no order."""
    line = [sparse.diags([1.0, -2, 1], [-1, 0, 1], shape=(n, n)) for n in ((40, 21), (9, 8, 8))[d - 2]]
    L = line[0]
    for axis in line[1:]:
        L = sparse.kronsum(L, axis)
    n = L.shape[0]
    L = sparse.block_diag([L, L])
    V = np.stack(np.unravel_index(np.arange(n), [len(a.toarray()) for a in line[::-1]]), axis=1)
    order = np.random.default_rng(0).permutation(2 * n)
    return (L @ L).tocsc()[order][:, order].tocsc(), np.concatenate([V, V + 50.0])[order]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("b", [1, 2, 37])
def test_a_dense_solver_finds_the_same(d: int, b: int, rng: np.random.Generator) -> None:
    K, V = plate(d)
    assert len(V) > 6 * LEAF
    right, penalty = rng.normal(size=(len(V), b)), rng.uniform(0, 5, len(V))
    given = right.copy()
    with ThreadPoolExecutor(2) as pool:
        dissection = Dissection(K, V, pool)
        for diagonal in (penalty, np.zeros(len(V))):
            found = dissection.solver(diagonal)(right)
            np.testing.assert_allclose(found, np.linalg.solve(K.toarray() + np.diag(diagonal), right), atol=1e-8)
    np.testing.assert_array_equal(right, given)


def test_single_precision_is_near_where_the_diagonal_is_large(rng: np.random.Generator) -> None:
    K, V = plate(3)
    right, penalty = rng.normal(size=(len(V), 5)), 1e-2 * K.diagonal()
    with ThreadPoolExecutor(1) as pool:
        found = Dissection(K, V, pool).solver(penalty, np.float32)(right)
    true = np.linalg.solve(K.toarray() + np.diag(penalty), right)
    error = np.abs(found - true).max() / np.abs(true).max()
    assert 1e-9 < error < 1e-4


def test_the_factors_stay_sparse() -> None:
    K, V = plate(2)
    with ThreadPoolExecutor(1) as pool:
        fronts = Dissection(K, V, pool).fronts
    stored = sum((front.stop - front.start) * (front.stop - front.start + len(front.border)) for front in fronts)
    assert stored < 0.2 * len(V) ** 2


def test_the_number_of_threads_changes_no_digit(rng: np.random.Generator) -> None:
    K, V = plate(2)
    right = rng.normal(size=(len(V), 40))
    found = []
    for threads in (1, 3):
        with ThreadPoolExecutor(threads) as pool:
            found.append(Dissection(K, V, pool).solver(np.ones(len(V)))(right))
    np.testing.assert_array_equal(*found)


def test_one_unknown() -> None:
    with ThreadPoolExecutor(1) as pool:
        one = Dissection(sparse.csc_matrix([[4.0]]), np.zeros((1, 2)), pool)
        np.testing.assert_allclose(one.solver(np.array([1.0]))(np.array([[10.0]])), [[2]])
