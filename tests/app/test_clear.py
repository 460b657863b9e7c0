import pytest

from nilbs.app.commands.clear import NOT_CLEAR
from nilbs.characters.motion import load_motion
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


def test_what_cannot_be_cleared_is_reported(assets, nilbs, tmp_path):
    """A copy of the body stands where it does."""
    words = ("clear", assets / "bar3.nilbs", "--points", 300, "--against", assets / "bar3.nilbs", "--rounds", 1)
    status, out, _ = nilbs(*words, "-o", tmp_path / "out.bvh")
    assert status == NOT_CLEAR
    assert "not clear: 3 frames (0, 1, 2), the deepest " in out
    assert (tmp_path / "out.bvh").exists()


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
