"""The command itself."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from benchmarks.study.__main__ import main
from benchmarks.study.outputs import FILES
from benchmarks.study.plan import PARTS
from benchmarks.study.runner import Worker
from benchmarks.study.scale import quick_scale
from benchmarks.study.worker import do


def test_options_that_contradict_are_refused(tmp_path, capsys) -> None:
    out = str(tmp_path / "out")
    assert main(["--out", out, "--quick", "--seeds", "2"]) == 2
    assert re.search("--seeds.*--quick", capsys.readouterr().err)
    assert main(["--out", out, "--data", str(tmp_path / "none")]) == 2
    assert re.search(r"none: .*--data", capsys.readouterr().err)
    for words in (["--minutes", "0"], ["--only", "everything"], ["--seeds", "0"], ["--seeds", "101"]):
        with pytest.raises(SystemExit) as stop:
            main(["--out", out, *words])
        assert stop.value.code == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("taken", ["out", "out/pictures"])
def test_a_file_in_place_of_a_folder_is_reported_before_the_work(taken: str, tmp_path, capsys) -> None:
    path = tmp_path / taken
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine")
    assert main(["--out", str(tmp_path / "out"), "--quick"]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert f"{taken.rpartition('/')[2]}: this is a file" in line
    assert path.read_text() == "mine"


def test_a_study_that_is_stopped_leaves_tables_and_can_be_continued(tmp_path, capsys, monkeypatch) -> None:
    def stopped(worker, job) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr("benchmarks.study.runner.Worker.__call__", stopped)
    assert main(["--out", str(tmp_path), "--quick"]) == 130
    assert "same command" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {*FILES, "lock"}


def test_failed_jobs_are_reported_and_the_status_is_two(tmp_path, capsys, monkeypatch) -> None:
    def failing(worker, job) -> bool:
        worker._store.fail(job, "ValueError: no luck")
        return False

    monkeypatch.setattr("benchmarks.study.runner.Worker.__call__", failing)
    assert main(["--out", str(tmp_path), "--quick", "--only", "twist", "--json"]) == 2
    printed = capsys.readouterr()
    assert json.loads(printed.out)["failed"] == {"twist/capsule": "ValueError: no luck"}
    lines = printed.err.splitlines()
    assert "nilbs: twist/capsule failed: ValueError: no luck" in lines
    assert "1 of 1 jobs failed" in lines[-1]


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_volumes")
def test_the_quick_study_runs_for_real_and_is_not_run_again(tmp_path, capsys, monkeypatch) -> None:
    # In this process, so that it works with coarse volumes and small pictures; test_runner.py has workers as they are.
    monkeypatch.setattr(Worker, "__call__", lambda worker, job: do(job, worker._store, worker._data))
    monkeypatch.setattr("benchmarks.study.failures.PIXELS", 60)
    flat = replace(quick_scale(), characters={"gingerbread-2d": 1})
    monkeypatch.setattr("benchmarks.study.scale.quick_scale", lambda: flat)
    monkeypatch.setattr("benchmarks.study.failures.FIN_PIXELS", 80)
    out = tmp_path / "study"
    assert main(["--out", str(out), "--quick", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["failed"] == {}
    assert values["unfinished"] == []
    written = json.loads((out / "study.json").read_text())
    known = {(row["part"], row["method"]) for row in written["rows"]}
    assert {part for part, _ in known} == set(PARTS) - {"twist", "failures"}
    assert {method for part, method in known if part in ("methods", "ablation")} >= {
        "nilbs", "paper", "inverse", "reverse", "fixed-point", "one-search", "all-bones", "nasa", "nasa-rigid", "snarf",
        "mlp", "nearest", "rigid-parts", "floor", "mesh-lbs",
    }  # fmt: skip
    for controls in written["controls"].values():
        assert set(controls["perfect"].values()) == {1.0}
        assert set(controls["empty"].values()) | set(controls["inverted"].values()) == {0.0}
    page = ElementTree.fromstring((out / "study.html").read_text().replace("<!DOCTYPE html>", ""))
    assert len(list(page.iter("img"))) >= 6
    before = {path: path.stat().st_mtime_ns for path in (out / "results").rglob("*.json")}
    assert main(["--out", str(out), "--quick", "--json"]) == 0
    assert {path: path.stat().st_mtime_ns for path in (out / "results").rglob("*.json")} == before
