"""A run: the cells of a plan, each in a process with its mesh and its cores."""

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import Any

from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.progress import progress_bar
from nilbs.models.model import Model, load_model
from nilbs.race.child import Child, Died
from nilbs.race.contestants import Kind, all_kinds, missing, version
from nilbs.race.ours import ENGINE
from nilbs.race.plan import NEAR, Cell
from nilbs.race.results import FAILED, MEASURED, PROJECTED, TIME, Results, projected_seconds

# Seconds of all repeats of a contestant in a cell, above which it is not run; and those after which one is ended.
LIMIT, QUICK_LIMIT, PATIENCE, DAY = 20.0, 60.0, 1200.0, 86_400.0
# Points of a pose for which memory is measured, at most.
_MEMORY_POINTS = 100_000


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def race(
    path: str | Path,
    plan: Callable[[int], Sequence[Cell]],
    *,
    contestants: Sequence[str] = (),
    limit: float = LIMIT,
    minutes: float = float("inf"),
    seed: int = 0,
    memory: bool = True,
    progress: bool = False,
) -> Results:
    """Measure cells.

    Parameters
    ----------
    path : path
        A model's file.
    plan : function of int
        The cells for a mesh of so many triangles, in order; those of a level and a number of threads that follow each
        other share a process.
    contestants : sequence of str
        Names of those that take part beside nilbs; all by default.
    limit : float
        Seconds: what is expected to take longer with all its repeats is marked and not run.
    minutes : float
        What has not begun by then is marked and not run.
    seed : int
        Of points.
    memory : bool
        Whether to measure memory too.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    results : Results
        As far as the run came, if Ctrl-C ended it.

    Raises
    ------
    ValueError
        If the model is not in space, or a contestant does not exist.
    FileFormatError, OSError
        If the model's file cannot be read.
    """
    model = load_model(path)
    if model.character.d != 3:
        raise ValueError("the benchmark compares with meshes in space, and this model is flat (d = 2)")
    kinds = _chosen(contestants)
    start = monotonic()
    results = Results({"seed": seed, "limit_s": limit, **_about(model)})
    triangles = len(model.character.F)
    cells = plan(triangles)
    total = sum(cell.cost(triangles) for cell in cells)
    run = _Run(path, seed, limit, start + 60 * minutes, triangles, results)
    with progress_bar(total=total, desc="measuring", shown=progress, form=_BAR) as bar:
        try:
            run.kinds = _present(kinds, model, results)
            for cell in cells:
                bar.set_postfix_str(_title(cell, triangles))
                run.measure(cell)
                bar.update(cell.cost(triangles))
            bar.close()
            if memory:
                run.measure_memory(cells, progress=progress)
        except KeyboardInterrupt:
            results.interrupted = True
        finally:
            run.close()
    results.header["seconds"] = monotonic() - start
    return results


_BAR = "{desc} {percentage:3.0f}% |{bar}| {elapsed}<{remaining}{postfix}"


def _chosen(names: Sequence[str]) -> dict[str, Kind]:
    kinds = all_kinds()
    for name in names:
        if name not in kinds:
            raise ValueError(
                f"there is no contestant {name!r}{nearest_name(name, kinds)}; there are {', '.join(kinds)}"
            )
    return {name: kind for name, kind in kinds.items() if not names or name in (ENGINE, *names)}


def _present(kinds: dict[str, Kind], model: Model, results: Results) -> dict[str, Kind]:
    """The contestants that can take part; the others are noted."""
    found = {}
    for name, kind in kinds.items():
        problem = missing(kind, model)
        if problem is None:
            found[name] = kind
        else:
            results.skipped[name] = problem
    results.header["contestants"] = {
        name: {"version": version(kind), "package": kind.distribution or "nilbs-geometry", "note": kind.note}
        for name, kind in found.items()
    }
    return found


def _about(model: Model) -> dict[str, Any]:
    """The machine and the model."""
    import numpy as np

    return {
        "model": {
            "name": model.character.name,
            "method": model.method.name,
            "triangles": len(model.character.F),
            "bones": len(model.character.skeleton.BE),
            "frames": len(model.motion),
        },
        "machine": {
            "processor": _processor(),
            "cores": cores(),
            "system": platform.platform(),
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _title(cell: Cell, triangles: int) -> str:
    return f"{cell.quantity}, {cell.points:,} {cell.kind}, {triangles * 4**cell.level:,} triangles"


class _Run:
    """What a run holds between cells: the child that works, and who has failed."""

    def __init__(self, path: str | Path, seed: int, limit: float, end: float, triangles: int, results: Results) -> None:
        self.path, self.seed, self.limit, self.end = path, seed, limit, end
        self.triangles, self.results = triangles, results
        self.kinds: dict[str, Kind] = {}
        self.patience = PATIENCE if limit < PATIENCE else DAY
        self.failed: dict[tuple[str, str], str] = {}  # by contestant and quantity
        self.child: Child | None = None
        self.place: tuple[int, int] | None = None

    def measure(self, cell: Cell) -> None:
        """Add the rows of a cell."""
        running = []
        for name, kind in self.kinds.items():
            if cell.quantity not in kind.answers or (kind.streams and cell.poses == 1):
                continue
            seconds = projected_seconds(self.results.rows, {"contestant": name, **asdict(cell)})
            spent = None if seconds is None else seconds * cell.poses * (cell.repeats + 1)
            if (name, cell.quantity) in self.failed:
                self._add(cell, name, FAILED, reason=self.failed[name, cell.quantity])
            elif monotonic() > self.end:
                self._add(cell, name, TIME, reason="the run's time was up")
            elif spent is not None and spent > self.limit:
                self._add(cell, name, PROJECTED, reason=f"projected {spent:.3g} s")
            else:
                running.append(name)
        while running:
            try:
                found = self._at(cell).answer({"cell": asdict(cell), "contestants": running}, patience=self.patience)
            except Died as death:
                self.close()
                if death.turn not in running:  # before any contestant's turn: the worker itself
                    for name in running:
                        self._add(cell, name, FAILED, reason=str(death))
                    return
                self.failed[death.turn, cell.quantity] = str(death)
                self._add(cell, death.turn, FAILED, reason=str(death))
                running.remove(death.turn)
                continue
            for name, values in found.items():
                if "failed" in values:
                    self._add(cell, name, FAILED, reason=values["failed"])
                else:
                    self._add(cell, name, MEASURED, **values)
            self.results.header["pinned"] = self.child.pinned if self.child else None
            return

    def measure_memory(self, cells: Sequence[Cell], *, progress: bool) -> None:
        """Add the memory of each contestant to its rows, by quantity and mesh; each in a process of its own."""
        rows = [row for row in self.results.rows if row["status"] == MEASURED]
        self.close()
        threads = max((cell.threads for cell in cells), default=1)
        wanted = list(dict.fromkeys((r["contestant"], r["quantity"], r["level"]) for r in rows))
        for name, quantity, level in progress_bar(wanted, desc="memory", shown=progress, form=_BAR):
            if monotonic() > self.end:
                return
            same = [r for r in rows if (r["contestant"], r["quantity"], r["level"]) == (name, quantity, level)]
            points = max(min(r["points"], _MEMORY_POINTS) for r in same)
            request = {"contestant": name, "quantity": quantity, "points": points, "kind": NEAR}
            with Child(self.path, level, threads, self.seed) as child:
                try:
                    found = child.answer(request, patience=self.patience)
                except Died:
                    continue  # its times stand
            for row in same:
                row["memory_mib"] = found

    def close(self) -> None:
        """End the child."""
        if self.child is not None:
            self.child.__exit__()
        self.child = self.place = None

    def _at(self, cell: Cell) -> Child:
        """The child with the mesh and the cores of a cell."""
        if self.child is None or self.place != (cell.level, cell.threads):
            self.close()
            self.child = Child(self.path, cell.level, cell.threads, self.seed)
            self.place = cell.level, cell.threads
        return self.child

    def _add(self, cell: Cell, name: str, status: str, **values: Any) -> None:
        known = {"contestant": name, **asdict(cell), "triangles": self.triangles * 4**cell.level, "status": status}
        self.results.rows.append(known | values)
