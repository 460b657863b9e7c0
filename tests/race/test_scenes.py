import numpy as np
import pytest

from nilbs.geometry.distance import signed_distance
from nilbs.methods.base import NOISE
from nilbs.race import scenes as module
from nilbs.race.scenes import Scene, Truth, scenes


def test_points_near_the_surface_are_as_near_as_in_scores(models):
    model = models[3]
    (scene,) = scenes(model, 4000, "near", 1, 0, 1, seed=0)
    distance = signed_distance(model.character.skin(scene.B), model.character.F, scene.x)
    assert np.sqrt((distance**2).mean()) / model.character.L == pytest.approx(NOISE, rel=0.1)


def test_uniform_points_fill_a_cube(models):
    (scene,) = scenes(models[3], 4000, "uniform", 1, 0, 1, seed=0)
    edges = np.ptp(scene.x, axis=0)
    assert edges.min() > 0.99 * edges.max()


def test_blocks_of_a_stream_follow_each_other(models):
    model = models[3]
    whole = scenes(model, 5, "near", 6, 0, 1, seed=0)
    blocks = [scene for k in range(3) for scene in scenes(model, 5, "near", 2, k, 3, seed=0)]
    for one, other in zip(whole, blocks, strict=True):
        np.testing.assert_array_equal(one.B, other.B)
        np.testing.assert_array_equal(one.x, other.x)
    assert not np.allclose(whole[0].B, whole[1].B)


def test_truth_scores_itself_perfectly(models):
    model = models[3]
    (scene,) = scenes(model, 500, "near", 1, 0, 1, seed=0)
    U, F = model.character.skin(scene.B), model.character.F
    distance = signed_distance(U, F, scene.x)
    truth = Truth(model, scene)
    assert truth.scores("occupancy", distance < 0) == {"differing": 0.0, "iou": 1.0}
    perfect = truth.scores("distance", distance)
    assert (perfect["differing"], perfect["iou"]) == (0, 1)
    assert perfect["error_max"] < 1e-9


def test_scores_of_a_wrong_answer(models):
    model = models[3]
    (scene,) = scenes(model, 500, "near", 1, 0, 1, seed=0)
    distance = signed_distance(model.character.skin(scene.B), model.character.F, scene.x)
    truth, L = Truth(model, scene), model.character.L
    assert truth.scores("occupancy", distance >= 0)["differing"] == 1
    far = truth.scores("distance", distance + np.where(distance < 0, -0.25, 0.25) * L)
    assert far["differing"] == 0
    assert far["error_median"] == pytest.approx(0.25)
    assert far["error_max"] == pytest.approx(0.25)


def test_scores_are_of_the_first_points(models, monkeypatch):
    monkeypatch.setattr(module, "SCORED", 10)
    model = models[3]
    (scene,) = scenes(model, 50, "near", 1, 0, 1, seed=0)
    truth = Truth(model, scene)
    answer = np.concatenate([truth.inside, np.ones(40, dtype=bool)])
    assert truth.scores("occupancy", answer)["differing"] == 0


def test_a_winding_number_close_to_one_half_is_evaluated_again(models, monkeypatch):
    model = models[3]
    (scene,) = scenes(model, 100, "uniform", 1, 0, 1, seed=0)
    right = Truth(model, scene).inside
    exact = module.winding_number

    def vague(U, F, x, *, exact=False, known=exact):
        return known(U, F, x, exact=True) if exact else np.full(len(x), 0.51)

    monkeypatch.setattr(module, "winding_number", vague)
    np.testing.assert_array_equal(Truth(model, Scene(*scene)).inside, right)
