"""Runs the jobs of a plan that are not done yet, each in a fresh process, and reports progress."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from time import monotonic

from benchmarks.study.jobs import TRAIN, Job, Plan
from benchmarks.study.store import Store
from nilbs.characters.report import Report

Do = Callable[[Job], bool]
_PATIENCE = 5.0  # seconds that a worker has to end
# What the libraries read the number of threads from.
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "IGL_NUM_THREADS")


class Stopped(Exception):
    """A job was stopped from outside; it has neither succeeded nor failed."""


class Worker:
    """A process that does jobs, one after the other.

    Parameters
    ----------
    store : Store
    data : path, optional
        Folder of the real meshes.
    fresh : bool
        Whether every job has a new process: memory and time of one are then of no other. Otherwise one does all: for
        jobs that are shorter than a process takes to start.
    threads : int, optional
        How many it may use; by default as the environment sets.
    """

    def __init__(self, store: Store, data: Path | None, *, fresh: bool = True, threads: int | None = None) -> None:
        self._store, self._data, self._fresh, self._threads = store, data, fresh, threads
        self._process: subprocess.Popen | None = None
        self._stopped = False

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __call__(self, job: Job) -> bool:
        """Do a job; False if it failed, and the store has the reason.

        Raises
        ------
        Stopped
            If `stop` was called meanwhile.
        """
        if self._stopped:
            raise Stopped
        process = self._process or self._start()
        if self._stopped:  # meanwhile, by another thread, which found no process yet
            _kill(process)
        assert process.stdin is not None
        assert process.stdout is not None
        data = None if self._data is None else str(self._data)
        request = {"job": asdict(job), "folder": str(self._store.folder), "data": data}
        answer = ""
        with suppress(BrokenPipeError):  # the process has ended: there is no answer
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline().strip()
        if self._stopped:
            raise Stopped
        if not answer or self._fresh:
            self._end()
        if not answer:
            status = process.returncode
            how = f"by signal {-status}, perhaps because memory ran out" if status < 0 else f"with status {status}"
            self._store.fail(job, f"the process ended {how}")
        return answer == "done"

    def stop(self) -> None:
        """End the process at once; from any thread."""
        self._stopped = True
        process = self._process
        if process is not None and process.poll() is None:
            _kill(process)
        self._end()

    def _end(self) -> None:
        """Let the process end, now that it has nothing to do."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            _kill(process)
            process.wait()
        process.stdout.close()

    def _start(self) -> subprocess.Popen:
        environment = dict(os.environ)
        if self._threads is not None:
            environment |= dict.fromkeys(_THREADS, str(self._threads))
        with open(self._store.folder / "log.txt", "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.study.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=environment,
                text=True,
                encoding="utf-8",
                # Only this process handles a Ctrl-C of the terminal.
                start_new_session=True,
            )
        return self._process


def run(
    plan: Plan,
    store: Store,
    workers: Sequence[Do],
    *,
    jobs: Sequence[Job] | None = None,
    report: Report,
) -> dict[str, str]:
    """Run the jobs that are not done.

    Parameters
    ----------
    plan : Plan
    store : Store
    workers : sequence of functions of Job
        Each does one job at a time, see `Worker`; as many jobs run at once.
    jobs : sequence of Job, optional
        Which of the plan's; all by default.
    report : function of str
        Receives a line when a job is done.

    Returns
    -------
    failed : dict of str to str
        Why, by the key of each job that failed.
    """
    jobs = plan.jobs if jobs is None else jobs
    todo: list[Job] = []
    for job in jobs:
        if not store.done(job, plan) or any(job.needs == other.key for other in todo):
            todo.append(job)
    if len(todo) < len(jobs):
        report(f"{len(jobs) - len(todo)} of {len(jobs)} jobs were done before")
    shift = _Shift(plan, store, todo, report, lanes=len(workers))
    free = list(workers)
    running: dict[Future, tuple[Job, Do, float]] = {}
    with ThreadPoolExecutor(len(workers)) as pool:
        try:
            while True:
                while free and (ready := shift.next()) is not None:
                    worker = free.pop()
                    running[pool.submit(worker, ready)] = ready, worker, monotonic()
                if not running:
                    return shift.failed
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job, worker, start = running.pop(future)
                    free.append(worker)
                    shift.ended(job, ok=future.result(), seconds=monotonic() - start)
        except BaseException:
            for worker in workers:
                if isinstance(worker, Worker):
                    worker.stop()  # or the pool would wait for it
            raise


class _Shift:
    """The jobs of one run: which may begin, and how the others ended."""

    def __init__(self, plan: Plan, store: Store, todo: list[Job], report: Report, *, lanes: int) -> None:
        self.plan, self.store, self.report, self.lanes = plan, store, report, lanes
        self.total, self.number = len(todo), 0
        self.waiting, self.at_work = list(todo), list[Job]()
        self.failed: dict[str, str] = {}
        self.clock = _Clock()

    def next(self) -> Job | None:
        """The first job that can begin; those whose training failed are reported on the way."""
        for job in list(self.waiting):
            if job.needs in self.failed:
                self.waiting.remove(job)
                self.failed[job.key] = f"its training failed: {job.needs}"
                self.store.fail(job, self.failed[job.key])
                self._tell(job, "not run: its training failed")
        busy = {job.key for job in (*self.waiting, *self.at_work)}
        ready = next((job for job in self.waiting if job.needs not in busy), None)
        if ready is not None:
            self.waiting.remove(ready)
            self.at_work.append(ready)
        return ready

    def ended(self, job: Job, *, ok: bool, seconds: float) -> None:
        """Count a job, and report it."""
        self.at_work.remove(job)
        self.clock.took(job, seconds)
        if not ok:
            self.failed[job.key] = self.store.failure(job) or "it failed without a reason"
        outcome = "" if ok else f" FAILED: {self.failed[job.key]}"
        left = self.clock.left([*self.waiting, *self.at_work]) / self.lanes
        self._tell(job, f"{_minutes(seconds)}{outcome}{f', about {_hours(left)} left' if left else ''}")
        if ok and job.kind != TRAIN:
            _drop_model(self.plan, self.store, job)

    def _tell(self, job: Job, what: str) -> None:
        self.number += 1
        self.report(f"[{self.number}/{self.total}] {job.key} ... {what}")


def estimate(jobs: Sequence[Job], lanes: int = 1) -> str:
    """About how long jobs take, in words, if so many run at once.

    Examples
    --------
    >>> estimate([Job("a", "train", {}, seconds=5400), Job("b", "score", {}, seconds=60)])
    '1:31 h'
    """
    return _hours(sum(job.seconds for job in jobs) / lanes)


def _kill(process: subprocess.Popen) -> None:
    """End a process and those that it started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # it leads a session of its own
    else:
        process.kill()


class _Clock:
    """Measured against estimated time of jobs, by kind."""

    def __init__(self) -> None:
        self._took: dict[str, tuple[float, float]] = {}

    def took(self, job: Job, seconds: float) -> None:
        real, thought = self._took.get(job.kind, (0.0, 0.0))
        self._took[job.kind] = real + seconds, thought + job.seconds

    def left(self, jobs: Sequence[Job]) -> float:
        total = 0.0
        for job in jobs:
            real, thought = self._took.get(job.kind, (1.0, 1.0))
            total += job.seconds * real / thought
        return total


def _drop_model(plan: Plan, store: Store, job: Job) -> None:
    """Remove a model that no other job needs, unless it is kept."""
    if job.needs is None or plan.by_key[job.needs].keep:
        return
    if all(store.done(other, plan) for other in plan.needing(job.needs)):
        with suppress(FileNotFoundError):
            store.model(job.needs).unlink()


def _minutes(seconds: float) -> str:
    """Seconds as minutes:seconds.

    Examples
    --------
    >>> _minutes(302.4)
    '5:02 min'
    """
    return f"{round(seconds) // 60}:{round(seconds) % 60:02} min"


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60}:{minutes % 60:02} h"
