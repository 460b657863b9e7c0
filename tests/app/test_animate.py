import json
import subprocess
from dataclasses import replace
from shutil import which

import numpy as np
import pytest
from PIL import Image

from nilbs.io import read_mesh
from nilbs.models.model import load_model


def test_a_film(assets, succeeds, tmp_path, d):
    path = tmp_path / "walk.gif"
    found = succeeds("animate", assets / f"bar{d}.nilbs", "--fps", 12, "--pixels", 64, "-o", path)
    model = load_model(assets / f"bar{d}.nilbs")
    seconds = np.ptp(model.motion.times)
    assert found["frames"] == int(seconds * 12 + 1e-9) + 1
    with Image.open(path) as film:
        assert film.size == (64, 64)
        assert film.n_frames == found["frames"]
        first = np.asarray(film.convert("RGB"))
    # The body is on white, and not cut off.
    assert (first[[0, -1]] > 250).all()
    assert (first < 250).any()


@pytest.mark.skipif(which("ffprobe") is None, reason="ffprobe is not installed")
def test_another_program_reads_a_film(assets, succeeds, tmp_path):
    path = tmp_path / "walk.mp4"
    found = succeeds("animate", assets / "bar3.nilbs", "--fps", 12, "--pixels", 64, "-o", path)
    words = ["ffprobe", "-v", "error", "-count_frames", "-select_streams", "v", "-show_streams", "-of", "json"]
    (stream,) = json.loads(subprocess.run([*words, path], check=True, capture_output=True).stdout)["streams"]
    assert (stream["width"], stream["height"], stream["r_frame_rate"]) == (64, 64, "12/1")
    assert int(stream["nb_read_frames"]) == found["frames"]


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_meshes_are_numbered_and_posed(assets, succeeds, tmp_path, suffix):
    model, out = load_model(assets / "bar3.nilbs"), tmp_path / "out"
    model.motion = replace(model.motion, times=model.motion.times + 1.5)  # it need not begin at zero
    model.save(tmp_path / "late.nilbs")
    out.mkdir()
    found = succeeds("animate", tmp_path / "late.nilbs", "--fps", 36, "-o", out / f"walk{suffix}")
    names = sorted(path.name for path in out.iterdir())
    assert len(names) > 2
    assert names == [f"walk_{k:04d}{suffix}" for k in range(found["frames"])]
    k = found["frames"] // 2
    U, F = read_mesh(out / names[k])
    true = model.skinning.posed(model.motion.at(seconds=model.motion.times[0] + k / 36))
    if suffix == ".stl":  # vertices at one place are one there
        np.testing.assert_allclose(U.min(axis=0), true.min(axis=0), atol=1e-5)
        assert len(F) == len(model.character.F)
    else:
        np.testing.assert_allclose(U, true, atol=1e-5)
        np.testing.assert_array_equal(F, model.character.F)


def test_the_field_s_surface(assets, succeeds, tmp_path):
    found = succeeds(
        "animate", assets / "bar3.nilbs", "--fps", 1, "--field", "--resolution", 16, "-o", tmp_path / "w.obj"
    )
    assert found["surface"] == "field"
    U, _ = read_mesh(tmp_path / "w_0000.obj")
    assert len(U) > 20


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bar3.nilbs", "-o", "out.avi"], "out.avi: the file name must end in .gif or .mp4"),
        (["bar2.nilbs", "-o", "out.stl"], "this model is flat"),
        (["bar3.nilbs", "-o", "no/out.gif"], "the folder does not exist"),
    ],
)
def test_mistakes(assets, fails, tmp_path, words, message):
    words = [
        tmp_path / word if word.startswith(("out", "no")) else assets / word if word != "-o" else word for word in words
    ]
    assert message in fails("animate", *words)


def test_a_missing_package_is_named(assets, fails, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    assert "pip install imageio-ffmpeg" in fails("animate", assets / "bar3.nilbs", "-o", tmp_path / "w.mp4")
    assert list(tmp_path.iterdir()) == []
