"""The folder of a study: results, and whether they still count."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.study.jobs import FAILURES, PICTURE, SCORE, TRAIN, TWIST, Job, Plan
from nilbs.io.atomic import PART, replacing
from nilbs.io.errors import FileFormatError
from nilbs.io.strict_json import plain, read_json

FOLDERS = ("models", "results", "failed", "characters", "pictures")


@dataclass(frozen=True)
class Store:
    """Files of a study.

    Attributes
    ----------
    folder : path
        It holds `FOLDERS`, which are made as they are needed.
    """

    folder: Path

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Lock the folder, if the system can.

        Raises
        ------
        ValueError
            If another study is at work in it.
        """
        try:
            import fcntl
        except ImportError:  # Windows
            yield
            return
        with open(self.folder / "lock", "w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ValueError(f"{self.folder}: another study is at work in this folder") from None
            yield

    def model(self, key: str) -> Path:
        """Where the model of a training is."""
        return self.folder / "models" / f"{key}.nilbs"

    def result(self, job: Job) -> dict[str, Any] | None:
        """The result of a job, where there is one that was made from an equal spec and holds what such a job makes."""
        found = self._read(self._result(job), job)
        return None if found is None or not _fits(found, _CONTENTS[job.kind]) else found

    def failure(self, job: Job) -> str | None:
        """Why a job failed when it was last tried, in a line."""
        found = self._read(self._failed(job), job)
        return None if found is None else str(found.get("error"))

    def forget(self, training: Job) -> None:
        """Count a training as not done, so that it is done again."""
        with suppress(FileNotFoundError):
            self._result(training).unlink()

    def sweep(self) -> None:
        """Remove what writers that were killed have left half-written; only while no job runs."""
        for name in FOLDERS:
            for path in (self.folder / name).rglob(f".*{PART}"):
                if not path.is_dir():
                    path.unlink()

    def done(self, job: Job, plan: Plan) -> bool:
        """Whether a job need not be run.

        A scoring is done for the very training that it scored; a training is done as long as its model exists or nobody
        needs it any more.
        """
        result = self.result(job)
        if result is None:
            return False
        if job.kind == TRAIN:
            return self.model(job.key).is_file() or all(self.done(other, plan) for other in plan.needing(job.key))
        if job.needs is not None:
            training = self.result(plan.by_key[job.needs])
            return training is not None and training["stamp"] == result.get("trained")
        return True

    def write(self, job: Job, result: Mapping[str, Any]) -> None:
        """Keep a result and remove an earlier failure."""
        self._write(self._result(job), job, result)
        with suppress(FileNotFoundError):
            self._failed(job).unlink()

    def fail(self, job: Job, error: str, details: str = "") -> None:
        """Record that a job failed."""
        self._write(self._failed(job), job, {"error": error, "details": details})

    def picture(self, name: str) -> Path | None:
        """A picture that a result names, if it is one of the study's own: no other file gets into a report."""
        try:
            path = (self.folder / name).resolve()
            mine = path.is_relative_to((self.folder / "pictures").resolve()) and path.suffix == ".png"
            return path if mine and path.is_file() else None
        except (OSError, ValueError):  # no name of a file
            return None

    def _result(self, job: Job) -> Path:
        return self.folder / "results" / f"{job.key}{'-train' if job.kind == TRAIN else ''}.json"

    def _failed(self, job: Job) -> Path:
        return self.folder / "failed" / f"{job.key}.json"

    @staticmethod
    def _read(path: Path, job: Job) -> dict[str, Any] | None:
        try:
            found = read_json(path)
        except (FileFormatError, OSError):  # damaged: as good as none
            return None
        if not isinstance(found, dict) or found.get("kind") != job.kind or found.get("spec") != job.spec:
            return None
        result = found.get("result")
        return result if isinstance(result, dict) else None

    @staticmethod
    def _write(path: Path, job: Job, result: Mapping[str, Any]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        contents = {"key": job.key, "kind": job.kind, "spec": job.spec, "result": plain(result)}
        with replacing(path, "w") as file:
            file.write(json.dumps(contents, indent=1, allow_nan=False) + "\n")


def number(value: Any) -> float | None:
    """A number, or None where there is none.

    Examples
    --------
    >>> number(3), number("3"), number(10**400)
    (3.0, None, None)
    """
    return float(value) if isinstance(value, int | float) and abs(value) < 2**63 else None


def _fits(value: Any, expected: Any) -> bool:
    """Whether a value of JSON has the expected types, name by name; a list's one entry holds for all."""
    if isinstance(expected, Mapping):
        if not isinstance(value, dict):
            return False
        if _EACH in expected:
            return all(_fits(inner, expected[_EACH]) for inner in value.values())
        return all(name in value and _fits(value[name], expected[name]) for name in expected)
    if isinstance(expected, list):
        return isinstance(value, list) and all(_fits(inner, expected[0]) for inner in value)
    return isinstance(value, expected) and (expected is not _NUMBER or number(value) is not None)


_EACH = "*"  # of any names
_NUMBER = (int, float)
_BY_SCORE = {_EACH: object}  # a number, or one with those of its frames
_PICTURES = [{"title": str, "caption": str, "file": str}]
# The least content of results, by kind of job.
_CONTENTS: Mapping[str, Mapping[str, Any]] = {
    TRAIN: {
        "stamp": str,
        "seconds": _NUMBER,
        "resumed": bool,
        "steps": _NUMBER,
        "frames": _NUMBER,
        "wall_seconds": _NUMBER,
    },
    SCORE: {
        "scores": {
            "controls": {_EACH: {_EACH: _NUMBER}},
            "query_seconds": dict,
            "poses": {_EACH: _BY_SCORE},
            "rows": {_EACH: {_EACH: _BY_SCORE}},
        },
        "trained": str,
        "wall_seconds": _NUMBER,
    },
    PICTURE: {"pictures": _PICTURES, "wall_seconds": _NUMBER},
    TWIST: {"table": [{"degrees": _NUMBER}], "wall_seconds": _NUMBER},
    FAILURES: {"pictures": _PICTURES, "wall_seconds": _NUMBER},
}
