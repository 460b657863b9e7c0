import numpy as np
import pytest

from nilbs.engine.compiled import set_threads
from nilbs.engine.skinning import PIECE, SparseSkinning
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices
from nilbs.geometry.skinning import linear_blend_skinning


def bones(d: int, b: int, rng: np.random.Generator) -> np.ndarray:
    return rigid_transforms(rotation_matrices(rng.uniform(-3, 3, (b, 3 if d == 3 else 1))), rng.normal(size=(b, d)))


def sparse_weights(n: int, b: int, rng: np.random.Generator) -> np.ndarray:
    W = rng.dirichlet(np.ones(b), n) * (rng.uniform(size=(n, b)) < 0.4)
    W[np.arange(n), rng.integers(b, size=n)] += 0.1
    return W / W.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("d", [2, 3])
def test_it_agrees_with_its_twin(d: int, rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(500, d)), sparse_weights(500, 7, rng), bones(d, 7, rng)
    assert 0 < (W == 0).mean() < 1
    U = SparseSkinning(V, W).posed(B)
    assert np.abs(U - V).max() > 1
    np.testing.assert_allclose(U, linear_blend_skinning(V, W, B), rtol=0, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_any_transforms_and_weights_that_sum_to_anything(d: int, rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(50, d)), rng.normal(size=(50, 4)), rng.normal(size=(4, d + 1, d + 1))
    W[7] = 0
    np.testing.assert_allclose(SparseSkinning(V, W).posed(B), linear_blend_skinning(V, W, B), rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2])
def test_pieces_and_threads_change_nothing(count: int, rng: np.random.Generator, monkeypatch) -> None:
    n = 2 * PIECE + 3
    V, W, B = rng.normal(size=(n, 3)), sparse_weights(n, 3, rng), bones(3, 3, rng)
    skinning = SparseSkinning(V, W)
    set_threads(count)
    try:
        U = skinning.posed(B)
    finally:
        set_threads(None)
    np.testing.assert_allclose(U, linear_blend_skinning(V, W, B), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(
        U[PIECE - 5 : PIECE + 5], SparseSkinning(V[PIECE - 5 :], W[PIECE - 5 :]).posed(B)[:10]
    )


def test_the_arguments_are_copied_and_a_pose_keeps_nothing(rng: np.random.Generator) -> None:
    V, W = rng.normal(size=(20, 3)), sparse_weights(20, 3, rng)
    skinning, first, second = SparseSkinning(V, W), bones(3, 3, rng), bones(3, 3, rng)
    U = skinning.posed(first)
    W[:] = 1
    other = skinning.posed(second)
    assert np.abs(other - U).max() > 0.1
    np.testing.assert_array_equal(skinning.posed(first), U)


def test_no_points() -> None:
    assert SparseSkinning(np.empty((0, 2)), np.empty((0, 3))).posed(np.zeros((3, 3, 3))).shape == (0, 2)


def test_a_wrong_shape_is_named() -> None:
    with pytest.raises(ValueError, match=r"W must be \(n, b\) = \(2, b\), got \(3, 1\)"):
        SparseSkinning(np.zeros((2, 3)), np.ones((3, 1)))
    with pytest.raises(ValueError, match=r"B must be \(1, 4, 4\), got \(2, 4, 4\)"):
        SparseSkinning(np.zeros((2, 3)), np.ones((2, 1))).posed(np.zeros((2, 4, 4)))
