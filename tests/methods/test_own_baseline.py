"""The baseline of the documentation: one file, no change elsewhere; it is trained, scored and saved like all others."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import nilbs
from nilbs.methods.base import REGISTERED
from nilbs.methods.registry import all_methods

FILE = Path(__file__).parents[2] / "examples" / "own_baseline.py"


@pytest.fixture
def balls():
    yield runpy.run_path(str(FILE))["Balls"]
    del REGISTERED["balls"]


@pytest.mark.parametrize("d", [2, 3])
def test_one_file_makes_a_method(d: int, balls, characters, tmp_path: Path, queries) -> None:
    character = characters[d]
    motion = nilbs.random_motion(character, frames=4)
    model = nilbs.fit(character, motion, "balls", radius=0.02, steps=60, samples_per_frame=500, device="cpu")
    assert model.method == balls(radius=0.02, steps=60, samples_per_frame=500)
    assert model.history[-10:].mean() < 0.5 * model.history[:10].mean()
    scores = nilbs.evaluate(model, points=500, resolution=16, poses=["seen"], rows=["nearest"]).values
    assert 0.2 < scores["poses"]["seen"]["iou_bbox"]["mean"] < scores["rows"]["nearest"]["seen"]["iou_bbox"]["mean"]
    model.save(tmp_path / "balls.nilbs")
    x, pose = queries(model, 100)
    again = nilbs.load_model(tmp_path / "balls.nilbs")
    np.testing.assert_array_equal(again.occupancy(x, pose), model.occupancy(x, pose))


def test_a_model_of_an_unknown_method_names_it(balls, characters, tmp_path: Path) -> None:
    character = characters[2]
    model = nilbs.fit(character, nilbs.random_motion(character, frames=2), "balls", steps=1, samples_per_frame=50)
    model.save(tmp_path / "balls.nilbs")
    del REGISTERED["balls"]
    try:
        with pytest.raises(ValueError, match=r"balls\.nilbs: .*'balls'"):
            nilbs.load_model(tmp_path / "balls.nilbs")
    finally:
        REGISTERED["balls"] = balls


def test_the_command_line_has_its_settings(balls, capsys) -> None:
    from nilbs.app.main import main

    assert "balls" in all_methods()
    with pytest.raises(SystemExit) as ended:
        main(["train", "--help"])
    assert ended.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "--radius X" in text
    assert "radius of every ball at the start (default 0.1)" in text
