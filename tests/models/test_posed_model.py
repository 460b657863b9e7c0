import numpy as np
import pytest
import torch

import nilbs.models.torch_field
from nilbs.engine.answer import Answer
from nilbs.fields.search import PosedSearch
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.facets import facet_normals, is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.inverse_skinning import MAPPINGS

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
ANSWERS = ("occupancy", "distance", "weights")


@DIMENSIONS
def test_a_body_twice_as_large_has_distances_twice_as_large(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    c = model.character
    rest = np.broadcast_to(np.eye(d + 1), model.motion[0].shape).copy()
    x = c.V + 0.01 * c.L * rng.normal(size=c.V.shape)
    larger = np.diag([2.0] * d + [1.0]) @ rest
    np.testing.assert_allclose(model.distance(2 * x, larger), model.distance(x, rest), atol=1e-4 * c.L)
    posed = model.posed_distance(2 * x, larger)
    np.testing.assert_allclose(posed, 2 * model.posed_distance(x, rest), atol=1e-4 * c.L)
    np.testing.assert_array_equal(posed < 0, model.distance(2 * x, larger) < 0)


@DIMENSIONS
def test_where_skinning_stretches_the_posed_distance_is_nearer_the_truth(d: int, models, rng) -> None:
    model = models[d]
    c = model.character
    # All bones widen the body by half along one axis, so the truth is the posed mesh's own distance.
    wide = np.repeat(np.diag([1.0, *[1.5] * (d - 1), 1.0])[None], len(c.skeleton.BE), axis=0)
    U = linear_blend_skinning(c.V, c.W, wide)
    x = U + 0.01 * c.L * rng.normal(size=U.shape)
    true = signed_distance(U, c.F, x)
    posed, rest = (np.abs(found - true) for found in (model.posed_distance(x, wide), model.distance(x, wide)))
    assert np.median(posed) < 1e-9 * c.L
    assert np.median(rest) > 1e-3 * c.L


@DIMENSIONS
def test_chunks_do_not_change_the_answers(d: int, models, monkeypatch, queries) -> None:
    model = models[d]
    x, pose = queries(model, 100)
    options = {"occupancy": {"mapping": "one-search"}, "distance": {"mapping": "all-bones"}, "weights": {}}
    whole = {answer: getattr(model, answer)(x, pose, **options[answer]) for answer in ANSWERS}
    monkeypatch.setattr(nilbs.models.torch_field, "CHUNK", 7)
    for answer in ANSWERS:
        np.testing.assert_allclose(getattr(model, answer)(x, pose, **options[answer]), whole[answer], atol=1e-5)


@DIMENSIONS
def test_no_points(d: int, models) -> None:
    model = models[d]
    pose, x = model.motion[0], np.zeros((0, d))
    assert model.occupancy(x, pose).shape == (0,)
    assert model.distance(x, pose).shape == (0,)
    assert model.weights(x, pose).shape == (0, len(model.character.skeleton.BE) + 1)
    assert model.rest_points(x, pose).shape == (0, d)


@DIMENSIONS
def test_wrong_queries_are_refused(d: int, models) -> None:
    model = models[d]
    b, pose = len(model.character.skeleton.BE), model.motion[0]
    with pytest.raises(ValueError, match=rf"^pose must be \(b, d\+1, d\+1\) = \({b}, {d + 1}, {d + 1}\), got \(1,"):
        model.occupancy(np.zeros((4, d)), pose[:1])
    with pytest.raises(ValueError, match=rf"^x must be \(n, {d}\)"):
        model.distance(np.zeros((4, 5 - d)), pose)
    with pytest.raises(ValueError, match=r"^x\[0, 0\] is nan"):
        model.weights(np.full((1, d), np.nan), pose)
    singular = pose.copy()
    singular[model.root, :d, :d] = 0
    with pytest.raises(ValueError, match=r"^bone 0 has a singular transform; fields take its inverse$"):
        model.rest_points(np.zeros((4, d)), singular)
    with pytest.raises(ValueError, match=r"nilbs .*'forward'.* search"):
        model.occupancy(np.zeros((4, d)), pose, mapping="forward")


@DIMENSIONS
def test_the_surface_is_closed_and_occupancy_is_one_half_on_it(d: int, models) -> None:
    model = models[d]
    pose = model.motion[2]
    U, F = model.extract(pose, resolution=40)
    assert is_watertight(F)
    # Vertices are polished: the sign changes within a millionth of L, but where levels touch zero.
    c, posed = model.character, model.posed(pose)
    step = 2e-6 * c.L * facet_averages(U, F)
    changes = (posed.distance(U + step) < 0) != (posed.distance(U - step) < 0)
    assert changes.mean() > 0.99
    # Linear interpolation between nodes misses the level by less than a cell, and by less on a finer grid.
    grids = [Grid.cube(posed.U, resolution) for resolution in (40, 120)]
    rough, fine = (np.median(np.abs(posed.distance(posed.extract_on(grid, polish=False)[0]))) for grid in grids)
    assert np.median(np.abs(posed.distance(U))) < 1e-6 * c.L < fine < 0.5 * rough < 0.125 * c.L / 40
    # Queries near the skin save work and change nothing but the order.
    twin = posed.extract_on(grids[0], stride=1)
    order, twin_order = (np.lexsort(np.round(vertices / c.L, 5).T) for vertices in (U, twin[0]))
    np.testing.assert_allclose(U[order], twin[0][twin_order], atol=1e-5 * c.L)
    assert len(F) == len(twin[1])


def facet_averages(U: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Unit normals (n, d) at vertices: the normalised sums of those of their facets."""
    normals = np.zeros_like(U)
    for corner in F.T:
        np.add.at(normals, corner, facet_normals(U, F))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@DIMENSIONS
@pytest.mark.parametrize("mapping", MAPPINGS)
def test_every_mapping_answers(d: int, mapping: str, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 300)
    posed = model.posed(pose, mapping=mapping)
    occupancy = posed.occupancy(x)
    assert occupancy.shape == (300,)
    np.testing.assert_array_equal(posed.distance(x) < 0, occupancy > 0.5)
    assert (posed.lookups is None) == (mapping in ("inverse", "reverse"))
    np.testing.assert_array_equal(model.occupancy(x, pose, mapping=mapping), occupancy)


@DIMENSIONS
def test_the_forward_map_poses_the_vertices(d: int, models, rigid) -> None:
    model = models[d]
    c, pose = model.character, rigid(d) @ model.motion[2]
    missed = np.linalg.norm(model.posed_points(c.V, pose) - c.skin(pose), axis=1)
    assert np.median(missed) < 0.01 * c.L
    assert model.posed_points(np.zeros((0, d)), pose).shape == (0, d)


@DIMENSIONS
def test_any_field_given_at_rest_is_read_at_the_canonical_points(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 400)
    inside, x_rest = model.occupancy(x, pose) > 0.5, model.rest_points(x, pose)
    colour = model.values(lambda x_rest: x_rest**2, x, pose)
    np.testing.assert_allclose(colour[inside], x_rest[inside] ** 2)
    assert np.isnan(colour[~inside]).all()
    density = model.values(lambda x_rest: x_rest[:, 0], x, pose, outside=-5.0)
    np.testing.assert_allclose(density, np.where(inside, x_rest[:, 0], -5))
    message = rf"rest field .* {inside.sum()} points, got an array \(3,\)$"
    with pytest.raises(ValueError, match=message):
        model.values(lambda x_rest: np.zeros(3), x, pose)


@DIMENSIONS
def test_derivatives_are_possible_after_a_failure(d: int, models, queries, monkeypatch) -> None:
    model = models[d]
    x, pose = queries(model, 40)
    monkeypatch.setattr(nilbs.models.torch_field, "CHUNK", 10)
    whole, sizes = PosedSearch.__call__, []

    def fails(self: PosedSearch, chunk: torch.Tensor) -> Answer:
        sizes.append(len(chunk))
        if len(sizes) == 3:
            raise MemoryError
        return whole(self, chunk)

    monkeypatch.setattr(PosedSearch, "__call__", fails)
    with pytest.raises(MemoryError):
        model.distance(x, pose, mapping="one-search")
    assert sizes == [10, 10, 10]
    assert not torch.is_inference_mode_enabled()
    place = torch.as_tensor(x[:5]).requires_grad_()
    model.answer(place, torch.as_tensor(pose)).distance.sum().backward()
    assert torch.isfinite(place.grad).all()
    assert (place.grad.norm(dim=-1) > 0.1).any()


@DIMENSIONS
def test_points_that_single_precision_cannot_hold_are_refused(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 5)
    x[3, 1] = 1e39
    message = r"\[3\] = \[.*1e\+39.*\] is 1e\+06 times the character's size away, or more$"
    for answer in (model.occupancy, model.distance, model.rest_points, model.posed_distance):
        for mapping in (None, "one-search", "inverse"):  # the engine, and the field
            with pytest.raises(ValueError, match=f"^x{message}"):
                answer(x, pose, mapping=mapping)
    with pytest.raises(ValueError, match=f"^x{message}"):
        model.weights(x, pose)
    with pytest.raises(ValueError, match=f"^x_rest{message}"):
        model.posed_points(x, pose)


@DIMENSIONS
def test_points_may_lie_in_memory_in_any_order(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 30)
    for answer in (model.occupancy, model.distance, model.posed_distance, model.rest_points, model.posed_points):
        np.testing.assert_array_equal(answer(x[::-1], pose), answer(x, pose)[::-1])
        np.testing.assert_array_equal(answer(np.asfortranarray(x)[::3], pose), answer(x, pose)[::3])
    # In torch a point's index may change its last digit.
    occupancy = model.occupancy(x, pose, mapping="inverse")
    np.testing.assert_allclose(model.occupancy(x[::-1], pose, mapping="inverse"), occupancy[::-1], rtol=1e-5)
