from pathlib import Path

import numpy as np
import pytest
import torch

from nilbs.characters.character import Character
from nilbs.engine.unit_frame import at_rest
from nilbs.fields.field import like
from nilbs.fields.objective import Objective
from nilbs.fields.occupancy_term import OccupancyTerm
from nilbs.fields.scene import Scene
from nilbs.fields.weight_term import ForwardWeightTerm, WeightTerm
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.rotations import transform_points
from nilbs.methods.base import TrainedMethod
from nilbs.methods.nasa.field import NasaWeightTerm
from nilbs.methods.registry import all_methods, method_class, method_of
from nilbs.methods.snarf.field import SnarfBoneTerm
from nilbs.models.model import Model, load_model

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
METHODS = all_methods()
BASELINES = [name for name in METHODS if name != "nilbs"]


def fitting(method: str, sizes: dict) -> dict:
    """Those of the sizes that the method has."""
    return {s.name: sizes[s.name] for s in method_class(method).settings() if s.name in sizes}


@pytest.fixture(scope="module")
def baselines(characters) -> dict[tuple[str, int], Model]:
    """Every other method, after a moment's training."""
    from nilbs.characters.motion import random_motion
    from nilbs.models.fitting import fit

    sizes = {"width": 8, "depth": 3, "poses_per_step": 2, "points_per_pose": 32, "samples_per_frame": 200, "steps": 3}
    sizes |= {"cache_resolution": 32, "weight_resolution": 32}
    return {
        (method, d): fit(c, random_motion(c, frames=4), device="cpu", method=method, **fitting(method, sizes))
        for method in BASELINES
        for d, c in characters.items()
    }


@DIMENSIONS
@pytest.mark.parametrize("method", BASELINES)
def test_baselines_answer_the_same_interface(method: str, d: int, baselines, tmp_path: Path, queries, rigid) -> None:
    model = baselines[method, d]
    x, pose = queries(model, 200)
    occupancy = model.occupancy(x, pose)
    assert occupancy.shape == (200,)
    assert ((occupancy >= 0) & (occupancy <= 1)).all()
    model.save(tmp_path / "baseline.nilbs")
    again = load_model(tmp_path / "baseline.nilbs")
    np.testing.assert_array_equal(again.occupancy(x, pose), occupancy)
    assert again.method == model.method
    U, F = model.extract(pose, resolution=12)
    assert U.shape[1] == F.shape[1] == d
    # The world moves and the answer stays.
    world = rigid(d)
    moved = model.occupancy(transform_points(world, x), world @ pose)
    np.testing.assert_allclose(moved, occupancy, atol=1e-3)
    if not model.method.mappings:
        with pytest.raises(ValueError, match=rf"{method} .*'inverse'"):
            model.occupancy(x, pose, mapping="inverse")


@pytest.mark.parametrize("method", ["nasa", "mlp", "snarf"])
def test_a_method_without_distance_refuses_it(method: str, baselines, queries) -> None:
    model = baselines[method, 2]
    x, pose = queries(model, 20)
    with pytest.raises(ValueError, match=rf"{method} has no distance"):
        model.distance(x, pose)
    assert model.answer(*map(torch.as_tensor, (x, pose))).distance.isnan().all()


@pytest.mark.parametrize("method", ["nasa", "mlp", "mesh-lbs"])
def test_a_method_without_canonical_points_refuses_them(method: str, baselines, queries) -> None:
    model = baselines[method, 2]
    x, pose = queries(model, 20)
    for query in (model.rest_points, lambda x, pose: model.values(np.atleast_1d, x, pose)):
        with pytest.raises(ValueError, match=rf"{method} has no canonical points"):
            query(x, pose)


def test_a_query_without_a_root_has_no_canonical_point_and_is_outside(baselines, queries, monkeypatch) -> None:
    model = baselines["snarf", 2]
    x, pose = queries(model, 20)
    assert np.isfinite(model.rest_points(x, pose)).any()
    monkeypatch.setattr("nilbs.methods.snarf.field.CONVERGED", -1.0)  # no search converges
    assert np.isnan(model.rest_points(x, pose)).all()
    np.testing.assert_array_equal(model.values(lambda x_rest: x_rest[:, 0], x, pose, outside=-1.0), -1.0)


def test_mesh_skinning_as_a_method_is_the_truth(baselines, queries) -> None:
    model = baselines["mesh-lbs", 3]
    x, pose = queries(model, 500)
    truth = signed_distance(model.character.skin(pose), model.character.F, x)
    np.testing.assert_allclose(model.distance(x, pose), truth, atol=1e-5 * model.character.L)


def test_a_network_may_keep_the_forward_weights(characters, tmp_path: Path, queries) -> None:
    from nilbs.characters.motion import random_motion
    from nilbs.models.fitting import fit

    c = characters[2]
    small = {"width": 32, "depth": 3, "poses_per_step": 8, "samples_per_frame": 500, "cache_resolution": 64}
    model = fit(
        c, random_motion(c, frames=4), device="cpu", forward_map="network", encoding="parameters", steps=150, **small
    )
    x, pose = queries(model, 2000)
    missed = np.linalg.norm(model.posed_points(c.V, pose) - c.skin(pose), axis=1)
    assert np.median(missed) < 0.05 * c.L
    model.save(tmp_path / "network.nilbs")
    np.testing.assert_array_equal(load_model(tmp_path / "network.nilbs").distance(x, pose), model.distance(x, pose))
    assert (
        model.config.items()
        >= {"method": "nilbs", "forward_map": "network", "encoding": "parameters", "steps": 150}.items()
    )


def objective(character: Character, **changes) -> Objective:
    from nilbs.characters.motion import random_motion

    sizes = {"width": 8, "depth": 3, "samples_per_frame": 50, "cache_resolution": 32, "weight_resolution": 32}
    name = changes.pop("method", "nilbs")
    if name == "nilbs":  # of itself it labels no points
        changes = {"occupancy_loss": 1.0} | changes
    method = method_of(name, **fitting(name, sizes | changes)).resolved(character)
    assert isinstance(method, TrainedMethod)
    field = method.field(character)
    return method.objective(field, Scene.of(character, random_motion(character, frames=2), like(field), seed=0))


@DIMENSIONS
@pytest.mark.parametrize(
    ("changes", "others"),
    [
        ({}, [WeightTerm]),
        ({"weight_loss": 0.0}, [WeightTerm]),  # the position loss is still there
        ({"weight_loss": 0.0, "position_loss": 0.0}, []),
        ({"forward_map": "network"}, [WeightTerm, ForwardWeightTerm]),
        ({"method": "nasa"}, [NasaWeightTerm]),
        ({"method": "nasa", "weight_loss": 0.0}, []),
        ({"method": "snarf"}, [SnarfBoneTerm]),
        ({"method": "snarf", "weight_loss": 0.0}, []),
        ({"method": "mlp"}, []),
    ],
)
def test_the_losses_of_every_method(d: int, changes: dict, others: list, characters) -> None:
    assert [type(term) for term in objective(characters[d], **changes).terms] == [OccupancyTerm, *others]
    if others:
        without = objective(characters[d], occupancy_loss=0.0, **changes)
        assert [type(term) for term in without.terms] == others


@pytest.mark.parametrize(
    ("changes", "adaptive", "absolute"),
    [
        ({}, True, False),
        ({"adaptive": False}, False, False),
        ({"method": "paper"}, False, True),
        ({"method": "nasa"}, False, False),
        ({"method": "mlp"}, False, False),
        ({"method": "snarf"}, False, False),
    ],
)
def test_where_labelled_points_are_drawn_by_error(changes: dict, adaptive: bool, absolute: bool, characters) -> None:
    occupancy = objective(characters[2], **changes).occupancy
    assert occupancy is not None
    assert (occupancy.adaptive, occupancy.absolute) == (adaptive, absolute)
    assert occupancy.factor == 1


def test_labelled_points_are_bounded_for_motions_of_any_length(characters, monkeypatch) -> None:
    monkeypatch.setattr("nilbs.fields.scene.MOST_LABELLED", 60)
    occupancy = objective(characters[2]).occupancy
    assert occupancy is not None
    assert occupancy.x.shape[:2] == (2, 30)


def test_the_paper_has_weights_at_rest_on_the_surface_only(characters) -> None:
    c = characters[2]
    _, paper = objective(c, method="paper").terms
    _, volume = objective(c).terms
    on_skin = np.abs(signed_distance(at_rest(c, c.V), c.F, paper.x_rest.numpy().astype(float)))
    assert on_skin.max() < 1e-6
    assert len(paper.x_rest) == len(np.unique(c.F)) < len(c.V)
    assert paper.poses is None
    assert paper.random_poses is None
    assert np.quantile(signed_distance(at_rest(c, c.V), c.F, volume.x_rest.numpy()[:500].astype(float)), 0.5) < -0.01
    assert len(volume.poses) == 2
    assert volume.random_poses is not None
    assert objective(c, random_pose_std=0.0).terms[1].random_poses is None


@DIMENSIONS
def test_random_poses_turn_all_bones_but_roots_within_their_spread(d: int, characters) -> None:
    from nilbs.characters.motion import random_motion

    c = characters[d]
    B = Scene.of(c, random_motion(c, frames=1), torch.zeros(1, dtype=torch.float64), seed=0).random_poses(0.5).numpy()
    roots = c.skeleton.P < 0
    np.testing.assert_allclose(B[:, roots], np.broadcast_to(np.eye(d + 1), B[:, roots].shape), atol=1e-12)
    child = int(np.flatnonzero(~roots & np.isin(c.skeleton.P, np.flatnonzero(roots)))[0])
    trace = np.trace(B[:, child, :d, :d], axis1=1, axis2=2)
    angle = np.arccos(np.clip((trace - (d - 2)) / 2, -1, 1))
    # The mean square of a normal angle whose spread is uniform from 0.1 to 0.5.
    assert (angle**2).mean() == pytest.approx((0.5**3 - 0.1**3) / (3 * 0.4), rel=0.15)


def test_parts_meet_on_the_surface_alone(characters) -> None:
    c = characters[2]
    _, term = objective(c, method="nasa").terms
    np.testing.assert_allclose(term.V.numpy(), at_rest(c, c.V)[np.unique(c.F)], atol=1e-6)
    np.testing.assert_allclose(term.W.numpy(), c.W[np.unique(c.F)], atol=1e-6)


@pytest.mark.parametrize("method", [name for name, kind in METHODS.items() if kind.trained])
def test_nothing_to_train_for_is_refused(method: str, characters) -> None:
    with pytest.raises(ValueError, match="nothing to train for"):
        objective(characters[2], method=method, occupancy_loss=0.0, weight_loss=0.0, position_loss=0.0)
