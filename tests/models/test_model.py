import numpy as np
import pytest
import torch

from nilbs.engine.unit_frame import rest_center
from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning
from nilbs.models.model import load_model
from nilbs.models.torch_field import torch_device

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
ANSWERS = ("occupancy", "distance", "weights")


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
    x_rest = (model.rest_points(x, pose, mapping="inverse") - rest_center(model.character)) / model.character.L
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
    for mapping in ("search", "inverse"):
        answer = model.answer(*map(torch.as_tensor, (x, pose)), mapping=mapping)
        np.testing.assert_allclose(
            answer.distance.numpy(force=True), model.distance(x, pose, mapping=mapping), atol=1e-5
        )
        np.testing.assert_allclose(
            answer.x_rest.numpy(force=True), model.rest_points(x, pose, mapping=mapping), atol=1e-4
        )
        occupancy = answer.occupancy.numpy(force=True)
        np.testing.assert_allclose(occupancy, model.occupancy(x, pose, mapping=mapping), atol=1e-3)


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
