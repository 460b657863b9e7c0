"""What a run found: rows, and from how many points on which contestant is faster."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from nilbs.race.ours import ENGINE

MEASURED, PROJECTED, TIME, FAILED = "measured", "projected", "time", "failed"
COLUMNS = (
    "contestant", "quantity", "triangles", "level", "points", "kind", "threads", "poses", "repeats", "status", "reason",
    "pose_s", "query_s", "total_s", "low_s", "high_s", "differing", "iou",
    "error_median", "error_p95", "error_p99", "error_max", "memory_mib",
)  # fmt: skip
Row = dict[str, Any]


@dataclass
class Results:
    """Rows of a run.

    Attributes
    ----------
    header : dict
        Machine, versions and settings.
    skipped : dict
        Contestants that did not take part, and why.
    rows : list of dict
        One for each cell and contestant, with the names in `COLUMNS`; None where there is no value. Times are seconds
        per pose, errors are in units of L.
    interrupted : bool
    """

    header: dict[str, Any] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    interrupted: bool = False

    def values(self) -> dict[str, Any]:
        """All as JSON holds it."""
        return {
            "schema": 1,
            **self.header,
            "skipped": self.skipped,
            "interrupted": self.interrupted,
            "rows": self.rows,
            "crossovers": crossovers(self.rows),
        }

    def write_csv(self, path: str | Path) -> None:
        """Write the rows."""
        from nilbs.io.atomic import replacing

        with replacing(path, "w") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows({name: _short(row.get(name)) for name in COLUMNS} for row in self.rows)


def _short(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else value


def measured(rows: Iterable[Row]) -> list[Row]:
    """Rows that have times."""
    return [row for row in rows if row["status"] == MEASURED]


def crossovers(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Where nilbs and another contestant change places, over the number of points, in poses that stand alone.

    Each has the contestant, the cell, and `faster`: pairs (points, name), the faster one from so many points on. A
    change is interpolated between two sizes in logarithms.
    """
    curves: dict[tuple[Any, ...], dict[str, dict[int, float]]] = {}
    keys = ("quantity", "triangles", "kind", "threads")
    for row in measured(rows):
        if row["poses"] == 1:
            key = tuple(row[name] for name in keys)
            curves.setdefault(key, {}).setdefault(row["contestant"], {})[row["points"]] = row["total_s"]
    found = []
    for key, by_name in curves.items():
        own = by_name.get(ENGINE, {})
        for name, other in by_name.items():
            if name != ENGINE and (changes := _changes(own, other, name)):
                found.append({"contestant": name, **dict(zip(keys, key, strict=True)), "faster": changes})
    return found


def _changes(own: Mapping[int, float], other: Mapping[int, float], name: str) -> list[tuple[int, str]]:
    """Pairs (points, name) of the faster one, from so many points on."""
    counts = sorted(set(own) & set(other))
    lead = [math.log(other[n] / own[n]) for n in counts]
    if not counts:
        return []
    changes = [(counts[0], ENGINE if lead[0] >= 0 else name)]
    for (n, a), (m, b) in pairwise(zip(counts, lead, strict=True)):
        if (a >= 0) != (b >= 0):
            place = round(math.exp(math.log(n) + a / (a - b) * math.log(m / n)))
            changes.append((place, ENGINE if b >= 0 else name))
    return changes


def projected_seconds(rows: Sequence[Row], cell: Mapping[str, Any]) -> float | None:
    """A pose's seconds of a contestant in a cell, from its nearest measured one; None if there is none.

    Queries grow with the points. On a mesh of four times the triangles posing takes four times as long, and queries
    twice; on fewer cores everything takes as many times longer.
    """
    near = [
        row for row in measured(rows) if row["contestant"] == cell["contestant"] and row["quantity"] == cell["quantity"]
    ]
    if not near:
        return None

    def far(row: Row) -> tuple[Any, ...]:
        return (
            row["level"] != cell["level"] or row["threads"] != cell["threads"],
            abs(row["level"] - cell["level"]),
            row["threads"] != cell["threads"],
            row["kind"] != cell["kind"],
            abs(math.log(row["points"] / cell["points"])),
        )

    row = min(near, key=far)
    finer, fewer = cell["level"] - row["level"], max(1.0, row["threads"] / cell["threads"])
    pose, query = row["pose_s"] * 4.0**finer, row["query_s"] * 2.0**finer * cell["points"] / row["points"]
    return float(fewer * (pose + query))
