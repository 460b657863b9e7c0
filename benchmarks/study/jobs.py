"""What the study consists of: jobs, and the cells of tables that their results fill."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

# Kinds of jobs.
TRAIN, SCORE, TWIST, FAILURES, PICTURE = "train", "score", "twist", "failures", "picture"


@dataclass(frozen=True)
class Job:
    """A piece of work that is done as a whole, in a process of its own.

    Attributes
    ----------
    key : str
        Its name, and that of its files: "elephant/nilbs/seed0". No two jobs of a plan share it.
    kind : str
        "train", "score", "twist", "failures" or "picture".
    spec : mapping
        All that the result depends on, as JSON holds it. A result counts only for an equal spec.
    needs : str, optional
        Key of the training whose model this job reads.
    keep : bool
        Whether the model of a training stays when all that need it are done.
    seconds : float
        How long it takes, roughly.
    """

    key: str
    kind: str
    spec: Mapping[str, Any]
    needs: str | None = None
    keep: bool = True
    seconds: float = 60.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "spec", json.loads(json.dumps(self.spec)))  # as it will come back from a file


@dataclass(frozen=True)
class Entry:
    """Where a result stands in the tables.

    Attributes
    ----------
    part : str
        Of the study.
    character, method : str
        What was scored.
    seed : int
    job : str
        Key of the job that brings the scores.
    row : str
        Which of its rows; the model's own has no name.
    value : float, optional
        Of the quantity that a sweep varies.
    poses : tuple of str, optional
        Which pose sets count here; all by default.
    """

    part: str
    character: str
    method: str
    seed: int
    job: str
    row: str = ""
    value: float | None = None
    poses: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Plan:
    """Jobs in the order in which they run, and the places of their results.

    Attributes
    ----------
    jobs : tuple of Job
        A job comes after the training that it needs.
    entries : tuple of Entry
    missing : tuple of str
        A sentence on everything that cannot be done here.
    """

    jobs: tuple[Job, ...]
    entries: tuple[Entry, ...]
    missing: tuple[str, ...] = ()

    @property
    def by_key(self) -> dict[str, Job]:
        """The jobs by their keys."""
        return {job.key: job for job in self.jobs}

    def of_parts(self, parts: Iterable[str]) -> tuple[Job, ...]:
        """Jobs whose results these parts show, and the trainings that those need."""
        parts = set(parts)
        shown = {entry.job for entry in self.entries if entry.part in parts}
        shown |= {job.needs for job in self.jobs if job.key in shown and job.needs is not None}
        return tuple(job for job in self.jobs if job.key in shown)

    def needing(self, key: str) -> tuple[Job, ...]:
        """Jobs that read the model of a training."""
        return tuple(job for job in self.jobs if job.needs == key)


class Builder:
    """Collects jobs and entries; work that is added twice is done once."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}
        self._by_work: dict[str, str] = {}
        self._entries: list[Entry] = []
        self.missing: list[str] = []

    def job(self, job: Job) -> Job:
        """Add a job, or find the one that does the same.

        Raises
        ------
        ValueError
            If another job has its key.
        """
        work = json.dumps([job.kind, job.spec], sort_keys=True)
        existing = self._by_work.get(work)
        if existing is not None:
            self._jobs[existing] = replace(
                self._jobs[existing], keep=self._jobs[existing].keep or job.keep
            )  # kept if any job keeps it
            return self._jobs[existing]
        if job.key in self._jobs:
            raise ValueError(f"two jobs are called {job.key}")
        self._jobs[job.key] = job
        self._by_work[work] = job.key
        return job

    def entry(self, entry: Entry) -> None:
        """Add a place in the tables."""
        self._entries.append(entry)

    def plan(self) -> Plan:
        """What was collected; what reads a model comes right after its training."""
        followers: dict[str | None, list[Job]] = {}
        for job in self._jobs.values():
            followers.setdefault(job.needs, []).append(job)
        # So a study that is stopped keeps few models.
        jobs = [job for first in followers.get(None, []) for job in (first, *followers.get(first.key, []))]
        return Plan(tuple(jobs), tuple(self._entries), tuple(self.missing))
