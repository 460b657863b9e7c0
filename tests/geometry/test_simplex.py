"""Painted weights are put on the simplex, and every change is noted."""

import numpy as np
import pytest

from nilbs.geometry.simplex import weights_on_simplex


@pytest.fixture
def V(rng):
    return rng.normal(size=(6, 3))


@pytest.fixture
def W(rng):
    return rng.dirichlet(np.ones(3), size=6)


def test_weights_on_the_simplex_stay_without_a_note(W, V):
    result, notes = weights_on_simplex(W, V)
    assert np.abs(result - W).max() <= 1e-15
    assert notes == ()


def test_rows_are_divided_by_their_sums(W, V):
    result, notes = weights_on_simplex(W * [[0.5], [1], [1], [3], [1], [1]], V)
    assert np.abs(result - W).max() <= 1e-15
    assert notes == ("2 of 6 vertices have weights that do not sum to one (0.5 to 3): they are normalised",)


def test_weights_below_zero_count_as_zero(W, V):
    W[2] = [1.5, -0.5, 0]
    W[3] = [0.75, 0.25, -1e-9]  # of rounding: no note
    result, notes = weights_on_simplex(W, V)
    assert result[2].tolist() == [1, 0, 0]
    assert result.min() == 0
    assert notes[0] == "1 of 6 vertices have weights below zero, down to -0.5 at vertex 2: they count as zero"


def test_a_vertex_without_weight_moves_as_its_nearest_neighbour(W, V):
    W[1] = W[4] = 0
    V[1], V[4] = V[0] + 0.01, V[5] - 0.01
    result, notes = weights_on_simplex(W, V, numbers=np.arange(6) + 10)
    assert np.abs(result[[1, 4]] - W[[0, 5]]).max() <= 1e-15
    assert notes == ("2 of 6 vertices have no weight, vertex 11 first: they move as the nearest vertex that has some",)


@pytest.mark.parametrize("scale", [1e-320, 1e-300, 1e300, 1.7e308])
def test_extreme_weights_do_not_overflow(V, scale):
    result, _ = weights_on_simplex(np.full((6, 2), scale), V)
    assert (result == 0.5).all()


@pytest.mark.parametrize("W", [np.zeros((6, 3)), -np.ones((6, 3)), np.zeros((6, 0))])
def test_no_weight_at_all_is_refused(W, V):
    with pytest.raises(ValueError, match="no vertex has any weight"):
        weights_on_simplex(W, V)


def test_sizes_must_agree(W, V):
    with pytest.raises(ValueError, match="V must be"):
        weights_on_simplex(W, V[:5])
