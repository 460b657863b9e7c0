import sys

import numpy as np
import pytest

from nilbs.geometry import progress
from nilbs.models.model import load_model


@pytest.mark.parametrize("quantity", ["occupancy", "distance"])
def test_values_are_those_of_the_nodes(assets, succeeds, tmp_path, d, quantity):
    path = tmp_path / "grid.npz"
    found = succeeds(
        "voxelize", assets / f"bar{d}.nilbs", "--frame", 1, "--quantity", quantity, "--resolution", 20, "-o", path
    )
    model = load_model(assets / f"bar{d}.nilbs")
    posed = model.posed(model.motion[1])
    with np.load(path, allow_pickle=False) as file:
        values, origin, spacing = file["values"], file["origin"], float(file["spacing"])
    assert found["nodes"] == " x ".join(map(str, values.shape))
    index = np.stack(np.meshgrid(*map(np.arange, values.shape), indexing="ij"), axis=-1).reshape(-1, d)
    x = origin + spacing * index
    if quantity == "occupancy":
        np.testing.assert_array_equal(values.ravel(), posed.occupancy(x) > 0.5)
    else:
        np.testing.assert_allclose(values.ravel(), posed.posed_distance(x), rtol=1e-6, atol=1e-6)
    assert found["inside"] > 0
    # The grid surrounds the body.
    assert (origin < posed.U.min(axis=0)).all()
    assert (origin + spacing * (np.array(values.shape) - 1) > posed.U.max(axis=0)).all()


def test_a_spacing_puts_nodes_on_its_multiples(assets, succeeds, tmp_path):
    grids = []
    for frame in (0, 1):
        path = tmp_path / f"{frame}.npz"
        succeeds("voxelize", assets / "bar2.nilbs", "--frame", frame, "--spacing", 0.25, "-o", path)
        with np.load(path) as file:
            grids.append((file["origin"] / 0.25, file["spacing"]))
    for origin, spacing in grids:
        np.testing.assert_array_equal(origin, np.round(origin))
        assert spacing == 0.25


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--spacing", "1e-9"], "--spacing 1e-09 makes"),
        (["--resolution", "200000"], "resolution must be a whole number"),
    ],
)
def test_mistakes(assets, fails, tmp_path, words, message):
    assert message in fails("voxelize", assets / "bar3.nilbs", "--frame", 0, *words, "-o", tmp_path / "g.npz")
    assert list(tmp_path.iterdir()) == []


def test_progress_in_a_file_has_lines_and_no_carriage_return(assets, succeeds, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS", 0.0)
    with (tmp_path / "log.txt").open("w") as log:
        monkeypatch.setattr(sys, "stderr", log)
        succeeds("voxelize", assets / "bar2.nilbs", "--frame", 1, "--resolution", 20, "-o", tmp_path / "grid.npz")
    text = (tmp_path / "log.txt").read_bytes()
    assert text.splitlines()[-1].startswith(b"voxels: 100 %, ")
    assert b"\r" not in text


@pytest.mark.parametrize("quantity", ["occupancy", "distance"])
def test_a_volume_holds_the_values_of_the_arrays(assets, succeeds, tmp_path, quantity):
    tinyvdb = pytest.importorskip("tinyvdb")
    for name in ("grid.npz", "grid.vdb"):
        words = ["--frame", 1, "--quantity", quantity, "--resolution", 20, "-o", tmp_path / name]
        succeeds("voxelize", assets / "bar3.nilbs", *words)
    with np.load(tmp_path / "grid.npz") as file:
        values, origin, spacing = file["values"].astype(np.float32), file["origin"], float(file["spacing"])
    file = tinyvdb.open(str(tmp_path / "grid.vdb"))
    file.read_grids()
    grid = file.grid(0)
    assert (grid.name, grid.metadata["frame"], grid.metadata["spacing"]) == (quantity, 1, spacing)
    np.testing.assert_array_equal(grid.transform["translation"], origin)
    assert grid.float_background() == (0 if quantity == "occupancy" else values.max())
    found = np.full(values.shape, grid.float_background(), np.float32)
    sparse = grid.to_sparse()
    places = np.frombuffer(sparse["coords"], np.int32).reshape(-1, 3)
    found[tuple(places.T)] = np.frombuffer(sparse["values"], np.float32)
    np.testing.assert_array_equal(found, values)


def test_a_flat_model_has_no_volume(assets, fails, tmp_path):
    line = fails("voxelize", assets / "bar2.nilbs", "--frame", 1, "-o", tmp_path / "grid.vdb")
    assert line.endswith("this model is flat, and .vdb holds volumes in space: choose .npz")
