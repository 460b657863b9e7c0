import json
import math
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np
import pytest

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion, random_motion
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import local_rotations
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.rotations import rotation_matrices
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.base import Method
from nilbs.methods.mesh_lbs.field import PosedMesh
from nilbs.methods.mlp import Mlp
from nilbs.methods.nilbs import Nilbs
from nilbs.models.evaluation import evaluate, evaluation_poses
from nilbs.models.protocol import IOUS, POSE_SETS

SCORES = {
    "iou_bbox", "iou_surface", "chamfer_l1", "chamfer_l1_sampled", "hausdorff", "p95", "normal_consistency", "f_score",
    "components", "watertight", "lookups",
}  # fmt: skip


@dataclass
class StandIn:
    """A model whose answers come from the posed mesh: always right, always outside, or always inverted."""

    character: Character
    motion: Motion
    kinds: tuple[str, ...] = ("perfect",)
    config: dict = field(default_factory=lambda: {"motion": "still", "frames": 1, "steps": 0})
    method: Method = field(default_factory=Nilbs)

    def mesh(self, pose: np.ndarray) -> PosedMesh:
        c = self.character
        return PosedMesh(linear_blend_skinning(c.V, c.W, pose), c.F)

    def kind(self, pose: np.ndarray) -> str:
        """The kind of answers in a pose: kinds[k] in frame k of the motion, the last in all other poses."""
        known = [k for k in range(len(self.motion)) if np.array_equal(pose, self.motion[k])]
        return self.kinds[min(known[0] if known else len(self.kinds), len(self.kinds) - 1)]

    def posed(self, pose: np.ndarray, *, mapping: str | None = None) -> "PosedStandIn":
        return PosedStandIn(self.mesh(pose), self.kind(pose), self.character.d)


@dataclass
class PosedStandIn:
    """A stand-in in a pose."""

    mesh: PosedMesh
    kind: str
    d: int
    lookups: float | None = None

    def occupancy(self, x: np.ndarray) -> np.ndarray:
        inside = self.mesh.inside(x).astype(float)
        return {"perfect": inside, "empty": 0 * inside, "inverted": 1 - inside}[self.kind]

    def distance(self, x: np.ndarray) -> np.ndarray:
        return signed_distance(self.mesh.U, self.mesh.F, x) + 0.02

    def posed_distance(self, x: np.ndarray) -> np.ndarray:
        return signed_distance(self.mesh.U, self.mesh.F, x) - 0.01

    def extract_on(self, grid: Grid, *, polish: bool) -> tuple[np.ndarray, np.ndarray]:
        if self.kind == "empty":
            return np.zeros((0, self.d)), np.zeros((0, self.d), dtype=int)
        if self.kind == "perfect":
            return self.mesh.extract_on(grid)
        outside = 1.0 - 2.0 * self.mesh.inside(grid.points())
        return isosurface(-outside.reshape(grid.shape), grid)


def stand_in(character: Character, *kinds: str, frames: int = 3) -> StandIn:
    return StandIn(character, random_motion(character, frames=frames), kinds)


@pytest.mark.parametrize("d", [2, 3])
def test_a_perfect_an_empty_and_an_inverted_prediction(d: int, characters) -> None:
    model = stand_in(characters[d], "perfect", "empty", "inverted")
    seen = evaluate(model, points=800, resolution=24, poses=["seen"]).values["poses"]["seen"]
    assert seen["iou_bbox"]["frames"] == [1, 0, 0]
    assert seen["iou_surface"]["frames"] == [1, 0, 0]
    # Scores that an empty mesh does not have are null, in a frame and overall.
    for name in ("chamfer_l1", "hausdorff", "p95", "normal_consistency"):
        perfect, empty, inverted = seen[name]["frames"]
        assert empty is None
        assert None not in (perfect, inverted)
        assert seen[name]["mean"] is None
    assert seen["chamfer_l1"]["frames"][0] < 1
    assert seen["normal_consistency"]["frames"][0] > 0.9
    assert seen["normal_consistency"]["frames"][2] < 0.5


@pytest.mark.parametrize("d", [2, 3])
def test_points_fill_the_cube_and_cling_to_the_surface(d: int, characters, monkeypatch) -> None:
    c, queries = characters[d], []
    model = stand_in(c, "perfect", frames=1)
    monkeypatch.setattr(PosedStandIn, "occupancy", lambda self, x: (queries.append(x), np.zeros(len(x)))[1])
    evaluate(model, points=4000, resolution=4, poses=["seen"])
    bbox, surface = np.split(queries[0], 2)
    U = linear_blend_skinning(c.V, c.W, model.motion[0])
    cube = Grid.cube(U, 1)
    np.testing.assert_allclose(bbox.min(axis=0), cube.lower, atol=0.01)
    np.testing.assert_allclose(bbox.max(axis=0), cube.upper, atol=0.01)
    np.testing.assert_allclose(bbox.mean(axis=0), (cube.lower + cube.upper) / 2, atol=0.03)
    distance = signed_distance(U, c.F, surface)
    assert np.sqrt((distance**2).mean()) == pytest.approx(0.006 * c.L, rel=0.1)


def test_a_prediction_that_is_always_empty_has_scores_without_a_value(characters) -> None:
    scores = evaluate(stand_in(characters[2], "empty"), points=100, resolution=8, poses=["seen"])
    chamfer = scores.values["poses"]["seen"]["chamfer_l1"]
    assert chamfer == {"mean": None, "worst": None, "frames": [None, None, None]}
    assert " - " in str(scores)


def test_a_mean_over_frames_without_a_surface_is_null(characters) -> None:
    model = stand_in(characters[2], "perfect", "empty", "perfect")
    seen = evaluate(model, points=100, resolution=8, poses=["seen"]).values["poses"]["seen"]
    assert [frame is None for frame in seen["chamfer_l1"]["frames"]] == [False, True, False]
    assert (seen["chamfer_l1"]["mean"], seen["chamfer_l1"]["worst"]) == (None, None)
    assert seen["components"]["worst"] >= 1
    assert seen["components"]["frames"][1] == 0
    assert seen["iou_bbox"]["mean"] == pytest.approx(2 / 3)


def test_seconds_are_those_of_the_same_number_of_points_and_both_sets_share_the_start_of_a_pose(
    characters, monkeypatch
) -> None:
    model, clock = stand_in(characters[2], "perfect", frames=3), count()
    monkeypatch.setattr("nilbs.models.evaluation.perf_counter", lambda: next(clock))  # every query takes a second
    for ious in (IOUS, IOUS[:1]):
        scores = evaluate(model, points=50, resolution=0, poses=["seen"], rows=["floor", "nearest"], ious=ious)
        # 50 points of each set in a second are 100,000 in 2000 seconds, or in half of that if two sets share it.
        expected = 2000 / len(ious)
        assert scores.values["query_seconds"] == {"": expected, "nearest": expected}


def test_the_worst_frame_is_the_lowest_or_the_highest(characters) -> None:
    model = stand_in(characters[3], "perfect", "inverted", "perfect")
    seen = evaluate(model, points=400, resolution=20, poses=["seen"]).values["poses"]["seen"]
    for name, score in seen.items():
        frames = score["frames"]
        assert len(frames) == 3
        if name == "lookups":  # a stand-in counts none
            assert score["mean"] is None
            continue
        assert score["mean"] == pytest.approx(np.mean(frames))
        if name in ("iou_bbox", "iou_surface", "normal_consistency", "f_score", "watertight"):
            assert score["worst"] == min(frames)
        else:
            assert score["worst"] == max(frames)
    assert seen["iou_bbox"]["worst"] == 0
    assert seen["hausdorff"]["worst"] == seen["hausdorff"]["frames"][1]


def test_each_point_set_has_the_same_scores_without_the_other(characters) -> None:
    model = stand_in(characters[2], "perfect", frames=3)
    options = {"points": 300, "resolution": 8, "poses": ["seen"], "rows": ["nearest"]}
    both = evaluate(model, **options).values
    for kept, left in (IOUS, IOUS[::-1]):
        one = evaluate(model, ious=[kept], **options).values
        assert one["controls"] == {kind: {kept: scores[kept]} for kind, scores in both["controls"].items()}
        for of_one, of_both in ((one["poses"], both["poses"]), (one["rows"]["nearest"], both["rows"]["nearest"])):
            expected = {name: score for name, score in of_both["seen"].items() if name not in (left, "lookups")}
            assert {name: score for name, score in of_one["seen"].items() if name != "lookups"} == expected
    for wrong in ((), ("iou",)):
        with pytest.raises(ValueError, match=r"^ious must be some of iou_bbox, iou_surface, got"):
            evaluate(model, ious=wrong, **options)
    with pytest.raises(ValueError, match=r"^distances are compared"):
        evaluate(model, ious=["iou_bbox"], distances=True, **options | {"rows": ()})


def test_the_json_is_that_of_the_protocol(characters) -> None:
    model = stand_in(characters[2], "perfect", frames=4)
    values = evaluate(model, points=50, resolution=8, seed=3, rows=["floor"]).values
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert values["schema"] == 1
    assert values["L"] == model.character.L
    assert values["noise"] == 0.006
    assert (values["points"], values["resolution"], values["seed"]) == (50, 8, 3)
    assert values["training"] == model.config
    assert set(values) == {
        "schema", "L", "noise", "points", "resolution", "seed", "training", "controls", "query_seconds", "poses",
        "rows",
    }  # fmt: skip
    assert values["controls"] == {
        kind: {"iou_bbox": score, "iou_surface": score}
        for kind, score in (("perfect", 1), ("empty", 0), ("inverted", 0))
    }
    assert set(values["query_seconds"]) == {""}
    assert 0 < values["query_seconds"][""] < 100
    assert list(values["poses"]) == list(POSE_SETS)
    assert set(values["rows"]) == {"floor"}
    for sets in (values["poses"], values["rows"]["floor"]):
        assert {name: len(scores["iou_bbox"]["frames"]) for name, scores in sets.items()} == {
            "seen": 4, "interpolated": 3, "unseen": 10, "far": 10,
        }  # fmt: skip
        for scores in sets.values():
            assert set(scores) == SCORES
            assert all(set(score) == {"mean", "worst", "frames"} for score in scores.values())


def test_the_floor_is_the_perfect_prediction(characters) -> None:
    model = stand_in(characters[2], "perfect")
    values = evaluate(model, points=300, resolution=16, poses=["seen", "far"], rows=["floor"]).values
    assert values["rows"]["floor"] == values["poses"]
    without = evaluate(model, points=300, resolution=16, poses=["seen", "far"]).values
    assert without["rows"] == {}
    assert without["poses"] == values["poses"]
    # It is the truth's for any model.
    blind = evaluate(stand_in(characters[2], "empty"), points=300, resolution=16, poses=["seen", "far"], rows=["floor"])
    assert blind.values["rows"] == values["rows"]


def test_only_the_seed_changes_random_numbers(characters, models) -> None:
    options = {"points": 200, "resolution": 12, "poses": ["unseen"]}
    first = evaluate(models[2], **options).values
    assert evaluate(models[2], **options).values | {"query_seconds": first["query_seconds"]} == first
    assert evaluate(models[2], seed=1, **options).values["poses"] != first["poses"]
    seen = [evaluate(models[2], seed=seed, **(options | {"poses": ["seen"]})).values for seed in (0, 1)]
    assert seen[0]["poses"] != seen[1]["poses"]
    # A set's scores do not depend on the other sets.
    both = evaluate(models[2], **(options | {"poses": ["seen", "unseen"]})).values
    assert both["poses"]["unseen"] == first["poses"]["unseen"]


def test_the_table_contains_its_settings(models, capsys: pytest.CaptureFixture[str]) -> None:
    table = str(evaluate(models[3], points=100, resolution=8, poses=["seen"], rows=["floor"], progress=True))
    for part in (f"L {models[3].character.L:.4g}", "noise 0.006 L", "100 points", "resolution 8", "seed 0", "30 steps",
                 "random, amplitude 0.4 rad rms, 6 frames, seed 0", "\nseen ", "\nfloor seen "):  # fmt: skip
        assert part in table
    assert capsys.readouterr().out == ""
    header, *rows = table.splitlines()[-3:]
    assert {len(row) for row in rows} == {len(header)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"poses": ["sen"]}, "'sen' is none of seen, interpolated, unseen, far and no 'random S' with S in radians"),
        ({"poses": ["random -1"]}, "'random -1' is none of"),
        ({"poses": ["random x"]}, "'random x' is none of"),
        ({"rows": ["ceiling"]}, "'ceiling' is no row"),
        ({"points": 0}, "points must be at least 1, resolution 0 or at least 2, noise at least 0; got 0, 128, 0.006"),
        ({"resolution": 1}, "points must be at least 1, resolution 0 or at least 2, noise at least 0; got 100000, 1"),
        (
            {"noise": -1.0},
            "points must be at least 1, resolution 0 or at least 2, noise at least 0; got 100000, 128, -1",
        ),
    ],
)
def test_wrong_arguments_are_refused(options: dict, message: str, characters) -> None:
    with pytest.raises(ValueError) as caught:
        evaluate(stand_in(characters[2], "perfect"), **options)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("d", [2, 3])
def test_seen_poses_are_evenly_spaced_training_frames(d: int, characters) -> None:
    motion = random_motion(characters[d], frames=28)
    np.testing.assert_array_equal(evaluation_poses(characters[d], motion, "seen", seed=0), motion.B[::3])


@pytest.mark.parametrize("d", [2, 3])
def test_interpolated_poses_are_half_way_in_evenly_spaced_gaps(d: int, characters) -> None:
    c = characters[d]
    motion = random_motion(c, frames=20)
    B = evaluation_poses(c, motion, "interpolated", seed=0)
    assert len(B) == 10
    middle, _ = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, B)
    theta, _ = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, motion.B)
    for k, first in enumerate(range(0, 20, 2)):
        R0, R1, R = (rotation_matrices(angles) for angles in (theta[first], theta[first + 1], middle[k]))
        # Half-way: the step from the first to the middle, made twice, arrives.
        step = np.swapaxes(R0, 1, 2) @ R
        np.testing.assert_allclose(R0 @ step @ step, R1, atol=1e-9)


def test_interpolated_poses_lie_within_clips(characters) -> None:
    c = characters[2]
    motion = replace(random_motion(c, frames=6), clips=(("walk", 0), ("still", 3), ("run", 4)))
    B = evaluation_poses(c, motion, "interpolated", seed=0)
    expected = [motion.at(frame=frame) for frame in (0.5, 1.5, 4.5)]
    np.testing.assert_allclose(B, expected, atol=1e-12)


def test_short_motions_have_fewer_seen_and_interpolated_poses(characters) -> None:
    c = characters[2]
    for frames, seen, between in ((1, 1, 0), (2, 2, 1), (10, 10, 9), (11, 10, 10)):
        motion = random_motion(c, frames=frames)
        assert len(evaluation_poses(c, motion, "seen", seed=0)) == seen
        assert evaluation_poses(c, motion, "interpolated", seed=0).shape == (between, len(c.skeleton.BE), 3, 3)
    values = evaluate(stand_in(c, "perfect", frames=1), points=20, resolution=4, poses=["interpolated"]).values
    assert values["poses"] == {"interpolated": {}}


@pytest.mark.parametrize(("name", "std"), [("unseen", 0.28), ("far", 0.8)])
@pytest.mark.parametrize("d", [2, 3])
def test_random_poses_turn_all_but_the_roots(d: int, name: str, std: float, characters) -> None:
    c = characters[d]
    motion = random_motion(c, frames=2)
    B = np.concatenate([evaluation_poses(c, motion, name, seed=seed) for seed in range(60)])
    assert len(B) == 600
    theta, root = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, B)
    np.testing.assert_allclose(root, 0, atol=1e-9)
    assert np.abs(theta[:, c.skeleton.P < 0]).max() < 1e-9
    angle = np.linalg.norm(theta[:, c.skeleton.P >= 0], axis=-1)
    # A local rotation is known up to full turns; 0.8 rad is over half a turn once in 12,000.
    assert math.sqrt((angle**2).mean()) == pytest.approx(std, rel=0.05)
    assert len(np.unique(theta[:, 1, 0])) == 600


@pytest.mark.parametrize("d", [2, 3])
def test_rows_of_the_model_s_own_map_and_of_the_nearest_vertex(d: int, models) -> None:
    model = models[d]
    rows = ["floor", "inverse", "nearest"]
    values = evaluate(model, points=2000, resolution=16, poses=["unseen"], rows=rows).values
    assert list(values["rows"]) == rows
    surface = {row: sets["unseen"]["iou_surface"]["mean"] for row, sets in values["rows"].items()}
    searched = values["poses"]["unseen"]["iou_surface"]["mean"]
    # After a moment's training the map alone is poor; the search needs little of it, and copied weights none.
    assert surface["inverse"] < surface["nearest"] < surface["floor"] == 1
    assert surface["inverse"] < searched
    own = replace(model, method=replace(model.method, mapping="inverse"))
    again = evaluate(own, points=2000, resolution=16, poses=["unseen"])
    assert again.values["poses"] == {"unseen": values["rows"]["inverse"]["unseen"]}


def test_surfaces_poses_and_noise_can_be_chosen(characters) -> None:
    model = stand_in(characters[2], "perfect")
    scores = evaluate(model, points=50, resolution=0, noise=0.02, poses=["random 0.5", "random 0.6"]).values
    assert scores["noise"] == 0.02
    assert set(scores["poses"]) == {"random 0.5", "random 0.6"}
    for sets in scores["poses"].values():
        assert set(sets) == {"iou_bbox", "iou_surface", "lookups"}
    first, second = (evaluation_poses(characters[2], model.motion, f"random {std}", seed=0) for std in (0.5, 0.6))
    # Other poses, not the same ones bent further.
    assert np.abs(first - second).max() > 0.5


def test_points_have_the_given_distance_from_the_surface(characters, monkeypatch) -> None:
    c, queries = characters[2], []
    model = stand_in(c, "perfect", frames=1)
    monkeypatch.setattr(PosedStandIn, "occupancy", lambda self, x: (queries.append(x), np.zeros(len(x)))[1])
    evaluate(model, points=4000, resolution=0, noise=0.02, poses=["seen"])
    distance = signed_distance(linear_blend_skinning(c.V, c.W, model.motion[0]), c.F, queries[0][4000:])
    assert np.sqrt((distance**2).mean()) == pytest.approx(0.02 * c.L, rel=0.15)


def test_random_poses_have_the_spread_of_their_name(characters) -> None:
    c = characters[2]
    B = np.concatenate([evaluation_poses(c, random_motion(c, frames=2), "random 0.5", seed=s) for s in range(60)])
    theta, _ = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, B)
    assert np.sqrt((theta[:, c.skeleton.P >= 0] ** 2).mean()) == pytest.approx(0.5, rel=0.05)


def test_distances_are_compared_with_the_posed_mesh_s_own(characters) -> None:
    model = stand_in(characters[2], "perfect", frames=1)
    seen = evaluate(model, points=50, resolution=0, distances=True, poses=["seen"]).values["poses"]["seen"]
    assert seen["distance_error"]["mean"] == pytest.approx(2 / model.character.L)
    assert seen["posed_distance_error"]["mean"] == pytest.approx(1 / model.character.L)


def test_rows_of_a_map_need_a_model_that_has_it(characters) -> None:
    model = stand_in(characters[2], "perfect")
    model.method = Mlp()
    with pytest.raises(ValueError, match=r"'inverse' .* mlp"):
        evaluate(model, rows=["inverse"])


def test_distances_of_a_trained_model_and_of_its_maps(models) -> None:
    options = {"points": 400, "resolution": 0, "distances": True, "poses": ["unseen"]}
    values = evaluate(models[3], rows=["inverse", "floor"], **options).values
    own, inverse = values["poses"]["unseen"], values["rows"]["inverse"]["unseen"]
    for name in ("distance_error", "posed_distance_error"):
        # In % of L, at points within about 2 % of it from the skin.
        assert 0 < own[name]["mean"] < 1
        assert own[name]["mean"] < inverse[name]["mean"]
    assert "distance_error" not in values["rows"]["floor"]["unseen"]


def test_distances_are_those_of_the_method_that_has_them(characters, models) -> None:
    message = r"^distances are compared for the methods nilbs and paper "
    model = stand_in(characters[2], "perfect")
    model.method = Mlp()
    with pytest.raises(ValueError, match=message):
        evaluate(model, distances=True)
    with pytest.raises(ValueError, match=message):
        evaluate(models[2], distances=True, rows=["nearest"])


def test_controls_are_evaluated_once_for_a_set_of_poses(characters, monkeypatch) -> None:
    counts: list[int] = []
    inside = PosedMesh.inside
    monkeypatch.setattr(PosedMesh, "inside", lambda self, x: (counts.append(len(x)), inside(self, x))[1])
    model = stand_in(characters[2], "perfect", frames=3)
    evaluate(model, points=30, resolution=0, poses=["seen", "interpolated"])
    # Two sets of points in five poses, one by one by the truth, and once more in two; at once by the prediction.
    assert sorted(counts) == [30] * (2 * 5 + 2 * 2) + [60] * 5
