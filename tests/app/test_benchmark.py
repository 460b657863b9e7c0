import csv
import json

import pytest

from nilbs.race.plan import Cell


@pytest.fixture
def quick_plan(monkeypatch):
    """Two sizes that take no time."""

    def plan(levels, *, threads):
        return [Cell("occupancy", 0, n, "near", 1, repeats=2) for n in (10, 100)]

    monkeypatch.setattr("nilbs.race.plan.quick", plan)


@pytest.mark.usefixtures("quick_plan")
def test_files_and_output(assets, nilbs, tmp_path):
    words = (assets / "bar3.nilbs", "--quick", "--contestants", "libigl", "-o", tmp_path / "out")
    status, out, _ = nilbs("benchmark", *words)
    assert status == 0
    assert "occupancy of 100 points near the surface" in out
    found = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert [(row["contestant"], row["points"]) for row in found["rows"]] == [
        ("nilbs", 10), ("libigl", 10), ("nilbs", 100), ("libigl", 100),
    ]  # fmt: skip
    with open(tmp_path / "out" / "benchmark.csv") as file:
        assert len(list(csv.DictReader(file))) == 4
    assert (tmp_path / "out" / "benchmark.txt").read_text() == out
    assert "<td" in (tmp_path / "out" / "report.html").read_text()
    assert (tmp_path / "out" / "occupancy-1-thread.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("quick_plan")
def test_json(assets, succeeds):
    found = succeeds("benchmark", assets / "bar3.nilbs", "--quick", "--contestants", "libigl")
    assert {row["status"] for row in found["rows"]} == {"measured"}


def test_mistakes(assets, fails, tmp_path):
    assert "this model is flat" in fails("benchmark", assets / "bar2.nilbs", "--quick")
    assert "there is no contestant 'x'" in fails("benchmark", assets / "bar3.nilbs", "--contestants", "x")
    assert fails("benchmark", tmp_path / "a.nilbs") == f"{tmp_path / 'a.nilbs'}: No such file or directory"
    assert "this process may use" in fails("benchmark", assets / "bar3.nilbs", "--threads", "4000")
    (tmp_path / "file").write_text("")
    assert fails("benchmark", assets / "bar3.nilbs", "-o", tmp_path / "file").endswith("expected a folder")


def test_an_interrupt_prints_what_is_done(assets, nilbs, monkeypatch, tmp_path):
    from nilbs.race import runner

    def interrupted(run, cell):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner._Run, "measure", interrupted)
    status, out, err = nilbs("benchmark", assets / "bar3.nilbs", "--quick", "--contestants", "libigl", "-o", tmp_path)
    assert status == 130
    assert out.endswith("interrupted: only a part was measured\n")
    assert err.endswith(f"nilbs: interrupted; what was measured is printed, and in {tmp_path}\n")
    assert json.loads((tmp_path / "benchmark.json").read_text())["interrupted"] is True
