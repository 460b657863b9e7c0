import numpy as np
import pytest
import torch

from nilbs.characters.motion import random_motion
from nilbs.engine.lattice import SHELL
from nilbs.fields.search import SearchField
from nilbs.geometry.distance import closest_points, signed_distance
from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning
from nilbs.methods.registry import method_of
from nilbs.models.fitting import fit
from nilbs.models.model import load_model
from nilbs.models.torch_field import torch_device

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
ANSWERS = ("occupancy", "distance", "weights")
SMALL = {
    "width": 8, "depth": 2, "poses_per_step": 2, "points_per_pose": 32, "samples_per_frame": 50,
    "cache_resolution": 16, "weight_resolution": 16,
}  # fmt: skip


@DIMENSIONS
def test_answers_have_their_shapes_and_ranges(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 500)
    occupancy, W = model.occupancy(x, pose, mapping="inverse"), model.weights(x, pose)
    assert occupancy.shape == (500,)
    assert 0 <= occupancy.min() < 0.5 < occupancy.max() <= 1
    assert W.shape == (500, len(model.character.skeleton.BE) + 1)
    assert W.min() >= 0
    np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-5)
    # Occupancy by eq. 7 and 8, from the other answers.
    x_rest = (model.rest_points(x, pose, mapping="inverse") - model.character.center) / model.character.L
    cached = model.field.inverse.cache.distance(torch.as_tensor(x_rest, dtype=torch.float32)).numpy()
    inside = 1 / (1 + np.exp(np.clip(cached / model.method.cache_width, -50, 50)))
    np.testing.assert_allclose(model.occupancy(x, pose, mapping="inverse", ghost=False), inside, atol=1e-4)
    np.testing.assert_allclose(occupancy, (1 - W[:, -1]) * inside, atol=1e-4)
    # Distance is the cached one, except at points inside that the ghost bone rules out.
    distance = model.distance(x, pose, mapping="inverse") / model.character.L
    overruled = (cached < 0) & (occupancy < 0.5)
    np.testing.assert_allclose(distance[~overruled], cached[~overruled], atol=1e-6)
    np.testing.assert_array_equal(distance < 0, occupancy > 0.5)


@DIMENSIONS
def test_rest_points_invert_the_blend_of_the_returned_weights(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 200)
    W = model.weights(x, pose).astype(np.float64)
    bones = W[:, :-1].copy()
    bones[:, model.root] += W[:, -1]
    x_rest = inverse_linear_blend_skinning(x, bones / bones.sum(axis=1, keepdims=True), pose)
    near = np.linalg.norm(x_rest - x, axis=1) < 2  # a blend that is nearly singular loses digits
    assert near.mean() > 0.9
    np.testing.assert_allclose(model.rest_points(x, pose, mapping="inverse")[near], x_rest[near], atol=1e-3)


@DIMENSIONS
@pytest.mark.parametrize("far", [1.0, 1e4])
def test_a_rigidly_moved_query_is_answered_as_at_rest(d: int, far: float, models, queries, rigid) -> None:
    model = models[d]
    x, pose = queries(model, 300)
    rest = np.broadcast_to(np.eye(d + 1), pose.shape)
    world = rigid(d, far=far)
    for B in (rest, pose):
        moved = transform_points(world, x), world @ B
        for answer in ANSWERS:
            np.testing.assert_allclose(getattr(model, answer)(*moved), getattr(model, answer)(x, B), atol=1e-5)
        np.testing.assert_allclose(model.rest_points(*moved), model.rest_points(x, B), atol=1e-4)


@DIMENSIONS
def test_in_double_precision_a_rigid_motion_changes_nothing(d: int, saved, queries, rigid) -> None:
    model = load_model(saved[d]).to(dtype=torch.float64)
    x, pose = queries(model, 300)
    world = rigid(d)
    for answer in ANSWERS:
        values = getattr(model, answer)(x, pose)
        assert values.dtype == np.float64
        moved = getattr(model, answer)(transform_points(world, x), world @ pose)
        np.testing.assert_allclose(moved, values, atol=1e-9)


@DIMENSIONS
def test_tensors_are_answered_as_arrays_are(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 200)
    for mapping in ("search", "one-search", "inverse"):
        answer = model.answer(*map(torch.as_tensor, (x, pose)), mapping=mapping)
        distance, x_rest = answer.distance.numpy(force=True), answer.x_rest.numpy(force=True)
        occupancy = answer.occupancy.numpy(force=True)
        np.testing.assert_allclose(occupancy, model.occupancy(x, pose, mapping=mapping), atol=1e-3)
        found = np.isfinite(model.rest_points(x, pose, mapping=mapping)).all(axis=1)
        assert (mapping == "search") == (not found.all())
        # Without a canonical point there is only a bound.
        assert (distance[~found] > 0).all()
        if mapping == "search":  # of several canonical points outside the two may find different ones
            found &= distance < SHELL * model.character.L
            assert np.count_nonzero(found) >= 8
        atol = 1e-4 if mapping == "search" else 1e-5
        np.testing.assert_allclose(distance[found], model.distance(x, pose, mapping=mapping)[found], atol=atol)
        np.testing.assert_allclose(x_rest[found], model.rest_points(x, pose, mapping=mapping)[found], atol=10 * atol)


@DIMENSIONS
def test_without_a_canonical_point_the_distance_is_that_of_the_posed_skin(d: int, models, queries) -> None:
    model = models[d]
    c = model.character
    x, pose = queries(model, 400)
    missing = np.isnan(model.rest_points(x, pose)).any(axis=1)
    assert 0.2 < missing.mean() < 0.9
    assert np.isnan(model.rest_points(x, pose)[missing]).all()
    assert (model.occupancy(x, pose)[missing] == 0).all()
    true = signed_distance(c.skin(pose), c.F, x)
    np.testing.assert_allclose(model.distance(x, pose)[missing], true[missing], atol=1e-6 * c.L)
    # Where there is one, it is that of the rest shape.
    assert np.abs(model.distance(x, pose) - true)[~missing].max() > 1e-3 * c.L


@DIMENSIONS
def test_distances_to_the_posed_skin_are_those_of_the_mesh(d: int, models, queries) -> None:
    model = models[d]
    c = model.character
    x, pose = queries(model, 400)
    x = np.concatenate([x, c.skin(pose) + 0.01 * c.L, 1e7 * x[:3]])
    distance, _, point = closest_points(c.skin(pose), c.F, x)
    found = model.closest_points(x, pose)
    np.testing.assert_allclose(found.distance, distance, rtol=1e-9, atol=1e-9 * c.L)
    np.testing.assert_allclose(found.point[:-3], point[:-3], atol=1e-7 * c.L)
    corners = np.einsum("nk,nkd->nd", found.barycentric, c.skin(pose)[c.F[found.facet]])
    np.testing.assert_allclose(corners, found.point, atol=1e-9 * c.L)
    x = x[:-3]
    for mapping in (None, "inverse"):
        length = model.posed_distance(x, pose, mapping=mapping)
        np.testing.assert_allclose(np.abs(length), distance[:-3], atol=1e-9 * c.L)
        np.testing.assert_array_equal(length < 0, model.occupancy(x, pose, mapping=mapping) > 0.5)


@DIMENSIONS
def test_the_engine_answers_the_default_search_and_the_field_all_else(d: int, saved, queries) -> None:
    model = load_model(saved[d])
    x, pose = queries(model, 100)
    for answer in (model.occupancy, model.distance, model.posed_distance, model.rest_points, model.posed_points):
        answer(x, pose)
    model.extract(pose, resolution=10)
    assert "field" not in vars(model)
    assert model.engine() is model.engine("search")
    for mapping in ("one-search", "all-bones", "inverse"):
        assert model.engine(mapping) is None
    single = model.occupancy(x, pose)
    # In double precision the field answers, and back in single precision the engine again.
    double = model.to(dtype=torch.float64).occupancy(x, pose)
    assert model.engine() is None
    np.testing.assert_allclose(double, single, atol=1e-3)
    assert np.abs(double - single).max() > 0
    model.to(dtype=torch.float32, device="cpu")
    np.testing.assert_array_equal(model.occupancy(x, pose), single)


@DIMENSIONS
def test_a_second_forward_network_is_searched_in_torch(d: int, characters, queries) -> None:
    c = characters[d]
    method = method_of("nilbs", steps=2, forward_map="network", **SMALL)
    model = fit(c, random_motion(c, frames=4), method, device="cpu")
    assert model.engine() is None
    x, pose = queries(model, 50)
    assert model.occupancy(x, pose).shape == (50,)
    assert isinstance(model.posed(pose)._source, SearchField)


@DIMENSIONS
def test_rest_points_are_posed_to_the_query(d: int, models, rng: np.random.Generator) -> None:
    model = models[d]
    c, pose = model.character, model.motion[3]
    inner = rng.dirichlet(np.ones(d + 1), 300)
    element = c.T[rng.integers(0, len(c.T), 300)]
    x_rest, W = (np.einsum("nc,nci->ni", inner, values[element]) for values in (c.V_volume, c.W_volume))
    x = linear_blend_skinning(x_rest, W, pose)
    assert (model.occupancy(x, pose) > 0.5).mean() > 0.97
    # Each is posed to its query, up to the error of the coarse grid of weights.
    missed = np.linalg.norm(model.rest_points(x, pose) - x_rest, axis=1)
    assert np.quantile(missed, 0.9) < 0.03 * c.L


def test_devices_are_checked_by_name() -> None:
    assert torch_device("cpu") == "cpu"
    assert torch_device("auto") == ("cuda" if torch.cuda.is_available() else "cpu")
    for name in ("abacus", "meta"):  # the latter exists, and holds nothing
        with pytest.raises(ValueError, match=rf"^torch cannot use the device '{name}': "):
            torch_device(name)


@pytest.mark.parametrize(
    ("x", "pose", "message"),
    [
        (np.zeros((2, 2)), None, "x must be a tensor"),
        (None, None, r"x must be a tensor .* None$"),
        (torch.zeros((2, 2), dtype=torch.int64), None, r"x .* torch.int64$"),
        (torch.zeros((2, 2), dtype=torch.float16), None, r"x .* torch.float16$"),
        (torch.zeros((2, 3)), None, r"x .* \(n, 2\), got \(2, 3\)$"),
        (torch.zeros(2), None, r"x .* \(n, 2\), got \(2,\)$"),
        (torch.tensor(2.0), None, r"x .* \(n, 2\), got \(\)$"),
        (torch.tensor([[0.0, torch.nan]]), None, r"x has numbers that are not finite$"),
        (torch.zeros((2, 2)), torch.eye(3)[None], r"pose .* \(13, 3, 3\), got \(1, 3, 3\)$"),
        (torch.zeros((2, 2)), torch.full((13, 3, 3), torch.nan), r"pose has numbers that are not finite$"),
    ],
)
def test_wrong_tensors_of_points_and_poses_are_refused(x, pose, message: str, models) -> None:
    known = torch.as_tensor(models[2].motion[0])
    with pytest.raises(ValueError, match=f"^{message}"):
        models[2].answer(x, known if pose is None else pose)


def test_points_and_poses_of_other_precisions_are_answered_alike(models, queries) -> None:
    x, pose = map(torch.as_tensor, queries(models[2], 50))
    whole = models[2].answer(x, pose).distance
    torch.testing.assert_close(models[2].answer(x.float(), pose).distance, whole, rtol=0, atol=1e-4)
