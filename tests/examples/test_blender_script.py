"""The example for Blender, in Blender: `make blender` runs it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nilbs
from nilbs.geometry.distance import closest_points
from nilbs.geometry.skinning import linear_blend_skinning

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENE = Path(__file__).with_name("blender_scene.py")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, np.ndarray]:
    """What the script makes of the gingerbread man, whose legs are turned into each other."""
    python = os.environ.get("NILBS_BPY")
    if not python:
        pytest.skip("NILBS_BPY is not set: `make blender` installs Blender's package and runs these tests")
    folder = tmp_path_factory.mktemp("blender")
    c = nilbs.load_character(EXAMPLES / "assets" / "cookie.obj", EXAMPLES / "assets" / "gingerbread.tgf")
    s = c.skeleton
    np.savez(
        folder / "given.npz", V=c.V, E=c.F, W=c.W, C=s.C, BE=s.BE, P=s.P, names=np.array(s.names),
        turned=np.array(["bone6", "bone11"]), angles=np.array([-0.6, 0.6]),
    )  # fmt: skip
    environment = os.environ | {"NILBS_PYTHON": sys.executable, "PYTHONPATH": str(EXAMPLES.parent)}
    words = [python, SCENE, EXAMPLES / "blender" / "nilbs_model.py", folder]
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    with np.load(folder / "found.npz") as file:
        return dict(file)


def test_the_arrays_move_as_in_blender(found) -> None:
    U = linear_blend_skinning(found["V"], found["W"] / found["W"].sum(axis=1, keepdims=True), found["B"])
    assert np.abs(U - found["V"]).max() > 0.1
    np.testing.assert_allclose(U, found["posed"], atol=1e-5)


def test_the_surface_lies_on_the_posed_mesh(found) -> None:
    distance, *_ = closest_points(found["posed"], found["E"], found["surface"])
    assert len(found["surface"]) > 500
    assert distance.max() < 0.02


def test_the_legs_that_meet_are_red_and_nothing_else(found) -> None:
    red = found["colours"][:, 1] < 0.6
    assert red.sum() > 10
    assert set(found["names"][found["W"][red].argmax(axis=1)]) == {"bone6", "bone7", "bone11", "bone12"}
