from dataclasses import replace

import numpy as np
import pytest

from nilbs.app.commands.clear import NOT_CLEAR
from nilbs.characters.motion import Motion, load_motion
from nilbs.contacts.clearing import clear_motion
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.pairs import contacts, skin_places
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.geometry.rotations import rotation_matrices, rotation_vectors
from nilbs.models.model import load_model


def test_files_and_output(assets, nilbs, succeeds, tmp_path):
    words = ("clear", assets / "bar3.nilbs", "--points", 300, "-o", tmp_path / "out.glb")
    found = succeeds(*words)
    # Two bones are neighbours, so that the body does not meet itself.
    assert found["before"]["frames_in_contact"] == found["after"]["frames_in_contact"] == 0
    assert (found["summed_squared_change"], found["not_clear"]) == (0, [])
    model = load_model(assets / "bar3.nilbs")
    assert len(load_motion(tmp_path / "out.glb", model.character)) == len(model.motion)
    status, out, _ = nilbs(*words)
    assert status == 0
    assert "clear in every frame" in out


@pytest.fixture
def standing(assets, tmp_path):
    """A bar that stands still at rest but for a place where it is moved to; as a file."""
    model = load_model(assets / "bar3.nilbs")

    def write(name, x, y):
        B = np.tile(np.eye(4), (5, 2, 1, 1))
        B[:, :, :2, 3] = x, y
        motion = Motion(B, np.arange(5), "still", np.arange(5) / 24, model.character.skeleton)
        replace(model, motion=motion).save(tmp_path / name)
        return tmp_path / name

    return write


def test_what_cannot_be_cleared_is_reported(nilbs, standing, tmp_path):
    """Another bar is in the middle of it, and roots do not move."""
    words = ("clear", standing("a.nilbs", 0, 0), "--points", 300, "--against", standing("b.nilbs", 0.1, 0.2))
    status, out, _ = nilbs(*words, "--rounds", 1, "-o", tmp_path / "out.bvh")
    assert status == NOT_CLEAR
    assert "not clear: 5 frames (0, 1, 2, 3, 4), the deepest " in out
    assert (tmp_path / "out.bvh").exists()


def test_a_change_that_is_too_rough_is_reported(nilbs, standing, tmp_path, monkeypatch):
    before_and_after = iter([0.01, np.radians(2.1)])
    monkeypatch.setattr("nilbs.contacts.clearing.rough_of_clips", lambda motion: next(before_and_after))
    status, out, _ = nilbs("clear", standing("a.nilbs", 0, 0), "--points", 300, "-o", tmp_path / "out.bvh")
    assert status == NOT_CLEAR
    assert "clear in every frame" in out
    assert "not smooth" in out


@pytest.mark.parametrize("options", [(), ("--distance", 1)])
def test_files_hold_the_joint_angles_that_keep_bodies_apart(succeeds, standing, tmp_path, options):
    """The end of a bar is in the side of another one: its second bone turns away."""
    model, other = standing("a.nilbs", 0, 0), standing("b.nilbs", 2.6, 0.9)
    read = []
    for suffix in ("bvh", "glb"):
        out = tmp_path / f"out.{suffix}"
        found = succeeds("clear", model, "--points", 300, "--against", other, *options, "-o", out)
        assert found["before"]["deepest_of_L"] > 0.02
        assert found["not_clear"] == []
        read.append(load_motion(out, load_model(model).character))
    a, b = load_model(model), load_model(other)
    changes = JointChanges(a.character.skeleton, a.motion.B)
    skin = [skin_places(m.character.V, m.character.F, samples=4000) for m in (a, b)]
    cleared = clear_motion(
        a, a.motion, against=[b], finder=SelfContactFinder(a, samples=300, apart=0.01 if options else 0.005),
        distance=0.01 if options else None,
    )  # fmt: skip
    angles = rotation_vectors(rotation_matrices(cleared.change) @ rotation_matrices(changes.rotations(np.arange(5))))
    assert np.abs(angles).max() > 0.01
    for motion in read:
        written = JointChanges(a.character.skeleton, motion.B).rotations(np.arange(5))
        np.testing.assert_allclose(written, angles, atol=1e-6)
        pair = contacts(a, motion.B[0], b, b.motion.B[0], skins=skin)
        assert pair.depth.max(initial=0.0) <= 0.005 * a.character.L
        if options:
            place = skin[0].at(a.posed(motion.B[0]).U, a.character.F)
            assert b.posed_distance(place, b.motion.B[0]).min() >= 0.01 * a.character.L


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bar3.nilbs", "--against", "bar2.nilbs", "-o", "out.glb"], "bar2.nilbs: this model has 2 dimensions, "),
        (["bar3.nilbs", "-o", "out.obj"], "out.obj"),
        (["bar3.nilbs", "--depth", "0", "-o", "out.glb"], "--depth 0 leaves no contact at all"),
    ],
)
def test_mistakes(assets, fails, tmp_path, words, message):
    words = [(tmp_path if "out" in word else assets) / word if "." in word else word for word in words]
    assert message in fails("clear", *words)
