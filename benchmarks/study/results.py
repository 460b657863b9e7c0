"""Results of a study: scores in long form, pictures, failures and jobs that are not done."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.study.jobs import FAILURES, PICTURE, SCORE, TRAIN, Job, Plan
from benchmarks.study.store import Store, number
from nilbs.models.protocol import IOUS


@dataclass(frozen=True)
class Score:
    """One number of the study.

    Attributes
    ----------
    part, character, method, value, seed
        As in `Entry`.
    poses : str
        The pose set; "" for what belongs to a training.
    score : str
    mean, worst : float, optional
        Over the frames of the pose set; None where undefined.
    """

    part: str
    character: str
    method: str
    value: float | None
    seed: int
    poses: str
    score: str
    mean: float | None
    worst: float | None


def scores(plan: Plan, store: Store) -> list[Score]:
    """All scores of jobs that are done, in the order of the plan.

    Parameters
    ----------
    plan : Plan
    store : Store

    Returns
    -------
    scores : list of Score
    """
    jobs = plan.by_key
    results = {job.key: _result(plan, store, job) for job in plan.jobs}
    found = []
    for entry in plan.entries:
        job, result = jobs[entry.job], results.get(entry.job)
        if job.kind != SCORE or result is None:
            continue
        common = (entry.part, entry.character, entry.method, entry.value, entry.seed)
        if entry.part == "controls":
            for kind, values in result["scores"]["controls"].items():
                common = (entry.part, entry.character, kind, None, entry.seed)
                found += [Score(*common, "", score, *_mean_and_worst(value)) for score, value in values.items()]
            continue
        sets = result["scores"]["rows"].get(entry.row, {}) if entry.row else result["scores"]["poses"]
        for name, values in sets.items():
            if entry.poses is None or name in entry.poses:
                # IoUs of the floor would compare the truth with itself.
                shown = [score for score in values if entry.row != "floor" or score not in IOUS]
                found += [Score(*common, name, score, *_mean_and_worst(values[score])) for score in shown]
        if entry.row in (seconds := result["scores"]["query_seconds"]):
            found.append(Score(*common, "", "seconds", number(seconds[entry.row]), None))
        training = results.get(job.needs) if job.needs else None
        if training is not None and not entry.row:
            # A training that was continued has the time of its last piece only.
            seconds_taken = None if training["resumed"] else training["seconds"]
            found.append(Score(*common, "", "training_seconds", seconds_taken, None))
            found.append(Score(*common, "", "training_steps", training["steps"], None))
    return found


def others(plan: Plan, store: Store, kind: str) -> list[tuple[str, dict[str, Any]]]:
    """Results of jobs of another kind, with the characters that they are of."""
    jobs = plan.by_key
    entries = [entry for entry in plan.entries if jobs[entry.job].kind == kind]
    return [(e.character, result) for e in entries if (result := _result(plan, store, jobs[e.job])) is not None]


def pictures(plan: Plan, store: Store) -> list[dict[str, str]]:
    """Pictures whose files are there: title, caption, file (in the study's folder) and kind."""
    found = []
    for kind in (PICTURE, FAILURES):
        for _, result in others(plan, store, kind):
            found += [{**picture, "kind": kind} for picture in result["pictures"]]
    return [picture for picture in found if store.picture(picture["file"]) is not None]


def failed(plan: Plan, store: Store) -> dict[str, str]:
    """Why jobs failed when they were last tried, by key."""
    return {job.key: why for job in plan.jobs if (why := store.failure(job)) is not None}


def unfinished(plan: Plan, store: Store) -> list[str]:
    """Keys of the jobs that are still to be done."""
    return [job.key for job in plan.jobs if not store.done(job, plan)]


def wall_minutes(plan: Plan, store: Store) -> float:
    """Wall time of everything that is done, in minutes."""
    results = (store.result(job) for job in plan.jobs)
    return sum(result["wall_seconds"] for result in results if result is not None) / 60


def summary(values: Sequence[float | None]) -> tuple[float | None, float | None]:
    """Mean over seeds and half the range, (max - min) / 2; the latter None for one seed alone.

    Examples
    --------
    >>> summary([1.0, 2.0, 4.5]), summary([2.0, None]), summary([])
    ((2.5, 1.75), (2.0, None), (None, None))
    """
    numbers = [value for value in values if value is not None]
    if not numbers:
        return None, None
    return sum(numbers) / len(numbers), (max(numbers) - min(numbers)) / 2 if len(numbers) > 1 else None


def series(known: Iterable[Score], part: str, poses: str | None, score: str) -> dict[str, dict[float, float]]:
    """Means of a sweep by method and value.

    Parameters
    ----------
    known : iterable of Score
    part : str
    poses : str, optional
        The pose set; None takes whatever set the values were taken on.
    score : str

    Returns
    -------
    lines : dict of str to dict of float to float
    """
    groups: dict[str, dict[float, list[float | None]]] = {}
    for row in known:
        if row.part == part and row.score == score and row.value is not None and poses in (None, row.poses):
            groups.setdefault(row.method, {}).setdefault(row.value, []).append(row.mean)
    lines = {}
    for method, values in groups.items():
        means = {value: mean for value, every in sorted(values.items()) if (mean := summary(every)[0]) is not None}
        if means:
            lines[method] = means
    return lines


def controls(plan: Plan, store: Store) -> dict[str, dict[str, dict[str, float]]]:
    """By character, the scores of the controls over all scorings: of each the one that is most wrong."""
    jobs = plan.by_key
    found: dict[str, dict[str, dict[str, float]]] = {}
    for job in plan.jobs:
        result = _result(plan, store, job) if job.kind == SCORE else None
        if result is None:
            continue
        worst = found.setdefault(jobs[str(job.needs)].spec["character"], {})
        for kind, scores in result["scores"]["controls"].items():
            pick = min if kind == "perfect" else max
            for name, value in scores.items():
                known = worst.setdefault(kind, {})
                known[name] = pick(value, known.get(name, value))
    return found


def _result(plan: Plan, store: Store, job: Job) -> dict[str, Any] | None:
    """A job's result; None if its model has been trained again since."""
    return store.result(job) if job.kind == TRAIN or store.done(job, plan) else None


def _mean_and_worst(value: Any) -> tuple[float | None, float | None]:
    """Of a score with its frames, or of a number alone."""
    if isinstance(value, Mapping):
        return number(value.get("mean")), number(value.get("worst"))
    return number(value), None


def trainings(plan: Plan, store: Store) -> list[dict[str, Any]]:
    """Every training that is done: its spec and its result."""
    jobs = [job for job in plan.jobs if job.kind == TRAIN]
    return [{"key": job.key, **job.spec, "result": store.result(job)} for job in jobs]


def long_form(known: Iterable[Score]) -> list[dict[str, Any]]:
    """Scores as mappings, as JSON and CSV hold them."""
    return [asdict(row) for row in known]
