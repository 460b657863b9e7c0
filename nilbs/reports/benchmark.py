"""The page of `nilbs benchmark`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nilbs.figures.views import View
from nilbs.geometry.surface import Surface
from nilbs.race.ours import ENGINE
from nilbs.race.results import MEASURED
from nilbs.race.table import cell_title
from nilbs.reports.page import Cell, Page, Picture, Scene, Table
from nilbs.reports.scene import scene_of_surfaces

if TYPE_CHECKING:
    from nilbs.characters.character import Character

FILE = "report.html"
_CELL = ("quantity", "triangles", "points", "kind", "threads", "poses", "repeats")
# Columns of a cell: the name, that of the results, and what it is multiplied by.
_TIMES = (("pose, ms", "pose_s", 1e3), ("query, ms", "query_s", 1e3), ("total, ms", "total_s", 1e3))
_AGREEMENT = (("differ, %", "differing", 100.0), ("IoU", "iou", 1.0), ("memory, MiB", "memory_mib", 1.0))


def write_benchmark_page(
    folder: str | Path, character: "Character", values: Mapping[str, Any], *, pictures: Sequence[Path] = ()
) -> Path:
    """Write report.html into an existing folder.

    Parameters
    ----------
    folder : path
    character : Character
        That of the model, in space.
    values : mapping
        What benchmark.json holds.
    pictures : sequence of Path
        PNG files to show.
    """
    path = Path(folder) / FILE
    model, machine = values["model"], values["machine"]
    cells: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in values["rows"]:
        cells.setdefault(tuple(row[name] for name in _CELL), []).append(row)
    tables = [times_table(rows) for rows in cells.values()]
    if values["skipped"]:
        skipped = [[Cell(name), Cell(reason)] for name, reason in values["skipped"].items()]
        tables.append(Table("Did not take part", ["contestant", "reason"], skipped))
    surface = {"rest|mesh": (Surface(character.V, character.F), None)}
    partial = " It was interrupted: only a part was measured." if values["interrupted"] else ""
    Page(
        title=f"{model['name']}: benchmark",
        summary=f"nilbs beside libraries that query the posed mesh; medians of repeats that take turns.{partial}",
        facts={
            "method": model["method"],
            "bones": model["bones"],
            "processor": machine["processor"],
            "cores": machine["cores"],
            "Python": machine["python"],
        },
        tables=tables,
        scene=Scene("The character", scene_of_surfaces(surface, View.front(character.V))),
        pictures=[Picture(picture.stem, picture) for picture in pictures],
    ).write(path)
    return path


def times_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """A cell: times of each contestant, and how they compare with nilbs."""
    own = next((row["total_s"] for row in rows if row["contestant"] == ENGINE and row["status"] == MEASURED), None)
    lines = []
    for row in rows:
        done = row["status"] == MEASURED
        line = [
            Cell(row["contestant"], "" if done else f"not run: {row['reason']}", marked=row["contestant"] == ENGINE)
        ]
        line += [Cell(_times(row, name, factor)) for _, name, factor in _TIMES]
        line.append(Cell(row["total_s"] / own if done and own else None))
        line += [Cell(_times(row, name, factor)) for _, name, factor in _AGREEMENT]
        lines.append(line)
    heads = [name for name, *_ in _TIMES] + ["times nilbs"] + [name for name, *_ in _AGREEMENT]
    title = cell_title(dict(rows[0]))
    return Table(f"{title[0].upper()}{title[1:]}", ["contestant", *heads], lines)


def _times(row: Mapping[str, Any], name: str, factor: float) -> float | None:
    value = row.get(name)
    return None if value is None or row["status"] != MEASURED else factor * value
