"""Many poses in one query: answers are those of the poses one by one."""

import numpy as np
import pytest
import torch

from nilbs.engine.compiled import set_threads
from nilbs.geometry.grids import Grid
from nilbs.models.fitting import fit
from nilbs.models.model import Model, load_model

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
QUERIES = ("occupancy", "distance", "posed_distance", "rest_points", "posed_points", "weights")


@pytest.fixture(params=[1, 3])  # fewer than poses, and more
def threads(request):
    set_threads(request.param)
    yield
    set_threads(None)


@pytest.fixture
def batch(rng):
    """Points (2, n, d) around a character in two poses, and the poses."""

    def drawn(model: Model, n: int) -> tuple[np.ndarray, np.ndarray]:
        poses = model.motion.B[[1, 4]]
        cubes = [Grid.cube(model.character.skin(pose), 1) for pose in poses]
        return np.stack([rng.uniform(c.lower, c.upper, (n, model.character.d)) for c in cubes]), poses

    return drawn


def one_by_one(query, x: np.ndarray, poses: np.ndarray) -> np.ndarray:
    return np.stack([query(*pair) for pair in zip(x, poses, strict=True)])


@DIMENSIONS
def test_arrays_of_many_poses_are_answered_as_one_by_one(d: int, models, batch, threads) -> None:
    model = models[d]
    x, poses = batch(model, 500)
    for name in QUERIES:
        query = getattr(model, name)
        np.testing.assert_array_equal(query(x, poses), one_by_one(query, x, poses), err_msg=name)
    assert model.occupancy(x, poses).shape == (2, 500)
    assert 0.02 < (model.occupancy(x, poses) > 0.5).mean() < 0.9
    assert np.isnan(model.rest_points(x, poses)).any()
    found = model.closest_points(x, poses)
    for k in range(2):
        for values, alone in zip(found, model.closest_points(x[k], poses[k]), strict=True):
            np.testing.assert_array_equal(values[k], alone)
    places = model.posed(poses).closest_places(x)
    for k in range(2):
        for name, values in model.posed(poses[k]).closest_places(x[k]).items():
            np.testing.assert_array_equal(places[name][k], values, err_msg=name)
    colour = model.values(lambda x_rest: x_rest**2, x, poses)
    np.testing.assert_array_equal(
        colour, one_by_one(lambda x, pose: model.values(lambda x_rest: x_rest**2, x, pose), x, poses)
    )


@DIMENSIONS
@pytest.mark.parametrize("mapping", ["inverse", "all-bones"])
def test_every_mapping_takes_many_poses(d: int, mapping: str, models, batch) -> None:
    x, poses = batch(models[d], 50)
    whole = models[d].distance(x, poses, mapping=mapping)
    alone = one_by_one(lambda x, pose: models[d].distance(x, pose, mapping=mapping), x, poses)
    np.testing.assert_array_equal(whole, alone)
    answer = models[d].answer(*map(torch.as_tensor, (x, poses)), mapping=mapping)
    np.testing.assert_allclose(answer.distance.numpy(force=True), whole, atol=1e-5)
    assert answer.x_rest.shape == x.shape


def test_a_baseline_takes_many_poses(models, batch, threads) -> None:
    model = fit(models[3].character, models[3].motion, "rigid-parts")
    x, poses = batch(model, 50)
    np.testing.assert_array_equal(model.distance(x, poses), one_by_one(model.distance, x, poses))


@DIMENSIONS
def test_tensors_of_many_poses_have_the_derivatives_of_each(d: int, models, batch, threads) -> None:
    model = models[d]
    x, poses = batch(model, 300)
    given = torch.as_tensor(x).requires_grad_(), torch.as_tensor(poses).requires_grad_()
    answer = model.answer(*given)
    assert (answer.distance.shape, answer.x_rest.shape) == ((2, 300), (2, 300, d))
    by_x, by_pose = torch.autograd.grad(answer.distance.square().sum(), given)
    assert (by_pose.flatten(1).norm(dim=-1) > 0.1).all()
    for k in range(2):
        one = torch.as_tensor(x[k]).requires_grad_(), torch.as_tensor(poses[k]).requires_grad_()
        alone = model.answer(*one)
        torch.testing.assert_close(answer.distance[k], alone.distance, rtol=0, atol=0)
        torch.testing.assert_close(answer.x_rest[k], alone.x_rest, rtol=0, atol=0, equal_nan=True)
        found = torch.autograd.grad(alone.distance.square().sum(), one)
        torch.testing.assert_close(by_x[k], found[0], rtol=1e-10, atol=1e-10)
        torch.testing.assert_close(by_pose[k], found[1], rtol=1e-10, atol=1e-8)


@DIMENSIONS
def test_points_and_poses_must_be_as_many(d: int, models, batch) -> None:
    model, b = models[d], len(models[d].character.skeleton.BE)
    x, poses = batch(model, 5)
    numbers = rf"\(p, n, d\) = \(2, n, {d}\)"
    for query in (model.occupancy, model.closest_points, model.weights):
        with pytest.raises(ValueError, match=rf"^x must be {numbers}, got \(3, 5, {d}\)$"):
            query(x[[0, 1, 1]], poses)
        with pytest.raises(ValueError, match=rf"^x must be {numbers}, got \(5, {d}\)$"):
            query(x[0], poses)
        with pytest.raises(ValueError, match=rf"^x must be \(n, {d}\), got \(2, 5, {d}\)$"):
            query(x, poses[0])
    for wrong in (x[[0, 1, 1]], x[0]):
        with pytest.raises(ValueError, match=rf"^x must be {numbers}, got "):
            model.answer(torch.as_tensor(wrong), torch.as_tensor(poses))
    with pytest.raises(ValueError, match=rf"^x must be \(n, {d}\), got \(2, 5, {d}\)$"):
        model.answer(torch.as_tensor(x), torch.as_tensor(poses[0]))
    shape = rf"\(p, b, d\+1, d\+1\) = \(p, {b}, {d + 1}, {d + 1}\), got \(2, {b - 1}, "
    with pytest.raises(ValueError, match=rf"^pose must be {shape}"):
        model.distance(x, poses[:, 1:])
    with pytest.raises(ValueError, match=rf"^pose must be {shape}"):
        model.answer(torch.as_tensor(x), torch.as_tensor(poses[:, 1:]))


@DIMENSIONS
def test_what_is_wrong_in_one_of_many_poses_is_named(d: int, models, batch) -> None:
    model = models[d]
    x, poses = batch(model, 5)
    x[1, 3, 0] = 1e39
    for query in (model.occupancy, lambda x, B: model.answer(torch.as_tensor(x), torch.as_tensor(B))):
        with pytest.raises(ValueError, match=r"^x\[1, 3\] = \[1e\+39.*\] is 1e\+06 times the character's size away"):
            query(x, poses)
    singular = poses.copy()
    singular[1, 2] = 0
    with pytest.raises(ValueError, match=r"^bone 2 in pose 1 has a singular transform"):
        model.occupancy(x, singular)
    with pytest.raises(ValueError, match=r"^pose must be \(b, d\+1, d\+1\): a surface is extracted in one pose"):
        model.extract(poses)


@DIMENSIONS
def test_no_points_and_no_poses(d: int, models, batch) -> None:
    model = models[d]
    x, poses = batch(model, 4)
    for points, B in ((x[:, :0], poses), (x[:0], poses[:0])):
        for name in QUERIES:
            assert getattr(model, name)(points, B).shape[:2] == points.shape[:2]
        assert [len(values) for values in model.closest_points(points, B)] == [len(points)] * 4
        for mapping in ("search", "inverse"):
            answer = model.answer(*(torch.as_tensor(a).requires_grad_() for a in (points, B)), mapping=mapping)
            assert answer.distance.shape == points.shape[:2]
            assert answer.x_rest.shape == points.shape


def test_a_moved_model_takes_many_poses(saved, batch) -> None:
    model = load_model(saved[2]).to(dtype=torch.float64)
    x, poses = batch(model, 40)
    np.testing.assert_array_equal(model.occupancy(x, poses), one_by_one(model.occupancy, x, poses))
    given = torch.as_tensor(x).requires_grad_(), torch.as_tensor(poses).requires_grad_()
    model.answer(*given).level.sum().backward()
    assert all(bool(tensor.grad.flatten(1).any(dim=-1).all()) for tensor in given)
