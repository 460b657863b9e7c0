"""Every numbered example runs as it is, and on a user's own files."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.io.mesh import read_mesh, write_mesh
from nilbs.io.tgf import write_tgf

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.usefixtures("coarse_volumes")
SMALL_TRAINING = ["--frames", "4", "--steps", "6", "--resolution", "24"]


def example(name: str, *options: object, monkeypatch, capsys) -> str:
    """Run an example as a script; what it printed."""
    (script,) = EXAMPLES.glob(f"{name}_*.py")
    monkeypatch.setattr(sys, "argv", [str(script), *map(str, options)])
    capsys.readouterr()
    runpy.run_path(str(script), run_name="__main__")
    return capsys.readouterr().out


@pytest.fixture(scope="module")
def capsule(tmp_path_factory) -> list[object]:
    """Options that name a user's own files: a capsule with two bones."""
    folder = tmp_path_factory.mktemp("own")
    ends = np.array([[-0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    grid = Grid.box(np.array([[-0.75, -0.25, -0.25], [0.75, 0.25, 0.25]]), 24)
    x = grid.points()
    axis = np.column_stack([np.clip(x[:, 0], -0.5, 0.5), 0 * x[:, 0], 0 * x[:, 0]])
    V, F = isosurface(np.linalg.norm(x - axis, axis=1) - 0.25, grid)
    write_mesh(folder / "capsule.ply", V, F)
    write_tgf(folder / "capsule.tgf", ends, np.array([[0, 1], [1, 2]]))
    return ["--mesh", folder / "capsule.ply", "--rig", folder / "capsule.tgf"]


@pytest.fixture(scope="module")
def bar(tmp_path_factory) -> list[object]:
    """Options that name other files of a user's own: a flat bar, whose rest cache is quicker to fill than a solid's."""
    folder = tmp_path_factory.mktemp("flat")
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 3, 31), np.linspace(0, 0.6, 7), indexing="ij"))
    i = (np.arange(30)[:, None] * 7 + np.arange(6)).ravel()
    T = np.concatenate([np.column_stack([i, i + 7, i + 8]), np.column_stack([i, i + 8, i + 1])])
    write_mesh(folder / "bar.obj", np.column_stack([x, y]), T)
    joints = np.array([[0.3, 0.3, 0.0], [1.5, 0.3, 0.0], [2.7, 0.3, 0.0]])
    write_tgf(folder / "bar.tgf", joints, np.array([[0, 1], [1, 2]]))
    return ["--mesh", folder / "bar.obj", "--rig", folder / "bar.tgf"]


@pytest.fixture(params=["gingerbread", "own files"])
def files(request) -> list[object]:
    return [] if request.param == "gingerbread" else request.getfixturevalue("capsule")


@pytest.fixture(params=["gingerbread", "own files"])
def flat_files(request) -> list[object]:
    return [] if request.param == "gingerbread" else request.getfixturevalue("bar")


def is_picture(path: Path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG")


def test_weights_and_bend(files, tmp_path, monkeypatch, capsys):
    out = example("01", *files, "--out", tmp_path, monkeypatch=monkeypatch, capsys=capsys)
    assert ("capsule: " in out) == bool(files)
    low, high, error = map(float, re.search(r"weights: (\S+) to (\S+), row sums within (\S+) of one", out).groups())
    assert 0 <= low < high <= 1
    assert error <= 1e-9
    assert is_picture(tmp_path / "01_weights_and_bend.png")


def test_weights_and_bend_of_a_bone_by_name(capsule, tmp_path, monkeypatch, capsys):
    example("01", *capsule, "--bone", "bone0", "--out", tmp_path, monkeypatch=monkeypatch, capsys=capsys)
    assert is_picture(tmp_path / "01_weights_and_bend.png")


def test_occupancy_and_distance(files, tmp_path, monkeypatch, capsys):
    options = ["--frame", 7, "--points", 40_000, "--resolution", 32, "--out", tmp_path]
    out = example("02", *files, *options, monkeypatch=monkeypatch, capsys=capsys)
    share, enclosed = map(float, re.search(r"from 40000 points (\S+), enclosed (\S+)", out).groups())
    assert share == pytest.approx(enclosed, rel=0.05)
    agree, points = map(int, re.search(r"correct sign at (\d+) of (\d+) points", out).groups())
    assert points == 2000
    assert agree >= 0.999 * points
    V, F = read_mesh(tmp_path / "02_offset.obj")
    assert len(V) > 20
    assert V.shape[1] == (3 if files else 2)
    if files:
        assert is_watertight(F)
    assert is_picture(tmp_path / "02_occupancy_and_distance.png")


def test_train_and_reconstruct(flat_files, tmp_path, monkeypatch, capsys):
    out = example("03", *flat_files, *SMALL_TRAINING, "--out", tmp_path, monkeypatch=monkeypatch, capsys=capsys)
    assert "loss" in out
    for name in ("03_training.png", "03_reconstruction.png"):
        assert is_picture(tmp_path / name)
    assert (tmp_path / "03_posed.obj").stat().st_size > 0

    if flat_files:  # the model that it wrote can be scored by the next example, without training again
        options = ["--model", tmp_path / "03_model.nilbs", "--points", 300, "--resolution", 16, "--out", tmp_path]
        out = example("04", *options, monkeypatch=monkeypatch, capsys=capsys)
        assert json.loads((tmp_path / "04_scores.json").read_text())["L"] == 3


def test_score_against_mesh_lbs(flat_files, tmp_path, monkeypatch, capsys):
    options = [*SMALL_TRAINING, "--points", 300, "--out", tmp_path]
    out = example("04", *flat_files, *options, monkeypatch=monkeypatch, capsys=capsys)
    scores = json.loads((tmp_path / "04_scores.json").read_text())
    assert scores["schema"] == 1
    for name in ("seen", "interpolated", "unseen", "far"):
        assert name in out
        assert 0 <= scores["poses"][name]["iou_bbox"]["mean"] <= 1
        assert scores["rows"]["floor"][name]["iou_bbox"]["worst"] == 1


def test_clear_an_obstacle(flat_files, tmp_path, monkeypatch, capsys):
    options = ["--frames", 4, "--steps", 6, "--out", tmp_path]
    out = example("05", *flat_files, *options, monkeypatch=monkeypatch, capsys=capsys)
    before, after = map(float, re.search(r"body: (\S+) before, (\S+) after", out).groups())
    assert before > 0.1
    assert after < 0.01
    assert is_picture(tmp_path / "05_clear_an_obstacle.png")


def test_push_particles_out(flat_files, tmp_path, monkeypatch, capsys):
    options = ["--frames", 12, "--particles", 800, "--steps", 6, "--out", tmp_path]
    out = example("06", *flat_files, *options, monkeypatch=monkeypatch, capsys=capsys)
    assert float(re.search(r"at most (\S+) % inside", out).group(1)) < 1
    assert is_picture(tmp_path / "06_push_particles_out.png")
