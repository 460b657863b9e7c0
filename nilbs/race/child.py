"""A worker as the run sees it: requests, answers, and how it ended."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Timer
from typing import Any, Self

import nilbs.race

# Where the package lies, so that a child finds the one that its parent runs.
_FOLDER = Path(nilbs.race.__file__).parents[2]
# Environment variables by which libraries count their threads.
_THREADS = ("OMP_NUM_THREADS", "NILBS_THREADS", "LIBIGL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Died(Exception):
    """A worker ended before its answer; the message says how, `turn` whose turn it was."""

    def __init__(self, message: str, turn: str | None) -> None:
        super().__init__(message)
        self.turn = turn


class Child:
    """A worker in a process of its own.

    Parameters
    ----------
    path : path
        The model's file.
    level : int
        Of subdivision.
    threads : int
        Cores that it runs on.
    seed : int
    """

    def __init__(self, path: str | Path, level: int, threads: int, seed: int) -> None:
        words = [sys.executable, "-m", "nilbs.race.worker", str(path), str(level), str(threads), str(seed)]
        paths = [str(_FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONSAFEPATH": "1"}
        environment |= dict.fromkeys(_THREADS, str(threads))
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (kept open)
        # A session of its own: Ctrl-C is for the parent.
        self._process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True, env=environment,
            start_new_session=True,
        )  # fmt: skip
        self.pinned: bool | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.communicate()
        self._errors.close()

    def answer(self, request: dict[str, Any], *, patience: float) -> Any:
        """The answer to a request; raises `Died` if there is none within so many seconds."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        turn, late = None, False

        def stop() -> None:
            nonlocal late
            late = True
            self._process.kill()

        timer = Timer(patience, stop)
        timer.start()
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            for line in self._process.stdout:
                message = json.loads(line)
                if "done" in message:
                    return message["done"]
                turn, self.pinned = message.get("turn", turn), message.get("pinned", self.pinned)
        except BrokenPipeError:
            pass  # its end is reported below
        finally:
            timer.cancel()
        status = self._process.wait()
        if late:
            raise Died(f"no answer within {patience:.0f} s", turn)
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines() or [f"exit status {status}"]
        raise Died(f"crashed with signal {-status}" if status < 0 else lines[-1], turn)
