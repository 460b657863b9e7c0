import signal

import pytest

from nilbs.race import child as child_module
from nilbs.race import runner
from nilbs.race.child import Child, Died
from nilbs.race.plan import Cell
from nilbs.race.runner import race

CELL = {"quantity": "occupancy", "level": 0, "points": 100, "kind": "near", "threads": 1, "repeats": 2}


def cells(*changes):
    return lambda triangles: [Cell(**CELL | change) for change in changes]


def statuses(results):
    return {(row["contestant"], row["quantity"], row["level"], row["poses"]): row["status"] for row in results.rows}


def test_a_run_measures_times_scores_and_memory(saved):
    plan = cells({}, {"quantity": "distance"}, {"poses": 2}, {"level": 1})
    results = race(saved[3], plan, contestants=["libigl"])
    wanted = [("occupancy", 0, 1), ("distance", 0, 1), ("occupancy", 0, 2), ("occupancy", 1, 1)]
    assert statuses(results) == {(name, *cell): "measured" for name in ("nilbs", "libigl") for cell in wanted}
    for row in results.rows:
        assert row["total_s"] > 0
        assert row["low_s"] <= row["total_s"] <= row["high_s"]
        assert row["differing"] < (0.001 if row["contestant"] == "libigl" else 0.2)
        if row["quantity"] == "distance":
            assert row["error_max"] < 1e-5
        assert row["memory_mib"] is None or row["memory_mib"] >= 0
    assert not results.interrupted
    values = results.values()
    assert set(values["contestants"]) == {"nilbs", "libigl"}
    assert values["rows"][-1]["triangles"] == 4 * values["model"]["triangles"]
    assert {found["contestant"] for found in values["crossovers"]} == {"libigl"}


def test_what_would_take_too_long_is_marked(saved):
    results = race(saved[3], cells({}, {"points": 200}), contestants=["libigl"], limit=1e-9, memory=False)
    first, second = results.rows[:2], results.rows[2:]
    assert [row["status"] for row in first] == ["measured", "measured"]
    assert [row["status"] for row in second] == ["projected", "projected"]
    assert second[0]["reason"].startswith("projected ")


def test_what_has_not_begun_in_time_is_marked(saved):
    results = race(saved[3], cells({}), contestants=["libigl"], minutes=0)
    assert {row["status"] for row in results.rows} == {"time"}


def test_a_contestant_that_crashes_is_left_out_and_the_others_go_on(saved, monkeypatch, tmp_path):
    # fcpw is a module that ends its process; the worker finds it before an installed one.
    (tmp_path / "fcpw.py").write_text("import os, sys\nif 'race.worker' in ' '.join(sys.orig_argv): os.abort()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    results = race(saved[3], cells({}, {"points": 200}), contestants=["libigl", "fcpw"], memory=False)
    found = {(row["contestant"], row["points"]): row for row in results.rows}
    for points in (100, 200):
        assert found["nilbs", points]["status"] == found["libigl", points]["status"] == "measured"
        assert found["fcpw", points]["status"] == "failed"
        assert found["fcpw", points]["reason"] == f"crashed with signal {signal.SIGABRT.value}"


def test_a_contestant_that_raises_is_left_out(saved, monkeypatch, tmp_path):
    (tmp_path / "fcpw.py").write_text("def scene_3D():\n    raise ValueError('no\\nscene')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    results = race(saved[3], cells({}), contestants=["fcpw"], memory=False)
    found = {row["contestant"]: row for row in results.rows}
    assert found["nilbs"]["status"] == "measured"
    assert (found["fcpw"]["status"], found["fcpw"]["reason"]) == ("failed", "no scene")


def test_a_worker_that_gives_no_answer_is_ended(saved):
    with Child(saved[3], 0, 1, 0) as child, pytest.raises(Died, match="no answer within 0 s"):
        child.answer({"cell": CELL, "contestants": []}, patience=0.01)


def test_a_worker_that_cannot_start_reports_its_last_line(tmp_path):
    with Child(tmp_path / "gone.nilbs", 0, 1, 0) as child, pytest.raises(Died, match=r"gone\.nilbs") as died:
        child.answer({"cell": CELL, "contestants": []}, patience=60)
    assert died.value.turn is None


def test_an_interrupt_leaves_what_is_done(saved, monkeypatch):
    answer, asked = child_module.Child.answer, []

    def interrupted(self, request, **options):
        asked.append(request)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return answer(self, request, **options)

    monkeypatch.setattr(child_module.Child, "answer", interrupted)
    results = race(saved[3], cells({}, {"points": 200}), contestants=["libigl"])
    assert results.interrupted
    assert [(row["points"], row["status"]) for row in results.rows] == [(100, "measured")] * 2


def test_mistakes_are_refused(saved):
    with pytest.raises(ValueError, match="flat"):
        race(saved[2], cells({}))
    with pytest.raises(ValueError, match=r"no contestant 'igl' \(the nearest: 'libigl'\); there are nilbs, "):
        race(saved[3], cells({}), contestants=["igl"])


def test_cores_are_counted():
    assert runner.cores() >= 1
