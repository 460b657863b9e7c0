import csv

import pytest

from nilbs.race.results import COLUMNS, Results, crossovers, projected_seconds
from nilbs.race.table import table

CELL = {"quantity": "occupancy", "triangles": 500, "level": 0, "kind": "near", "threads": 2, "poses": 1, "repeats": 5}
HEADER = {
    "machine": {"processor": "a processor", "cores": 2, "python": "3.11.7"},
    "model": {"name": "bar", "bones": 2, "method": "nilbs"},
}


def row(name, points, seconds, **more):
    scores = {"differing": 0.01, "iou": 0.99}
    times = {"pose_s": seconds / 2, "query_s": seconds / 2, "total_s": seconds, "low_s": seconds, "high_s": seconds}
    return {"contestant": name, "points": points, "status": "measured", **CELL, **times, **scores, **more}


def failed(name, points, status, reason):
    return {"contestant": name, "points": points, "status": status, "reason": reason, **CELL}


def test_a_crossover_lies_where_two_power_laws_meet():
    # nilbs takes 1 ms; the other 1 ms per 1,000 points: they meet at 1,000.
    rows = [row("nilbs", n, 1e-3) for n in (100, 10_000)] + [row("mesh", n, n * 1e-6) for n in (100, 10_000)]
    (found,) = crossovers(rows)
    assert found["contestant"] == "mesh"
    assert found["faster"] == [(100, "mesh"), (1000, "nilbs")]


def test_who_is_always_faster_has_no_crossover():
    rows = [row("nilbs", n, 2e-3) for n in (100, 1000)] + [row("mesh", n, 1e-3) for n in (100, 1000, 10_000)]
    assert crossovers(rows)[0]["faster"] == [(100, "mesh")]


def test_streams_and_cells_that_were_not_run_have_no_part_in_crossovers():
    rows = [
        row("nilbs", 100, 1.0),
        row("mesh", 100, 2.0, poses=10),
        failed("mesh", 1000, "projected", "projected 30 s"),
    ]
    assert crossovers(rows) == []


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ({}, 2.0),
        ({"points": 10_000}, 11.0),  # ten times the query
        ({"level": 1}, 6.0),  # four times the pose and twice the query
        ({"threads": 1}, 4.0),
    ],
)
def test_projection(cell, seconds):
    rows = [row("mesh", 1000, 2.0)]
    wanted = {"contestant": "mesh", **CELL, "points": 1000, **cell}
    assert projected_seconds(rows, wanted) == pytest.approx(seconds)


def test_nothing_is_projected_from_others():
    rows = [
        row("nilbs", 1000, 2.0),
        failed("mesh", 1000, "failed", "crashed"),
        row("mesh", 1000, 2.0, quantity="distance"),
    ]
    assert projected_seconds(rows, {"contestant": "mesh", **CELL, "points": 1000}) is None


def test_projection_starts_from_the_nearest_cell():
    rows = [row("mesh", 100, 9.0), row("mesh", 1000, 2.0), row("mesh", 1000, 7.0, threads=1)]
    assert projected_seconds(rows, {"contestant": "mesh", **CELL, "points": 1000}) == pytest.approx(2.0)


def test_table_has_ratios_and_reasons():
    rows = [
        row("nilbs", 1000, 2e-3, memory_mib=12.3),
        row("mesh", 1000, 5e-3),
        failed("slow", 1000, "projected", "projected 30 s"),
    ]
    text = table(Results(HEADER, {"gone": "not installed: pip install gone"}, rows, interrupted=True))
    lines = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line}
    assert lines["nilbs"] == ["1.00", "1.00", "2.00", "1.00", "1.000", "0.9900", "12"]
    assert lines["mesh"][2:4] == ["5.00", "2.50"]
    assert "slow     not run: projected 30 s" in text
    assert "skipped: gone: not installed: pip install gone" in text
    assert text.endswith("interrupted: only a part was measured")


def test_a_long_run_prints_two_sizes_and_crossovers():
    counts = [10**k for k in range(2, 6)]
    rows = [
        row(name, n, seconds(n), triangles=triangles, level=triangles // 500)
        for triangles in (500, 2000, 8000, 32_000)
        for n in counts
        for name, seconds in (("nilbs", lambda n: 1e-3), ("mesh", lambda n: n * 1e-6))
    ]
    text = table(Results(HEADER, {}, rows))
    assert text.count("occupancy of 1,000 points") == text.count("occupancy of 100,000 points") == 4
    assert "occupancy of 100 points" not in text
    assert "occupancy, near, 500 triangles, 2 threads: nilbs and mesh: mesh, nilbs from 1,000 on" in text


def test_distances_have_their_errors():
    errors = {f"error_{name}": value for name, value in (("median", 1e-7), ("p95", 2e-7), ("p99", 3e-7), ("max", 4e-7))}
    text = table(Results(HEADER, {}, [row("nilbs", 10, 1.0, **errors, quantity="distance")]))
    assert "signed distance of 10 points" in text
    assert "1.0e-07" in text
    assert "4.0e-07" in text


def test_csv_holds_every_row(tmp_path):
    rows = [row("nilbs", 1000, 2e-3), failed("slow", 1000, "projected", "projected 30 s")]
    Results(HEADER, {}, rows).write_csv(tmp_path / "a.csv")
    with open(tmp_path / "a.csv") as file:
        found = list(csv.DictReader(file))
    assert list(found[0]) == list(COLUMNS)
    assert [(r["contestant"], r["status"], r["total_s"], r["reason"]) for r in found] == [
        ("nilbs", "measured", "0.002", ""),
        ("slow", "projected", "", "projected 30 s"),
    ]
