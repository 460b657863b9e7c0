"""`nilbs view`: what it opens, and what it refuses."""

import json
import sys

import numpy as np
import pytest

BRIEFLY = ("--port", "0", "--seconds", "0.1")


@pytest.fixture
def viser():
    return pytest.importorskip("viser", reason="viser is not installed: pip install 'nilbs-geometry[view]'")


def test_without_viser_it_names_the_extra(fails, assets, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    error = fails("view", assets / "bar3.nilbs")
    assert error == "the package viser is not installed: pip install 'nilbs-geometry[view]'"


def test_it_prints_the_address_and_the_tunnel(viser, nilbs, assets):
    status, out, error = nilbs("view", assets / "bar3.nilbs", *BRIEFLY)
    assert status == 0
    assert out.startswith("http://127.0.0.1:")
    assert out.count("\n") == 1
    port = out.rstrip("/\n").rpartition(":")[2]
    assert f"ssh -L {port}:127.0.0.1:{port} HOST" in error


def test_another_address_has_a_token(viser, nilbs, assets):
    status, out, error = nilbs("view", assets / "bar2.nilbs", "--host", "0.0.0.0", "--json", *BRIEFLY)
    assert status == 0
    assert "?token=" in json.loads(out)["address"]
    assert "ssh" not in error


def test_help_explains_the_tunnel(nilbs, capsys):
    with pytest.raises(SystemExit):
        nilbs("view", "--help")
    assert "ssh -L 8080:127.0.0.1:8080 HOST" in " ".join(capsys.readouterr().out.split())


def test_models_and_files_of_a_character_share_a_scene(viser, assets):
    from nilbs.app.main import parser_of
    from nilbs.app.scenes import scene_of

    files = (assets / "bar3.nilbs", assets / "bar3.obj", assets / "bar.tgf", assets / "bar3-weights.npz")
    words = ["view", *map(str, files)]
    scene = scene_of(parser_of(words).parse_args(words))
    assert [body.name for body in scene.bodies] == ["bar3 1", "bar3 2"]
    assert [body.model.method.name for body in scene.bodies] == ["nilbs", "nearest"]


def test_motion_is_of_the_first_body(viser, assets, tmp_path):
    from nilbs.app.main import parser_of
    from nilbs.app.scenes import scene_of

    motion = tmp_path / "wave.json"
    motion.write_text('{"frames": [{"bone1": [0, 0, 30]}]}')
    words = ["view", str(assets / "bar3.nilbs"), str(assets / "bar3.nilbs"), "--motion", str(motion)]
    scene = scene_of(parser_of(words).parse_args(words))
    assert [len(body.motion) for body in scene.bodies] == [1, 3]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["bar3.nilbs", "bar2.nilbs"], "bar2 has 2 dimensions, bar3 has 3"),
        (["bar3.nilbs", "--solve"], "--solve is for the files of a character"),
        (["bar3.nilbs", "--group", "arm"], "--group is for the files of a character"),
        (["bar3.nilbs", "--points", "flat.npy"], "points must be (n, 3) here, the file holds (4, 2)"),
        (["bar3.nilbs", "--clip", "walk"], "--clip is for the motion of a file"),
        (["nothing.nilbs"], "No such file"),
        (["bar3.nilbs", "--host", "203.0.113.1"], "choose others with --host and --port"),
    ],
)
def test_mistakes(viser, fails, assets, tmp_path, monkeypatch, words, error):
    monkeypatch.chdir(assets)
    np.save(assets / "flat.npy", np.zeros((4, 2)))
    assert error in fails("view", *words, *BRIEFLY)
