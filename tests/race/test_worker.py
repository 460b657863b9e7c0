import json
import os
import subprocess
import sys

import numpy as np
import pytest

from nilbs.race.worker import Worker, free_memory


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system pins no processes")
def test_a_process_is_pinned_before_libraries_count_cores():
    code = "import os; from nilbs.race.worker import pin; print(pin(1), len(os.sched_getaffinity(0)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "True 1\n"


@pytest.mark.skipif(not os.path.exists("/proc/self/clear_refs"), reason="the system reports no memory")
def test_memory_of_a_contestant(models, monkeypatch):
    from nilbs.race.contestants import Kind, all_kinds

    class Holding:
        def __init__(self, model, quantity, threads):
            self.held = np.ones(2**22)  # 32 MiB

        def points(self, x):
            return x

        def pose(self, B):
            self.posed = np.ones(2**21)  # 16 MiB

        def query(self, x):
            return np.zeros(len(x), dtype=bool)

    kinds = all_kinds() | {"holding": Kind("holding", ("occupancy",), Holding, "numpy")}
    monkeypatch.setattr("nilbs.race.contestants.all_kinds", lambda: kinds)
    worker = Worker(models[3], 1, 0)
    free_memory()
    found = worker.memory(contestant="holding", quantity="occupancy", points=10, kind="near", send=lambda message: None)
    assert found == pytest.approx(48, abs=8)


def test_what_libraries_print_is_no_answer(saved, tmp_path):
    (tmp_path / "fcpw.py").write_text("print('hello from a library')\nraise ValueError('no')\n")
    words = [sys.executable, "-m", "nilbs.race.worker", str(saved[3]), "0", "1", "0"]
    cell = {"quantity": "occupancy", "level": 0, "points": 10, "kind": "near", "threads": 1}
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    request = json.dumps({"cell": cell, "contestants": ["fcpw"]}) + "\n"
    done = subprocess.run(
        words, input=request, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, timeout=120
    )
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    assert messages[-1] == {"done": {"fcpw": {"failed": "no"}}}
    assert "hello from a library" in done.stderr
