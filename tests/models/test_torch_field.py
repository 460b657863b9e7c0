import numpy as np
import pytest
import torch

from nilbs.engine.compiled import set_threads
from nilbs.models.model import load_model

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


@DIMENSIONS
def test_a_point_without_a_canonical_point_has_the_distance_to_the_skin(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 400)
    answer = model.answer(*map(torch.as_tensor, (x, pose)))
    outside = np.isnan(model.rest_points(x, pose)).any(axis=1)
    assert 0.2 < outside.mean() < 1
    np.testing.assert_array_equal(np.isnan(answer.x_rest.numpy()).all(axis=1), outside)
    expected = model.closest_points(x, pose).distance
    np.testing.assert_allclose(answer.distance.numpy()[outside], expected[outside], rtol=1e-12)
    np.testing.assert_allclose(answer.distance.numpy(), model.distance(x, pose), atol=1e-6)
    torch.testing.assert_close(answer.level, answer.distance, rtol=0, atol=0)
    assert (answer.occupancy.numpy()[outside] < 0.5).all()


@DIMENSIONS
def test_distances_to_the_skin_are_differentiable(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 60)
    outside = np.flatnonzero(np.isnan(model.rest_points(x, pose)).any(axis=1))[:4]
    given = torch.as_tensor(x[outside]).requires_grad_(), torch.as_tensor(pose).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, B: model.answer(x, B).distance, given, atol=1e-6, fast_mode=True)
    answer = model.answer(*given)
    assert answer.x_rest.isnan().all()
    for gradient in torch.autograd.grad(answer.x_rest.nansum(), given):
        assert not gradient.any()


@DIMENSIONS
def test_the_engine_and_the_field_agree(d: int, saved, queries) -> None:
    engine, field = load_model(saved[d]), load_model(saved[d]).to(dtype=torch.float64)
    x, pose = queries(engine, 1500)
    found = []
    for model in (engine, field):
        given = torch.as_tensor(x).requires_grad_(), torch.as_tensor(pose).requires_grad_()
        answer = model.answer(*given)
        rooted = torch.isfinite(answer.x_rest).all(dim=-1) if model is engine else found[0][1]
        distance = torch.where(rooted, answer.distance, 0)
        found.append((answer, rooted, distance, *torch.autograd.grad(distance.sum(), given[:1])))
    (one, rooted, _, by_x), (other, _, _, expected) = found
    L = engine.character.L
    same = rooted & ((one.x_rest - other.x_rest).norm(dim=-1) < 1e-4 * L)
    assert int(same.sum()) > 0.9 * int(rooted.sum()) > 50
    torch.testing.assert_close(one.distance[same], other.distance[same], rtol=0, atol=2e-4 * L)
    # But for roots that rounding moves across the border of a cell.
    missed = (by_x - expected)[same].abs().amax(dim=-1)
    assert float(missed.quantile(0.95)) < 1e-4


@DIMENSIONS
def test_gradients_of_everything_that_an_answer_holds(d: int, models, queries) -> None:
    model = models[d]
    x, pose = queries(model, 300)
    rooted = torch.as_tensor(~np.isnan(model.rest_points(x, pose)).any(axis=1))
    point = torch.as_tensor(x).requires_grad_()
    answer = model.answer(point, torch.as_tensor(pose))
    (by_level,) = torch.autograd.grad(answer.level.sum(), point, retain_graph=True)
    (by_distance,) = torch.autograd.grad(answer.distance.sum(), point, retain_graph=True)
    torch.testing.assert_close(by_level, by_distance)
    rows = [torch.autograd.grad(answer.x_rest[:, r].nansum(), point, retain_graph=True)[0] for r in range(d)]
    assert torch.stack(rows).isfinite().all()
    # A body that moves as a whole moves the distance by nothing, and the canonical point by the step back.
    B = torch.as_tensor(pose).requires_grad_()
    answer = model.answer(point, B)
    by_x, by_B = torch.autograd.grad(answer.distance[rooted].sum(), (point, B))
    torch.testing.assert_close(by_B[:, :d, d].sum(dim=0), -by_x.sum(dim=0), rtol=1e-4, atol=1e-4)


def test_gradients_do_not_depend_on_threads(models, queries) -> None:
    x, pose = queries(models[3], 5000)
    found = []
    for count in (1, 2):
        set_threads(count)
        try:
            given = torch.as_tensor(x).requires_grad_(), torch.as_tensor(pose).requires_grad_()
            found.append(torch.autograd.grad(models[3].answer(*given).distance.square().sum(), given))
        finally:
            set_threads(None)
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_derivatives_are_of_first_order(models, queries) -> None:
    x, pose = map(torch.as_tensor, queries(models[2], 20))
    x.requires_grad_()
    (by_x,) = torch.autograd.grad(models[2].answer(x, pose).distance.square().sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        by_x.sum().backward()


@pytest.mark.parametrize("dtypes", [(torch.float32, torch.float32), (torch.float32, torch.float64)])
def test_the_answer_has_the_higher_precision_of_points_and_pose(dtypes, models, queries) -> None:
    tensors = map(torch.as_tensor, queries(models[2], 20))
    x, pose = (tensor.to(dtype).requires_grad_() for tensor, dtype in zip(tensors, dtypes, strict=True))
    answer = models[2].answer(x, pose)
    assert {tensor.dtype for tensor in answer[:3]} == {dtypes[1]}
    answer.distance.sum().backward()
    assert (x.grad.dtype, pose.grad.dtype) == dtypes
    with torch.inference_mode():
        torch.testing.assert_close(models[2].answer(x, pose).distance, answer.distance, rtol=0, atol=0)
