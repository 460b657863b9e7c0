"""The process that measures: one mesh, so many cores, one cell a line.

It reads requests as lines of JSON and answers each with lines of JSON: the contestant whose turn it is, and at the end
the result. A library that crashes takes this process with it and not the run.
"""

import ctypes
import gc
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nilbs.models.model import Model
    from nilbs.race.contestants import Contestant
    from nilbs.race.plan import Cell
    from nilbs.race.scenes import Scene, Truth

Message = Callable[[dict[str, Any]], None]


def main() -> None:
    """Answer requests until there are no more."""
    path, level, threads, seed = sys.argv[1], *map(int, sys.argv[2:5])
    pinned = pin(threads)  # before libraries count cores
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer

    def send(message: dict[str, Any]) -> None:
        out.write(json.dumps(message) + "\n")
        out.flush()

    from nilbs.models.model import load_model
    from nilbs.race.subdivision import subdivided_model

    worker = Worker(subdivided_model(load_model(path), level), threads, seed)
    send({"pinned": pinned})
    for line in sys.stdin:
        request = json.loads(line)
        answer = worker.memory if "contestant" in request else worker.cell
        send({"done": answer(send=send, **request)})


def pin(threads: int) -> bool:
    """Run on so many cores from now on; False where the system has no such call."""
    if not hasattr(os, "sched_setaffinity"):
        return False
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    return True


class Worker:
    """Contestants of a mesh, made when they are first needed and kept."""

    def __init__(self, model: "Model", threads: int, seed: int) -> None:
        from nilbs.engine.compiled import set_threads

        self.model, self.threads, self.seed = model, threads, seed
        self.made: dict[tuple[str, str], Contestant] = {}
        self.truths: dict[tuple[int, str, int], Truth] = {}
        set_threads(threads)

    def contestant(self, name: str, quantity: str) -> "Contestant":
        """A contestant by its name."""
        from nilbs.race.contestants import all_kinds

        if (name, quantity) not in self.made:
            self.made[name, quantity] = all_kinds()[name].make(self.model, quantity, self.threads)
        return self.made[name, quantity]

    def cell(self, *, cell: dict[str, Any], contestants: list[str], send: Message) -> dict[str, dict[str, Any]]:
        """Times and scores of a cell by contestant, or why it failed."""
        from nilbs.race.measure import times, warm_up
        from nilbs.race.plan import Cell
        from nilbs.race.scenes import scenes

        asked = Cell(**cell)

        def block(k: int) -> "list[Scene]":
            if asked.poses == 1:
                return first
            return scenes(self.model, asked.points, asked.kind, asked.poses, k, asked.repeats, seed=self.seed)

        if asked.poses == 1:
            first = scenes(self.model, asked.points, asked.kind, 1, 0, 1, seed=self.seed)
        else:
            first = block(asked.repeats // 2)[:1]
        found: dict[str, dict[str, Any]] = {}
        running = {}
        truth = self._truth(asked, first[0])
        for name in contestants:
            send({"turn": name})
            try:
                contestant = self.contestant(name, asked.quantity)
                answer = warm_up(contestant, first[0])
            except Exception as error:  # of any library: the others go on
                found[name] = {"failed": " ".join(str(error).split())[:200] or type(error).__name__}
                continue
            running[name] = contestant
            found[name] = truth.scores(asked.quantity, answer)
        measured = times(running, block, asked.repeats, turn=lambda name: send({"turn": name}))
        for name, values in measured.items():
            found[name] |= values
        return found

    def _truth(self, cell: "Cell", scene: "Scene") -> "Truth":
        from nilbs.race.scenes import Truth

        key = cell.points, cell.kind, cell.poses
        if key not in self.truths:
            self.truths[key] = Truth(self.model, scene)
        return self.truths[key]

    def memory(self, *, contestant: str, quantity: str, points: int, kind: str, send: Message) -> float | None:
        """Most MiB that a contestant adds to the process; None where the system does not report it.

        Skinning is there before, and so is code: all is done once and freed first. What the model's file holds for the
        contestant is added.
        """
        from dataclasses import replace

        from nilbs.race.contestants import all_kinds
        from nilbs.race.measure import warm_up
        from nilbs.race.ours import kept_bytes
        from nilbs.race.scenes import scenes

        send({"turn": contestant})
        taking_part = all_kinds()[contestant]
        (scene,) = scenes(self.model, points, kind, 1, 0, 1, seed=self.seed)

        def run() -> None:
            model = replace(self.model)  # its engine is made anew
            model.skinning = self.model.skinning
            warm_up(taking_part.make(model, quantity, self.threads), scene)

        run()
        free_memory()
        before = resident("VmRSS", reset=True)
        run()
        after = resident("VmHWM")
        if before is None or after is None:
            return None
        return max(after - before, 0.0) + kept_bytes(taking_part, self.model) / 2**20


def free_memory() -> None:
    """Return to the system what was freed, as far as its library can."""
    gc.collect()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def resident(name: str, *, reset: bool = False) -> float | None:
    """Memory of this process in MiB, "VmRSS" now or "VmHWM" at most since the last reset; None if not reported."""
    with suppress(OSError):
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith(f"{name}:")]
    return int(found[0]) / 2**10 if found else None


if __name__ == "__main__":
    main()
