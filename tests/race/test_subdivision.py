import numpy as np
import pytest

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.winding import occupancy
from nilbs.race.subdivision import subdivided, subdivided_model


def test_the_surface_and_its_weights_stay(characters):
    c = characters[3]
    V, F, W = subdivided(c.V, c.F, c.W)
    assert len(F) == 4 * len(c.F)
    assert facet_areas(V, F).sum() == pytest.approx(facet_areas(c.V, c.F).sum())
    np.testing.assert_allclose(W.sum(axis=1), 1)
    np.testing.assert_array_equal(V[: len(c.V)], c.V)
    # A closed surface of n vertices, m triangles and 3 m / 2 edges.
    assert len(V) == len(c.V) + 3 * len(c.F) // 2


def test_normals_stay(characters, rng):
    c = characters[3]
    V, F, _ = subdivided(c.V, c.F, c.W)
    x = rng.uniform(c.V.min(axis=0), c.V.max(axis=0), (500, 3))
    np.testing.assert_array_equal(occupancy(V, F, x), occupancy(c.V, c.F, x))
    coarse, fine = (np.linalg.det(U[E]) for U, E in ((c.V, c.F), (V, F)))
    np.testing.assert_allclose(fine.sum(), coarse.sum())  # six times the volume, with its sign


def test_weights_are_linear_on_triangles():
    V, _, W = subdivided(np.eye(3), np.array([[0, 1, 2]]), np.eye(3))
    np.testing.assert_array_equal(V, W)  # both are barycentric coordinates


def test_a_model_keeps_its_answers(models, queries):
    model = models[3]
    fine = subdivided_model(model, 1)
    x, pose = queries(model, 200)
    np.testing.assert_array_equal(fine.occupancy(x, pose), model.occupancy(x, pose))
    assert len(fine.character.F) == 4 * len(model.character.F)
    assert fine.character.L == model.character.L
