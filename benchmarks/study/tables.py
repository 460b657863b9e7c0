"""Scores of the study as tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.study.jobs import SCORE, TWIST, Entry, Plan
from benchmarks.study.plan import OTHER_MAPPINGS, SWEEPS, UNLEARNED
from benchmarks.study.results import Score, controls, others, scores, series, summary
from benchmarks.study.scale import ABLATIONS, SWEEP_SETS, TRAINED
from benchmarks.study.store import Store, number
from nilbs.geometry.metrics import HIGHER_IS_BETTER
from nilbs.methods.inverse_skinning import MAPPINGS
from nilbs.methods.registry import all_methods
from nilbs.models.protocol import IOUS, POSE_SETS

# Rows that are the truth itself.
TRUTH = ("mesh-lbs", "floor")
# Mappings of the default model that do not use its network.
WITHOUT_NETWORK = ("parts", "all-bones")
METHOD_ORDER = ("nilbs", *OTHER_MAPPINGS, *(name for name in TRAINED if name != "nilbs"), *UNLEARNED)
_SURFACE_SCORES = ("chamfer_l1", "p95", "hausdorff", "normal_consistency", "f_score", "components", "watertight")
# Titles of columns, and their digits after the point.
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
# Fewer parts are not better, and lookups are not counted for every row.
INCOMPARABLE = ("components", "lookups")
UNKNOWN = "-"
# A row's score by the seed of its training.
BySeed = Mapping[int, float | None]
_MARKS = (
    "Rows marked ° learn nothing; rows marked °° are the truth itself, skinned by LBS, and take no part in the "
    "comparison. Bold: rows that no other row beats, on the seeds of both, by more than the spread of the difference "
    "over them; with one common seed, by more than the spread of either. Without any spread a small lead "
    "may be random."
)
_SWITCHES = (
    "One seed. The paper's supervision is several: weights at rest on the surface alone, neither posed motion nor "
    "random poses, no position loss, uniform labelled points, absolute difference of occupancies. Without the weight "
    "loss alone the position loss still trains the weights."
)
_MEANINGS = {
    **{name: kind.summary for name, kind in all_methods().items()},
    **{name: f"the model of nilbs: {MAPPINGS[name]}" for name in OTHER_MAPPINGS},
    "floor": "the true mesh's own distance on the same grid",
}


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
    words : bool
        Whether cells are sentences and not numbers.
    """

    part: str
    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    words: bool = False


def study_tables(plan: Plan, store: Store, titles: Mapping[str, str]) -> list[Table]:
    """The tables of the study; what was not run is "-".

    Parameters
    ----------
    plan : Plan
    store : Store
    titles : mapping of str to str
        Titles of characters.

    Returns
    -------
    tables : list of Table
    """
    known = scores(plan, store)
    characters = list(dict.fromkeys(entry.character for entry in plan.entries if entry.part == "methods"))
    found = [_overview_table(plan, known, titles), _legend_table(plan)] if characters else []
    found += [t for name in characters for t in _main_tables(plan, known, name, titles.get(name, name))]
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
        found.append(_controls_table(controls(plan, store), known, titles))
    return found


def label(method: str) -> str:
    """What a table calls a method: marked where it learns nothing, and where it is the truth.

    Examples
    --------
    >>> label("nasa"), label("nearest"), label("floor")
    ('nasa', 'nearest °', 'floor °°')
    """
    return method + (" °°" if method in TRUTH else " °" if method in (*UNLEARNED, *WITHOUT_NETWORK) else "")


def order(methods: Iterable[str]) -> list[str]:
    """Methods in the order of tables."""
    place = {name: k for k, name in enumerate(METHOD_ORDER)}
    return sorted(dict.fromkeys(methods), key=lambda name: place.get(name, len(place)))


def _overview_table(plan: Plan, known: Sequence[Score], titles: Mapping[str, str]) -> Table:
    """Every method on every character, on random poses."""
    jobs = plan.by_key
    entries = [e for e in plan.entries if e.part == "methods" and jobs[e.job].kind == SCORE]
    names = _predicting(entries)
    characters = dict.fromkeys(entry.character for entry in entries)
    columns = [(character, poses) for character in characters for poses in _sets(plan, entries, SWEEP_SETS)]
    mine = [row for row in known if row.part == "methods" and row.score == "iou_surface"]
    values = [
        [{r.seed: r.mean for r in mine if (r.method, r.character, r.poses) == (n, *c)} for c in columns] for n in names
    ]
    headings = [f"{titles.get(character, character)}: {poses}" for character, poses in columns]
    note = f"Surface IoU on random poses, mean of the seeds that are done ± (max - min) / 2. {_MARKS}"
    rows = _rows(names, values, ["iou_surface"] * len(columns), label)
    return Table("overview", "Surface IoU of every method", note, ("method", *headings), rows)


def _legend_table(plan: Plan) -> Table:
    """The meaning of rows."""
    names = order(e.method for e in plan.entries if e.part == "methods")
    rows = tuple((label(name), (Cell(_MEANINGS[name]),)) for name in names)
    return Table("overview", "What the rows are", "", ("method", "what it is"), rows, words=True)


def _main_tables(plan: Plan, known: Sequence[Score], character: str, title: str) -> list[Table]:
    """A character's scores of the field, and those of its surfaces."""
    mine = [row for row in known if row.part in ("methods", "surfaces") and row.character == character]
    jobs = plan.by_key
    scorings = [e for e in plan.entries if e.character == character and jobs[e.job].kind == SCORE]
    entries, extracted = ([e for e in scorings if e.part == part] for part in ("methods", "surfaces"))
    seeds = len({entry.seed for entry in entries})
    spread = f"Mean of those of {seeds} seeds that are done ± (max - min) / 2" if seeds > 1 else "One seed"

    def table(
        title: str, note: str, names: Sequence[str], columns: Sequence[tuple[str, str, str]], *, of: str = "mean"
    ) -> Table:
        values = [
            [{r.seed: getattr(r, of) for r in mine if (r.method, r.part, r.poses, r.score) == (n, *c)} for c in columns]
            for n in names
        ]
        headings = [f"{poses}: {_SHORT[score]}" if poses else _SHORT[score] for _, poses, score in columns]
        rows = _rows(names, values, [score for *_, score in columns], label)
        return Table("methods", title, note, ("method", *headings), rows)

    sets, surface_sets = _sets(plan, entries, POSE_SETS), _sets(plan, extracted, POSE_SETS)
    ious = [("methods", poses, score) for poses in sets for score in IOUS]
    fields = [*ious, *(("surfaces", poses, "chamfer_l1") for poses in surface_sets)]
    fields += [("methods", poses, "lookups") for poses in sets if poses == "unseen"]
    fields += [("methods", "", score) for score in ("seconds", "training_seconds", "training_steps")]
    surfaces = [("surfaces", poses, score) for poses in surface_sets for score in _SURFACE_SCORES]
    field_note = f"{spread}; rows without ± are of the first seed. Surface IoU within noise of 0.006 L. {_MARKS}"
    surface_note = (
        "Extracted surfaces; rows without ± are of the first seed. Lengths in % of L. Surface inside the "
        "body counts as true: a row that keeps it, and so more parts, can come nearer to it than the floor. "
        f"{_MARKS}"
    )
    worst_note = f"IoU of the worst frame. {field_note}"
    names = order(entry.method for entry in entries)
    return [
        table(title, field_note, names, fields),
        table(f"{title}: worst frames", worst_note, _predicting(entries), ious, of="worst"),
        table(f"{title}: surfaces", surface_note, order(entry.method for entry in extracted), surfaces),
    ]


def _predicting(entries: Sequence[Entry]) -> list[str]:
    """Rows with occupancy: all but the floor, which has a surface only."""
    return [name for name in order(entry.method for entry in entries) if name != "floor"]


def _sets(plan: Plan, entries: Sequence[Entry], known: Sequence[str]) -> list[str]:
    """Pose sets that these entries are scored on."""
    jobs = plan.by_key
    scored = {poses for entry in entries for poses in entry.poses or jobs[entry.job].spec["poses"]}
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
    found = []
    for poses in sets:
        names = order(entry.method for entry in entries if poses is None or poses in _sets(plan, [entry], SWEEP_SETS))
        lines = series(known, part, poses, "iou_surface")
        values = [[{0: lines.get(name, {}).get(x)} for x in xs] for name in names]
        title = f"Surface IoU against {what}" + (f": {poses} poses" if poses else "")
        rows = _rows(names, values, ["iou_surface"] * len(xs), label)
        found.append(Table(part, title, "One seed.", (what, *(f"{x:g}" for x in xs)), rows))
    return found


def _ablation_tables(plan: Plan, part: str, entries: Sequence[Entry], known: Sequence[Score]) -> list[Table]:
    sets = _sets(plan, entries, SWEEP_SETS)
    mine = [row for row in known if row.part == part and row.score == "iou_surface"]

    def values(methods: Sequence[str]) -> list[BySeed]:
        return [{r.seed: r.mean for r in mine if (r.method, r.poses) == (m, poses)} for m in methods for poses in sets]

    there = {entry.method for entry in entries}
    names = [name for name in ABLATIONS if name in there]
    inverse = {name: "inverse" if name == "default" else f"{name}: inverse" for name in names}
    columns = [f"{poses}{way}" for way in ("", ", inverse map alone") for poses in sets]
    settings = _rows(names, [values([name, inverse[name]]) for name in names], ["iou_surface"] * len(columns), str)
    maps = [name for name in ("default", *OTHER_MAPPINGS) if name in there]
    ways = _rows(maps, [values([name]) for name in maps], ["iou_surface"] * len(sets), _search_for_default)
    return [
        Table(part, "Settings switched one at a time: surface IoU", _SWITCHES, ("setting", *columns), settings),
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
        "Where the body overlaps itself, that is the distance to surface inside it, which the rest shape does not "
        "have. Default model, one seed."
    )
    headings = [f"{poses}: {kinds[kind]}" for poses, kind in columns]
    return Table("distance", "Error of the distance", note, ("character", *headings), rows)


def _search_for_default(name: str) -> str:
    return "search (default)" if name == "default" else name


def _twist_table(results: Sequence[tuple[str, Mapping[str, Any]]]) -> Table:
    table = [row for _, result in results for row in result["table"]]
    names = [name for name in (table[0] if table else {"lbs": 0}) if name != "degrees"]
    rows = tuple(
        (f"{row['degrees']:g}", tuple(Cell(_text(number(row.get(name)), None, 4)) for name in names)) for row in table
    )
    note = "Volume over the volume that the skinned mesh encloses; the column lbs over the mesh's own at rest."
    return Table("twist", "Volume of a twisted capsule", note, ("degrees", *names), rows)


def _controls_table(
    by_character: Mapping[str, Mapping[str, Mapping[str, float]]], known: Sequence[Score], titles: Mapping[str, str]
) -> Table:
    kinds = ("perfect", "empty", "inverted")
    lbs_scores: dict[tuple[str, str], list[float]] = {}
    for row in known:
        if row.part == "methods" and row.method == "mesh-lbs" and row.mean is not None:
            lbs_scores.setdefault((row.character, row.score), []).append(row.mean)
    rows = []
    for character, found in by_character.items():
        values = [found.get(kind, {}).get(name) for kind in kinds for name in IOUS]
        values += [min(lbs_scores.get((character, name), []), default=None) for name in IOUS]
        rows.append((titles.get(character, character), tuple(Cell(_text(value, None, 4)) for value in values)))
    columns = [f"{kind}: {name}" for kind in (*kinds, "mesh LBS") for name in IOUS]
    note = (
        "Predictions with expected scores, 1 for a perfect one (the truth evaluated again) and 0 for an empty and an "
        "inverted one, in the first pose of each set of every scoring; shown is the scoring that is most wrong. Mesh "
        "LBS is the truth evaluated as a method, in their frame and precision: its worst pose set."
    )
    return Table("controls", "Controls", note, ("character", *columns), tuple(rows))


_PART_TABLES: Mapping[str, Callable[[Plan, str, Sequence[Entry], Sequence[Score]], list[Table]]] = {
    **dict.fromkeys(SWEEPS, _sweep_tables),
    "ablation": _ablation_tables,
}


def _rows(
    names: Sequence[str],
    values: Sequence[Sequence[BySeed]],
    kinds: Sequence[str],
    labelled: Callable[[str], str],
) -> tuple[tuple[str, tuple[Cell, ...]], ...]:
    """Rows of a table from the values of all seeds; a cell that no other row of its column beats is marked."""
    compared = [i for i, name in enumerate(names) if name not in TRUTH]
    marked = set()
    for j, score in enumerate(kinds):
        column = {i: values[i][j] for i in compared if summary([*values[i][j].values()])[0] is not None}
        if len(column) > 1 and not score.startswith("training") and score not in INCOMPARABLE:
            marked |= {(i, j) for i in column if not any(_beats(other, column[i], score) for other in column.values())}
    return tuple(
        (
            labelled(name),
            tuple(
                Cell(_text(*summary([*cell.values()]), _DECIMALS[score]), (i, j) in marked)
                for j, (cell, score) in enumerate(zip(cells, kinds, strict=True))
            ),
        )
        for i, (name, cells) in enumerate(zip(names, values, strict=True))
    )


def _beats(one: BySeed, other: BySeed, score: str) -> bool:
    """Whether a row is better than another on the seeds of both, by more than the spread of the difference.

    A seed also changes poses and points, so rows are compared seed by seed, with rounded
    scores.
    """
    sign = 1 if score in HIGHER_IS_BETTER else -1
    shown = [
        {seed: round(value, _DECIMALS[score]) for seed, value in row.items() if value is not None}
        for row in (one, other)
    ]
    gains = [sign * (shown[0][seed] - shown[1][seed]) for seed in shown[0].keys() & shown[1].keys()]
    gain, spread = summary(gains)
    if spread is None:
        spread = max(summary([*row.values()])[1] or 0.0 for row in (one, other))
    return gain is not None and gain > spread + 1e-9  # rounding of the difference


def _text(mean: float | None, spread: float | None, decimals: int) -> str:
    if mean is None:
        return UNKNOWN
    return f"{mean:.{decimals}f}" + ("" if spread is None else f" ± {spread:.{decimals}f}")
