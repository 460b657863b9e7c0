import csv

import pytest

import nilbs
from benchmarks.creatures import COLUMNS, main
from nilbs.characters.capsule import capsule


@pytest.fixture
def folder(tmp_path):
    character = capsule(resolution=12)
    for name, seed in (("eel", 0), ("worm", 1)):
        motion = nilbs.random_motion(character, frames=4, seed=seed)
        nilbs.save_character(character, tmp_path / f"{name}.glb", motion=motion)
    return tmp_path


def scores(out):
    return list(csv.DictReader((out / "creatures.csv").read_text().splitlines()))


@pytest.mark.slow
def test_a_folder_of_creatures_is_scored(folder, capsys):
    out = folder / "out"
    assert main([str(folder), "--out", str(out), "--seeds", "2", "--points", "300", "--only", "worm"]) == 0
    rows = scores(out)
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 2 * 4 * 2  # seeds, pose sets, scores
    assert {row["creature"] for row in rows} == {"worm"}
    for row in rows:
        assert 0.8 < float(row["worst"]) <= float(row["nilbs"]) <= 1
        assert 0 < float(row["nearest"]) <= 1
    table = (out / "creatures.md").read_text()
    assert capsys.readouterr().out == table
    assert table.count("| worm |") == 4
    assert "closed, 0.0 % thin" in table
    assert "2 seeds, from 0" in table


@pytest.mark.slow
def test_a_divided_truth_is_nearer_to_the_field(folder):
    """The truth's triangles are flat, and those of a coarse mesh that bends are far from the field's."""
    errors = []
    for divide in ("0", "2"):
        out = folder / divide
        given = [str(folder), "--out", str(out), "--seeds", "1", "--points", "5000", "--only", "eel"]
        assert main([*given, "--divide", divide]) == 0
        rows = scores(out)
        errors += [1 - float(r["nilbs"]) for r in rows if (r["poses"], r["score"]) == ("far", "iou_surface")]
    assert errors[1] < 0.5 * errors[0]


def test_a_folder_without_creatures_is_refused(tmp_path, capsys):
    assert main([str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "there is no .glb file" in capsys.readouterr().err
