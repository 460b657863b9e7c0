"""Volume against twist: closed forms of what skinning loses, and what a brief training makes of it."""

import numpy as np
import pytest

from benchmarks.study.twist import DEGREES, MAPS, twist_model, twist_motion, twist_row, twist_table
from nilbs.characters.capsule import capsule
from nilbs.characters.character import Character
from nilbs.geometry.diagnosis import enclosed_volume
from nilbs.geometry.winding import winding_number
from nilbs.models.model import Model

RADIUS = 0.1
TINY = {"width": 16, "depth": 3, "poses_per_step": 4, "points_per_pose": 128, "samples_per_frame": 300}
GRIDS = {"cache_resolution": 48, "weight_resolution": 48}


@pytest.fixture(scope="module")
def character() -> Character:
    return capsule(length=1.0, radius=RADIUS, resolution=24)


@pytest.fixture(scope="module")
def model(character: Character) -> Model:
    return twist_model(character, steps=60, device="cpu", **TINY, **GRIDS)


def test_a_row_for_each_twist_with_a_column_for_each_map(character):
    rows = twist_table(
        character=character, degrees=(0, 120), steps=20, resolution=24, seed=3, device="cpu", **TINY, **GRIDS
    )
    assert [row["degrees"] for row in rows] == [0, 120]
    assert all(list(row) == ["degrees", "lbs", *MAPS] for row in rows)
    assert rows[0]["lbs"] == pytest.approx(1, abs=1e-12)
    assert rows == twist_table(
        character=character, degrees=(0, 120), steps=20, resolution=24, seed=3, device="cpu", **TINY, **GRIDS
    )


def test_at_rest_the_volume_is_that_of_the_mesh(model):
    row = twist_row(model, 0, resolution=48)
    assert row["lbs"] == pytest.approx(1, abs=1e-12)
    assert row["search"] == pytest.approx(1, abs=0.02)
    # Both maps are the identity there, whatever the weights; a training of a moment does not tame the ghost bone.
    assert row["inverse"] == pytest.approx(row["reverse"], abs=1e-4)
    assert row["inverse"] == pytest.approx(1, abs=0.15)


def test_skinning_loses_volume_with_the_cosine_of_the_twist(character):
    # The blend (1 - w) I + w R scales the area around the axis by 1 - 2 w (1 - w) (1 - cos).
    motion = twist_motion(character, DEGREES)
    volumes = np.array([enclosed_volume(character.skin(pose), character.F) for pose in motion.B])
    assert (np.diff(volumes) < 0).all()
    lost = 1 - volumes / volumes[0]
    y, w = character.V[:, 1], character.W[:, 1]
    order = np.argsort(y)
    heights = np.linspace(RADIUS - 0.5, 0.5 - RADIUS, 400)
    share = np.interp(heights, y[order], w[order])
    removed = np.pi * RADIUS**2 * np.trapezoid(2 * share * (1 - share), heights) / volumes[0]
    np.testing.assert_allclose(lost, removed * (1 - np.cos(np.radians(DEGREES))), atol=0.01)


def test_the_twisted_capsule_covers_no_place_twice(character, rng):
    pose = twist_motion(character, [150])[0]
    U = character.skin(pose)
    box = np.array([U.min(axis=0), U.max(axis=0)])
    winding = winding_number(U, character.F, rng.uniform(*box, (40_000, 3)))
    assert set(np.round(winding).astype(int)) == {0, 1}
    volume = np.mean(winding > 0.5) * np.prod(box[1] - box[0])
    assert volume == pytest.approx(enclosed_volume(U, character.F), rel=0.02)


def test_the_root_search_keeps_what_skinning_kept_and_the_reverse_map_swells(model):
    row = twist_row(model, 150, resolution=48)
    assert row["lbs"] < 0.9
    assert row["search"] == pytest.approx(1, abs=0.03)
    # A blend of rotations only ever moves points towards the axis: all of the rest volume is found inside.
    assert row["reverse"] * row["lbs"] > 0.98


def test_only_the_last_bone_turns_and_about_the_axis(character):
    motion = twist_motion(character, [0, 90, -90])
    np.testing.assert_allclose(motion.B[0], np.broadcast_to(np.eye(4), (2, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(motion.B[:, 0], np.broadcast_to(np.eye(4), (3, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(motion.B[1, 1] @ motion.B[2, 1], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(motion.B[1, 1] @ [0, 0, 1, 1], [1, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(motion.B[1, 1] @ [0, 0.7, 0, 1], [0, 0.7, 0, 1], atol=1e-12)


def test_the_plane_has_no_twist():
    with pytest.raises(ValueError, match="flat"):
        twist_motion(capsule(resolution=8, d=2), [10])


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_volumes")
def test_the_inverse_map_keeps_the_volume_within_two_percent():
    sizes = {"width": 32, "poses_per_step": 8, "points_per_pose": 128, "samples_per_frame": 2000, "steps": 1000}
    grids = {"cache_resolution": 128, "weight_resolution": 64}
    rows = twist_table(degrees=(0, 75, 150), resolution=64, device="cpu", **sizes, **grids)
    for row in rows:
        assert row["inverse"] == pytest.approx(1, abs=0.02), row
        assert row["search"] == pytest.approx(1, abs=0.01), row
