"""What the study writes: JSON, CSV, Markdown and one HTML page, of all results."""

import csv
import io
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import nilbs
from benchmarks.study import results
from benchmarks.study.characters import SOURCES
from benchmarks.study.curves import sweep_curves, twist_curve
from benchmarks.study.jobs import FAILURES, TWIST, Plan
from benchmarks.study.pages import Page, Picture, html, markdown
from benchmarks.study.scale import Scale
from benchmarks.study.store import Store
from benchmarks.study.tables import study_tables
from nilbs.io.atomic import replacing
from nilbs.io.strict_json import plain

FILES = ("study.json", "scores.csv", "study.md", "study.html")
COLUMNS = ("part", "character", "method", "value", "seed", "poses", "score", "mean", "worst")
_PACKAGES = ("numpy", "torch", "scipy", "libigl", "scikit-image")


def write_outputs(
    plan: Plan,
    store: Store,
    scale: Scale,
    *,
    command: Sequence[str] = (),
    quick: bool = False,
    lanes: int = 1,
    threads: int | None = None,
) -> dict[str, Any]:
    """Write tables, curves and the report of all results that there are.

    Parameters
    ----------
    plan : Plan
    store : Store
    scale : Scale
    command : sequence of str
        That made the study.
    quick : bool
        Whether numbers mean nothing, which the report then states.
    lanes, threads : int
        How many jobs ran at once, and the threads of each.

    Returns
    -------
    values : dict
        What study.json holds.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    titles = {name: source.title for name, source in SOURCES.items()}
    known = results.scores(plan, store)
    tables = study_tables(plan, store, titles)
    failed, unfinished = results.failed(plan, store), results.unfinished(plan, store)
    machine = machine_facts() | {"jobs_at_once": lanes, "threads": threads}
    minutes = results.wall_minutes(plan, store)
    values = plain(
        {
            "schema": 1,
            "command": list(command),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": machine,
            "wall_minutes": minutes,
            "scale": asdict(scale),
            "rows": results.long_form(known),
            "trainings": results.trainings(plan, store),
            "twist": [result["table"] for _, result in results.others(plan, store, TWIST)],
            "controls": results.controls(plan, store),
            "failed": failed,
            "unfinished": unfinished,
            "missing": list(plan.missing),
        }
    )
    page = Page(
        title="A study of neural inverse linear blend skinning and its rivals",
        facts=_facts(values, scale, len(plan.jobs)),
        tables=tables,
        pictures=_pictures(plan, store, known, titles),
        missing=[
            *plan.missing,
            *(f"{key} failed: {why}" for key, why in failed.items()),
            *_unfinished(unfinished, failed),
        ],
        notes=("A quick run that only shows that everything works: its numbers mean nothing.",) if quick else (),
    )
    texts = (
        json.dumps(values, indent=1, allow_nan=False) + "\n",
        csv_text(known),
        markdown(page),
        html(page),
    )
    for name, text in zip(FILES, texts, strict=True):
        with replacing(store.folder / name, "w") as file:
            file.write(text)
    return dict(values)


def csv_text(known: Sequence[results.Score]) -> str:
    """Scores in long form; what is undefined is empty.

    Examples
    --------
    >>> csv_text([results.Score("methods", "arm", "nilbs", None, 0, "seen", "iou_bbox", 0.5, None)]).splitlines()[1]
    'methods,arm,nilbs,,0,seen,iou_bbox,0.5,'
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(results.long_form(known))
    return text.getvalue()


def machine_facts() -> dict[str, Any]:
    """Processor, cores and versions of what computes."""
    versions = {"nilbs": nilbs.__version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "processor": _processor(),
        "cores": cores(),
        "system": platform.system(),
        "versions": versions,
    }


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def _facts(values: Mapping[str, Any], scale: Scale, jobs: int) -> dict[str, str]:
    machine = values["machine"]
    threads, lanes = machine["threads"], machine["jobs_at_once"]
    share = f"{lanes} at once" if lanes > 1 else "one after the other"
    share += "" if threads is None else f", each on {threads} thread{'s' if threads > 1 else ''}"
    minutes, done = round(values["wall_minutes"]), jobs - len(values["unfinished"])
    training = ", ".join(f"{name} {value:g} min" for name, value in scale.minutes.items() if name in scale.characters)
    if scale.sweep_minutes is not None:
        training += f"{', ' if training else ''}sweeps {scale.sweep_minutes:g} min"
    return {
        "machine": f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, no GPU used",
        "trainings and scorings": share,
        "versions": ", ".join(f"{name} {number}" for name, number in machine["versions"].items()),
        "date": values["date"],
        "command": " ".join(values["command"]),
        "time": f"{minutes // 60}:{minutes % 60:02} h of work for {done} of {jobs} jobs",
        "training": training or "a fixed number of steps",
        "training frames": f"{scale.training_frames}, evenly spaced, where the motion has as many{_fewer(values)}",
        "points": f"{scale.points} uniform and {scale.points} near the surface, a frame",
        "grid of surfaces": f"{scale.resolution} cells along the longest edge",
    }


def _fewer(values: Mapping[str, Any]) -> str:
    """Characters whose motions have fewer frames than the study takes, and how many."""
    taken = [(t["character"], t["frames"], t["result"]["frames"]) for t in values["trainings"] if t["result"]]
    fewer = {character: frames for character, needed, frames in taken if frames < needed}
    return "".join(f"; {character} {frames}" for character, frames in fewer.items())


def _pictures(
    plan: Plan, store: Store, known: Sequence[results.Score], titles: Mapping[str, str]
) -> dict[str, list[Picture]]:
    folder = store.folder / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    caption = "One seed; the same numbers as in the tables."
    found = {part: [Picture("Curves", caption, path)] for part, path in sweep_curves(known, folder).items()}
    for _, result in results.others(plan, store, TWIST):
        path = twist_curve(result["table"], folder / "twist.png")
        if path is not None:
            found["twist"] = [
                Picture(
                    "Volume ratio",
                    "Near 1 is right, but for lbs, which shows what skinning itself loses; the table has the numbers.",
                    path,
                )
            ]
    for picture in results.pictures(plan, store):
        part = "failures" if picture["kind"] == FAILURES else "methods"
        title = titles.get(picture["title"], picture["title"])
        found.setdefault(part, []).append(Picture(title, picture["caption"], store.folder / picture["file"]))
    return found


def _unfinished(unfinished: Sequence[str], failed: Mapping[str, str]) -> list[str]:
    left = [key for key in unfinished if key not in failed]
    return [f"not run yet: {', '.join(left)}"] if left else []
