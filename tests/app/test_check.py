import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nilbs.app.commands.check import FILES
from nilbs.models.model import load_model


def test_files_and_output(assets, nilbs, tmp_path):
    model = load_model(assets / "bar3.nilbs")
    B = model.motion.B.copy()
    B[:, :, :2, 3] += 0.1, 0.2
    replace(model, motion=replace(model.motion, B=B, curves=())).save(tmp_path / "beside.nilbs")
    other = tmp_path / "beside.nilbs"
    words = ("check", assets / "bar3.nilbs", "--points", 2000, "--against", other, "--out", tmp_path)
    status, out, _ = nilbs(*words)
    assert status == 0
    assert (tmp_path / FILES[1]).read_text() == out
    assert (tmp_path / FILES[2]).read_bytes().startswith(b"\x89PNG")
    scene = trimesh.load(tmp_path / FILES[3])
    assert len(scene.geometry) == 2 * 3  # the body and the other one, in the worst frames
    colours = np.concatenate([mesh.visual.vertex_colors for mesh in scene.geometry.values()])
    assert len(np.unique(colours, axis=0)) > 2
    found = json.loads((tmp_path / FILES[0]).read_text())
    with_itself, with_other = found["contacts"]
    assert (with_itself["with"], with_other["with"]) == ("itself", "beside")
    # Two bones are neighbours, so that the body does not meet itself; but its copy is a little beside it.
    assert with_itself["frames_in_contact"] == 0
    assert found["exempt"] == [["bone0", "bone1"]]
    frames = with_other["frames"]
    assert with_other["frames_in_contact"] > 0
    assert {"frame", "seconds", "count", "depth", "depth_of_L", "bones", "point"} == frames[0].keys()
    assert "contacts with itself: 0 of" in out


def test_json(assets, succeeds):
    found = succeeds("check", assets / "bar2.nilbs", "--points", 500)
    assert found["exempt_share"] == 1
    assert len(found["contacts"]) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bar3.nilbs", "--against", "bar2.nilbs"], "bar2.nilbs: this model has 2 dimensions, "),
        (["no.nilbs"], "no.nilbs: No such file or directory"),
        (["bar3.nilbs", "--map", "x.json"], "--map is for the motion of a file"),
        (["bar3.nilbs", "--out", "bar.tgf"], "bar.tgf: this is a file, expected a folder"),
    ],
)
def test_mistakes(assets, fails, words, message):
    words = [assets / word if "." in word else word for word in words]
    assert message in fails("check", *words)
