"""The results as text."""

from collections.abc import Sequence
from typing import Any

from nilbs.race.contestants import DISTANCE
from nilbs.race.ours import ENGINE
from nilbs.race.plan import NEAR
from nilbs.race.results import MEASURED, Results, Row, crossovers

# A run with more cells shows those of these sizes, and streams.
_ALL, _SHOWN = 12, (10**3, 10**5)
_CELL = ("quantity", "triangles", "points", "kind", "threads", "poses", "repeats")


def table(results: Results) -> str:
    """Times by cell, with ratios to nilbs; then where contestants change places, and who did not take part."""
    machine, model = results.header["machine"], results.header["model"]
    lines = [
        f"{model['name']}, {model['bones']} bones, method {model['method']}; {machine['processor']}, "
        f"{machine['cores']} {'core' if machine['cores'] == 1 else 'cores'}, Python {machine['python']}",
        "milliseconds per pose: skin, build or refit (pose), then query; medians of repeats that take turns",
        "times nilbs: total divided by that of nilbs, so that more than 1 is slower than nilbs",
    ]
    cells: dict[tuple[Any, ...], list[Row]] = {}
    for row in results.rows:
        cells.setdefault(tuple(row[name] for name in _CELL), []).append(row)
    few = len(cells) <= _ALL
    threads = max((cell[4] for cell in cells), default=1)
    for cell, rows in cells.items():
        if few or cell[5] > 1 or (cell[2] in _SHOWN and cell[4] == threads):
            lines += ["", *_section(rows)]
    changes = [line for line in map(_change, crossovers(results.rows)) if line]
    if changes and not few:
        lines += ["", "the faster one, by the points of a pose", *changes]
    lines += ["", *(f"skipped: {name}: {reason}" for name, reason in results.skipped.items())]
    if results.interrupted:
        lines.append("interrupted: only a part was measured")
    return "\n".join(lines).rstrip()


def cell_title(row: Row) -> str:
    """One line on what a cell is.

    Examples
    --------
    >>> cell = {"quantity": "occupancy", "points": 1000, "kind": "near", "triangles": 12064, "threads": 2}
    >>> cell_title(cell | {"poses": 1, "repeats": 5})
    'occupancy of 1,000 points near the surface, 12,064 triangles, 2 threads'
    """
    where = "near the surface" if row["kind"] == NEAR else "uniform in a cube"
    what = {DISTANCE: "signed distance"}.get(row["quantity"], row["quantity"])
    threads = f"{row['threads']} thread{'s' if row['threads'] > 1 else ''}"
    stream = f", a stream of {row['poses'] * row['repeats']:,} poses" if row["poses"] > 1 else ""
    return f"{what} of {row['points']:,} points {where}, {row['triangles']:,} triangles, {threads}{stream}"


def _section(rows: Sequence[Row]) -> list[str]:
    distance = rows[0]["quantity"] == DISTANCE
    heads = ["pose", "query", "total", "times nilbs", "differ %", "IoU"]
    heads += ["median", "p95", "p99", "max"] if distance else []
    own = next((row["total_s"] for row in rows if row["contestant"] == ENGINE and row["status"] == MEASURED), None)
    width = max(len(row["contestant"]) for row in rows) + 2
    lines = [cell_title(rows[0]), " " * width + "".join(f"{head:>12}" for head in [*heads, "MiB"])]
    if distance:
        lines[0] += "; errors of length in L"
    for row in rows:
        if row["status"] != MEASURED:
            lines.append(f"{row['contestant']:<{width}}  not run: {row['reason']}")
            continue
        cells = [f"{1000 * row[name]:.2f}" for name in ("pose_s", "query_s", "total_s")]
        cells.append("-" if own is None else f"{row['total_s'] / own:.2f}")
        cells += [f"{100 * row['differing']:.3f}", f"{row['iou']:.4f}"]
        if distance:
            cells += [f"{row[f'error_{name}']:.1e}" for name in ("median", "p95", "p99", "max")]
        memory = row.get("memory_mib")
        cells.append("-" if memory is None else f"{memory:.0f}")
        lines.append(f"{row['contestant']:<{width}}" + "".join(f"{cell:>12}" for cell in cells))
    return lines


def _change(found: dict[str, Any]) -> str:
    (_, leader), *later = found["faster"]
    text = ", ".join([leader, *(f"{name} from {points:,} on" for points, name in later)])
    title = f"{found['quantity']}, {found['kind']}, {found['triangles']:,} triangles, {found['threads']} threads"
    return f"{title}: nilbs and {found['contestant']}: {text}"
