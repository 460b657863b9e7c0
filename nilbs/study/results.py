"""Scores of the study in long form, and as tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from nilbs.study.jobs import FAILURES, PICTURE, SCORE, TRAIN, TWIST, Entry, Plan
from nilbs.study.plan import ABLATIONS, OTHER_MAPPINGS, POSE_SETS, SWEEP_SETS, SWEEPS, TRAINED, UNLEARNED
from nilbs.study.store import Store

# Rows that are the truth itself, and best by definition.
TRUTH = ("mesh-lbs", "floor")
METHOD_ORDER = ("nilbs", *OTHER_MAPPINGS, *(name for name in TRAINED if name != "nilbs"), *UNLEARNED)
# Scores that are best where they are largest.
HIGHER_IS_BETTER = ("iou_bbox", "iou_surface", "normal_consistency", "f_score", "watertight")
_SURFACE_SCORES = ("chamfer_l1", "p95", "hausdorff", "normal_consistency", "f_score", "components", "watertight")
# What a column is called, and its digits after the point.
_SHORT = {
    "iou_bbox": "bbox IoU",
    "iou_surface": "surface IoU",
    "chamfer_l1": "Chamfer, % of L",
    "p95": "95th percentile",
    "hausdorff": "Hausdorff",
    "normal_consistency": "normals",
    "f_score": "F-score at 1 %",
    "components": "parts",
    "watertight": "closed",
    "lookups": "weight lookups a query",
    "seconds": "s for 100,000 points",
    "training_seconds": "training, s",
    "training_steps": "steps",
}
_DECIMALS = {
    "iou_bbox": 4,
    "iou_surface": 4,
    "chamfer_l1": 3,
    "p95": 3,
    "hausdorff": 2,
    "normal_consistency": 4,
    "f_score": 4,
    "components": 1,
    "watertight": 2,
    "lookups": 2,
    "seconds": 2,
    "training_seconds": 0,
    "training_steps": 0,
}
UNKNOWN = "-"


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


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, and whether it is the best of its column."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    part, title, note : str
    columns : tuple of str
        The first names the rows.
    rows : tuple of (str, tuple of Cell)
        Labels and cells.
    """

    part: str
    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


def scores(plan: Plan, store: Store) -> list[Score]:
    """All scores that are known, in the order of the plan.

    Parameters
    ----------
    plan : Plan
    store : Store

    Returns
    -------
    scores : list of Score
    """
    jobs = plan.by_key
    # Scores of a training that was repeated since do not count.
    results = {job.key: store.result(job) for job in plan.jobs if job.kind == TRAIN or store.done(job, plan)}
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
                found += [Score(*common, name, score, *_mean_and_worst(value)) for score, value in values.items()]
        if entry.row in (seconds := result["scores"]["query_seconds"]):
            found.append(Score(*common, "", "seconds", _number(seconds[entry.row]), None))
        training = results.get(job.needs) if job.needs else None
        if training is not None and not entry.row:
            # Of a training that was stopped and continued only the last piece was timed.
            seconds_taken = None if training["resumed"] else training["seconds"]
            found.append(Score(*common, "", "training_seconds", seconds_taken, None))
            found.append(Score(*common, "", "training_steps", training["steps"], None))
    return found


def others(plan: Plan, store: Store, kind: str) -> list[tuple[str, dict[str, Any]]]:
    """Results of jobs of another kind, with the characters that they are of."""
    jobs = plan.by_key
    entries = [entry for entry in plan.entries if jobs[entry.job].kind == kind]
    return [(e.character, result) for e in entries if (result := store.result(jobs[e.job])) is not None]


def pictures(plan: Plan, store: Store) -> list[dict[str, str]]:
    """Pictures whose files are there: title, caption, file (in the study's folder) and kind."""
    found = []
    for kind in (PICTURE, FAILURES):
        for _, result in others(plan, store, kind):
            found += [{**picture, "kind": kind} for picture in result["pictures"]]
    return [picture for picture in found if (store.folder / picture["file"]).is_file()]


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


def tables(plan: Plan, store: Store, titles: Mapping[str, str]) -> list[Table]:
    """The tables of the study; what was not run is "-".

    Parameters
    ----------
    plan : Plan
    store : Store
    titles : mapping of str to str
        What characters are called.

    Returns
    -------
    tables : list of Table
    """
    known = scores(plan, store)
    characters = list(dict.fromkeys(entry.character for entry in plan.entries if entry.part == "methods"))
    found = [t for name in characters for t in _main_tables(plan, known, name, titles.get(name, name))]
    for part in SWEEPS:
        entries = [entry for entry in plan.entries if entry.part == part]
        if entries:
            found += _PART_TABLES[part](plan, part, entries, known)
    distances = [entry for entry in plan.entries if entry.part == "distance"]
    if distances:
        found.append(_distance_table(plan, distances, known, titles))
    jobs = plan.by_key
    if any(jobs[entry.job].kind == TWIST for entry in plan.entries):
        found.append(_twist_table(others(plan, store, TWIST)))
    if any(entry.part == "controls" for entry in plan.entries):
        found.append(_controls_table(plan, store, titles))
    return found


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


def label(method: str) -> str:
    """What a table calls a method: marked where it learns nothing, and where it is the truth.

    Examples
    --------
    >>> label("nasa"), label("nearest"), label("floor")
    ('nasa', 'nearest °', 'floor °°')
    """
    return method + (" °°" if method in TRUTH else " °" if method in UNLEARNED else "")


def order(methods: Iterable[str]) -> list[str]:
    """Methods in the order of tables."""
    place = {name: k for k, name in enumerate(METHOD_ORDER)}
    return sorted(dict.fromkeys(methods), key=lambda name: place.get(name, len(place)))


def _main_tables(plan: Plan, known: Sequence[Score], character: str, title: str) -> list[Table]:
    """A character's scores of the field, and those of its surfaces."""
    mine = [row for row in known if row.part in ("methods", "surfaces") and row.character == character]
    scorings = [e for e in plan.entries if e.character == character and plan.by_key[e.job].kind == SCORE]
    entries, extracted = ([e for e in scorings if e.part == part] for part in ("methods", "surfaces"))
    seeds = len({entry.seed for entry in entries})
    spread = f"Mean of those of {seeds} seeds that are done ± (max - min) / 2" if seeds > 1 else "One seed"
    marks = (
        "Rows marked ° learn nothing; rows marked °° are the truth itself, skinned by LBS, and take no part in the "
        "comparison. Bold: best of the column, and what lies within the spread of it."
    )

    def table(title: str, note: str, names: Sequence[str], columns: Sequence[tuple[str, str, str]]) -> Table:
        values = [
            [[r.mean for r in mine if (r.method, r.part, r.poses, r.score) == (n, *c)] for c in columns] for n in names
        ]
        headings = [f"{poses}: {_SHORT[score]}" if poses else _SHORT[score] for _, poses, score in columns]
        rows = _rows(names, values, [score for *_, score in columns], label)
        return Table("methods", title, note, ("method", *headings), rows)

    sets, surface_sets = _sets(plan, entries, POSE_SETS), _sets(plan, extracted, POSE_SETS)
    fields = [("methods", poses, score) for poses in sets for score in ("iou_bbox", "iou_surface")]
    fields += [("surfaces", poses, "chamfer_l1") for poses in surface_sets]
    fields += [("methods", poses, "lookups") for poses in sets if poses == "unseen"]
    fields += [("methods", "", score) for score in ("seconds", "training_seconds", "training_steps")]
    surfaces = [("surfaces", poses, score) for poses in surface_sets for score in _SURFACE_SCORES]
    field_note = f"{spread}; what has no ± was scored for the first seed. Surface IoU within noise of 0.006 L. {marks}"
    surface_note = f"Extracted surfaces; what has no ± was scored for the first seed. Lengths in % of L. {marks}"
    return [
        table(title, field_note, order(entry.method for entry in entries), fields),
        table(f"{title}: surfaces", surface_note, order(entry.method for entry in extracted), surfaces),
    ]


def _sets(plan: Plan, entries: Sequence[Entry], known: Sequence[str]) -> list[str]:
    """Pose sets that these entries are scored on."""
    jobs = plan.by_key
    scored = {poses for entry in entries for poses in jobs[entry.job].spec["poses"]}
    return [poses for poses in known if poses in scored]


def _sweep_tables(plan: Plan, part: str, entries: Sequence[Entry], known: Sequence[Score]) -> list[Table]:
    what = {
        "frames": "training poses",
        "amplitude": "standard deviation of the joint angles, rad",
        "time": "training minutes",
        "noise": "surface noise, in units of 0.006 L",
    }[part]
    sets: list[str | None] = [None] if part == "amplitude" else list(_sets(plan, entries, SWEEP_SETS))
    xs = sorted({entry.value for entry in entries if entry.value is not None})
    names = order(entry.method for entry in entries)
    found = []
    for poses in sets:
        lines = series(known, part, poses, "iou_surface")
        values = [[[lines.get(name, {}).get(x)] for x in xs] for name in names]
        title = f"Surface IoU against {what}" + (f": {poses} poses" if poses else "")
        rows = _rows(names, values, ["iou_surface"] * len(xs), label)
        found.append(Table(part, title, "One seed.", (what, *(f"{x:g}" for x in xs)), rows))
    return found


def _ablation_tables(plan: Plan, part: str, entries: Sequence[Entry], known: Sequence[Score]) -> list[Table]:
    sets = _sets(plan, entries, SWEEP_SETS)
    mine = [row for row in known if row.part == part and row.score == "iou_surface"]

    def values(methods: Sequence[str]) -> list[list[float | None]]:
        return [[r.mean for r in mine if (r.method, r.poses) == (m, poses)] for m in methods for poses in sets]

    there = {entry.method for entry in entries}
    names = [name for name in ABLATIONS if name in there]
    inverse = {name: "inverse" if name == "default" else f"{name}: inverse" for name in names}
    columns = [f"{poses}{way}" for way in ("", ", inverse map alone") for poses in sets]
    settings = _rows(names, [values([name, inverse[name]]) for name in names], ["iou_surface"] * len(columns), str)
    maps = [name for name in ("default", *OTHER_MAPPINGS) if name in there]
    ways = _rows(maps, [values([name]) for name in maps], ["iou_surface"] * len(sets), _search_for_default)
    return [
        Table(part, "Settings switched one at a time: surface IoU", "One seed.", ("setting", *columns), settings),
        Table(
            part,
            "Ways of the default model to its rest images: surface IoU",
            "One seed, one training.",
            ("mapping", *sets),
            ways,
        ),
    ]


def _distance_table(plan: Plan, entries: Sequence[Entry], known: Sequence[Score], titles: Mapping[str, str]) -> Table:
    kinds = {"distance_error": "read at rest", "posed_distance_error": "corrected by the local stretch"}
    columns = [(poses, kind) for poses in _sets(plan, entries, SWEEP_SETS) for kind in kinds]
    mine = {(r.character, r.poses, r.score): r.mean for r in known if r.part == "distance"}
    rows = tuple(
        (titles.get(name, name), tuple(Cell(_text(mine.get((name, *column)), None, 3)) for column in columns))
        for name in dict.fromkeys(entry.character for entry in entries)
    )
    note = (
        "Mean absolute difference from the posed mesh's own signed distance at the points near the surface, in % of L. "
        "Default model, one seed."
    )
    headings = [f"{poses}: {kinds[kind]}" for poses, kind in columns]
    return Table("distance", "Error of the distance", note, ("character", *headings), rows)


def _search_for_default(name: str) -> str:
    return "search (default)" if name == "default" else name


def _twist_table(results: Sequence[tuple[str, Mapping[str, Any]]]) -> Table:
    table = [row for _, result in results for row in result["table"]]
    names = [name for name in (table[0] if table else {"lbs": 0}) if name != "degrees"]
    rows = tuple(
        (f"{row['degrees']:g}", tuple(Cell(_text(_number(row.get(name)), None, 4)) for name in names)) for row in table
    )
    note = "Volume over the volume that the skinned mesh encloses; the column lbs over the mesh's own at rest."
    return Table("twist", "Volume of a twisted capsule", note, ("degrees", *names), rows)


def controls(plan: Plan, store: Store) -> dict[str, dict[str, dict[str, float]]]:
    """By character, the scores of predictions that are known, over all scorings: of each the one that is most wrong."""
    jobs = plan.by_key
    found: dict[str, dict[str, dict[str, float]]] = {}
    for job in plan.jobs:
        result = store.result(job) if job.kind == SCORE else None
        if result is None:
            continue
        worst = found.setdefault(jobs[str(job.needs)].spec["character"], {})
        for kind, scores in result["scores"]["controls"].items():
            pick = min if kind == "perfect" else max
            for name, value in scores.items():
                known = worst.setdefault(kind, {})
                known[name] = pick(value, known.get(name, value))
    return found


def _controls_table(plan: Plan, store: Store, titles: Mapping[str, str]) -> Table:
    kinds, names = ("perfect", "empty", "inverted"), ("iou_bbox", "iou_surface")
    rows = []
    for character, scores in controls(plan, store).items():
        cells = [Cell(_text(scores.get(kind, {}).get(name), None, 4)) for kind in kinds for name in names]
        rows.append((titles.get(character, character), tuple(cells)))
    columns = [f"{kind}: {name}" for kind in kinds for name in names]
    note = (
        "Predictions whose scores are known, 1 for a perfect one and 0 for an empty and for an inverted one, scored in "
        "every scoring beside the model; the most wrong of them."
    )
    return Table("controls", "Controls", note, ("character", *columns), tuple(rows))


_PART_TABLES: Mapping[str, Callable[[Plan, str, Sequence[Entry], Sequence[Score]], list[Table]]] = {
    **dict.fromkeys(SWEEPS, _sweep_tables),
    "ablation": _ablation_tables,
}


def _rows(
    names: Sequence[str],
    values: Sequence[Sequence[Sequence[float | None]]],
    kinds: Sequence[str],
    label: Callable[[str], str],
) -> tuple[tuple[str, tuple[Cell, ...]], ...]:
    """Rows of a table from the values of all seeds, the best of each column marked."""
    best = []
    for j, score in enumerate(kinds):
        shown = [_shown(values[i][j], score) for i, name in enumerate(names) if name not in TRUTH]
        numbers = [value for value in shown if value is not None]
        # Fewer parts are no better than as many as there are.
        comparable = len(numbers) > 1 and not score.startswith("training") and score != "components"
        best.append((max if score in HIGHER_IS_BETTER else min)(numbers) if comparable else None)
    rows = []
    for name, cells in zip(names, values, strict=True):
        row = []
        for j, (cell, score) in enumerate(zip(cells, kinds, strict=True)):
            value = _shown(cell, score)
            is_best = _as_good(value, best[j], values, j, cell, score) and name not in TRUTH
            row.append(Cell(_text(*summary(cell), _DECIMALS[score]), is_best))
        rows.append((label(name), tuple(row)))
    return tuple(rows)


def _as_good(
    value: float | None,
    best: float | None,
    values: Sequence[Sequence[Sequence[float | None]]],
    column: int,
    cell: Sequence[float | None],
    score: str,
) -> bool:
    """Whether a mean is the best of its column, or no farther from it than the seeds of either are apart."""
    if value is None or best is None:
        return False
    spreads = [summary(row[column])[1] or 0.0 for row in values if _shown(row[column], score) == best]
    return abs(value - best) <= max(*spreads, summary(cell)[1] or 0.0)


def _shown(values: Sequence[float | None], score: str) -> float | None:
    """The mean as it is printed: what cannot be told apart is best together."""
    mean = summary(values)[0]
    return None if mean is None else round(mean, _DECIMALS[score])


def _text(mean: float | None, spread: float | None, decimals: int) -> str:
    if mean is None:
        return UNKNOWN
    return f"{mean:.{decimals}f}" + ("" if spread is None else f" ± {spread:.{decimals}f}")


def _mean_and_worst(value: Any) -> tuple[float | None, float | None]:
    """Of a score with its frames, or of a number alone."""
    if isinstance(value, Mapping):
        return _number(value.get("mean")), _number(value.get("worst"))
    return _number(value), None


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def trainings(plan: Plan, store: Store) -> list[dict[str, Any]]:
    """What is known of every training: its spec, and how it went."""
    jobs = [job for job in plan.jobs if job.kind == TRAIN]
    return [{"key": job.key, **job.spec, "result": store.result(job)} for job in jobs]


def long_form(known: Iterable[Score]) -> list[dict[str, Any]]:
    """Scores as mappings, as JSON and CSV hold them."""
    return [asdict(row) for row in known]
