import numpy as np
import pytest

from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.metrics import intersection_over_union, surface_scores

LENGTHS = ("chamfer_l1", "chamfer_l1_sampled", "hausdorff", "p95")


def ball(d: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners on a circle or sphere, fine enough that facets pass within a thousandth of it."""
    grid = Grid([-1.2] * d, 0.05 if d == 3 else 0.02, (49 if d == 3 else 121,) * d)
    V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 1, grid)
    return radius * V / np.linalg.norm(V, axis=1, keepdims=True), F


def test_intersection_over_union() -> None:
    true = np.array([True, True, True, False, False])
    assert intersection_over_union(true, true) == 1
    assert intersection_over_union(~true, true) == 0
    assert intersection_over_union(np.zeros(5, dtype=bool), true) == 0
    assert intersection_over_union([True, False, False, True, False], true) == 0.25
    assert isinstance(intersection_over_union(true, true), float)


@pytest.mark.parametrize("n", [0, 4])
def test_two_empty_sets_agree(n: int) -> None:
    assert intersection_over_union(np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)) == 1


@pytest.mark.parametrize("d", [2, 3])
def test_a_surface_agrees_with_itself(d: int, rng: np.random.Generator) -> None:
    V, F = ball(d, 3.0)
    scores = surface_scores(V, F, V, F, unit=6.0, n=2000, rng=rng)
    np.testing.assert_allclose([scores[key] for key in ("chamfer_l1", "hausdorff", "p95")], 0, atol=1e-10)
    # Two samplings of one surface differ, by about the distance between neighbouring samples.
    assert 0.01 < scores["chamfer_l1_sampled"] < 5
    assert scores["normal_consistency"] > 0.999
    assert scores["f_score"] == 1
    assert scores["components"] == 1
    assert scores["watertight"] is True


@pytest.mark.parametrize("d", [2, 3])
def test_two_balls_of_one_centre(d: int, rng: np.random.Generator) -> None:
    inner, outer = ball(d, 1.0), ball(d, 1.1)
    scores = surface_scores(*inner, *outer, unit=2.0, n=4000, rng=rng)
    for key in ("chamfer_l1", "hausdorff", "p95"):
        np.testing.assert_allclose(scores[key], 5.0, atol=0.15)
    assert scores["chamfer_l1_sampled"] >= scores["chamfer_l1"]
    assert scores["normal_consistency"] > 0.99
    assert scores["f_score"] == 0
    # All lengths are in the unit, those of the F-score too.
    coarse = surface_scores(*inner, *outer, unit=20.0, n=4000, rng=rng)
    np.testing.assert_allclose(coarse["chamfer_l1"], 0.5, atol=0.015)
    assert coarse["f_score"] == 1


@pytest.mark.parametrize("d", [2, 3])
def test_a_flipped_surface_shows(d: int, rng: np.random.Generator) -> None:
    V, F = ball(d, 1.0)
    scores = surface_scores(V, F[:, ::-1], V, F, unit=2.0, n=500, rng=rng)
    assert scores["normal_consistency"] < -0.999
    assert scores["watertight"] is True


def test_both_ways_count(rng: np.random.Generator) -> None:
    # One side of a square against all four: nothing predicted is wrong, three quarters are missed by 0 to 1.
    V = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    F = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    scores = surface_scores(V, F[:1], V, F, unit=1.0, n=20_000, rng=rng)
    # Completeness: 0, 1/2, 1, 1/2 on the four sides; accuracy 0.
    np.testing.assert_allclose(scores["chamfer_l1"], 100 * (0.5 + 0) / 2, rtol=0.02)
    np.testing.assert_allclose(scores["hausdorff"], 100, rtol=1e-3)
    np.testing.assert_allclose(scores["p95"], 100, rtol=1e-3)
    recall = 0.25 + 2 * 0.01 / 4
    np.testing.assert_allclose(scores["f_score"], 2 * recall / (1 + recall), atol=0.01)
    # Normals: 1 on the predicted side, and 1, 0, -1, 0 on the four.
    np.testing.assert_allclose(scores["normal_consistency"], 0.5, atol=0.01)
    assert scores["watertight"] is False
    swapped = surface_scores(V, F, V, F[:1], unit=1.0, n=20_000, rng=rng)
    for key in (*LENGTHS, "f_score", "normal_consistency"):
        np.testing.assert_allclose(swapped[key], scores[key], rtol=0.05)


def test_the_sampled_figure_is_the_mean_to_the_nearest_sample() -> None:
    # Far apart, the nearest sample is the only one of a facet next to a point.
    V, tiny = np.array([[0.0, 0.0], [1e-9, 0.0]]), [[0, 1]]
    scores = surface_scores(V, tiny, V + np.array([3, 4]), tiny, unit=10.0, n=3, rng=np.random.default_rng(0))
    for key in LENGTHS:
        np.testing.assert_allclose(scores[key], 50.0)


@pytest.mark.parametrize("d", [2, 3])
def test_an_empty_surface_has_no_scores(d: int, rng: np.random.Generator) -> None:
    V, F = ball(d, 1.0)
    nothing = np.empty((0, d)), np.empty((0, d), dtype=int)
    point = np.ones((d, d)), np.arange(d)[None]
    scores = surface_scores(*nothing, V, F, unit=2.0, n=10, rng=rng)
    assert scores == dict.fromkeys((*LENGTHS, "normal_consistency", "f_score", "watertight"), None) | {"components": 0}
    scores = surface_scores(V, F, *nothing, unit=2.0, n=10, rng=rng)
    assert scores["chamfer_l1"] is None
    assert (scores["components"], scores["watertight"]) == (1, True)
    assert surface_scores(*point, V, F, unit=2.0, n=10, rng=rng)["hausdorff"] is None


@pytest.mark.parametrize("d", [2, 3])
def test_facets_without_area_do_not_spoil_the_normals(d: int, rng: np.random.Generator) -> None:
    V, F = ball(d, 1.0)
    collapsed = np.repeat(np.arange(len(V))[:, None], d, axis=1)
    scores = surface_scores(V, F, V, np.concatenate([collapsed, F]), unit=2.0, n=1000, rng=rng)
    assert scores["normal_consistency"] > 0.99


def test_scores_are_plain_numbers(rng: np.random.Generator) -> None:
    import json

    V, F = ball(2, 1.0)
    scores = surface_scores(V, F, V * 1.05, F, unit=np.float64(2.0), n=10, rng=rng)
    assert {type(value) for value in scores.values()} == {float, int, bool}
    json.dumps(scores, allow_nan=False)


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    V, F = ball(2, 1.0)
    with pytest.raises(ValueError, match=r"true must be \(n,\) = \(2,\), got \(3,\)"):
        intersection_over_union([True, False], [True, False, True])
    with pytest.raises(ValueError, match=r"predicted must be an .* array of booleans"):
        intersection_over_union([0.2, 0.8], [True, False])
    with pytest.raises(ValueError, match=r"F_true.*does not index"):
        surface_scores(V, F, V[:3], F, unit=1.0, rng=rng)
    for unit in (0.0, np.nan):
        with pytest.raises(ValueError, match="unit must be positive"):
            surface_scores(V, F, V, F, unit=unit, rng=rng)
    with pytest.raises(ValueError, match="n must be positive"):
        surface_scores(V, F, V, F, unit=1.0, n=0, rng=rng)
