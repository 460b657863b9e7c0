"""Which trainings and scorings the study consists of: one function for each of its parts."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from hashlib import sha256
from typing import Any

from benchmarks.study.durations import scoring_seconds, training_seconds
from benchmarks.study.jobs import FAILURES, PICTURE, SCORE, TRAIN, TWIST, Builder, Entry, Job, Plan
from benchmarks.study.scale import ABLATIONS, EVALUATE_ALL_BONES, SEARCH_ALL_BONES, SWEEP_SETS, TRAINED, Scale
from nilbs.methods.base import NOISE
from nilbs.methods.inverse_skinning import MAPPINGS
from nilbs.methods.registry import all_methods, method_class, values_of

# Raised when trainings or scores change without a change of settings.
RECIPE = 3
# Other mappings of the trained default field, and rows that learn nothing.
OTHER_MAPPINGS = tuple(name for name in MAPPINGS if name != "search")
OWN = ("nilbs", "paper")  # methods that have these mappings
UNLEARNED = ("nearest", "rigid-parts", "floor", "mesh-lbs")
# Rows of the default model's first seed whose surfaces are scored too.
SURFACE_ROWS = ("floor", "inverse", "nearest")
# Characters with too many bones for rows that evaluate every bone at every point, and for surfaces.
MANY_BONES = ("makehuman",)
# Methods of the sweeps over amplitude, training time and noise.
SWEPT = ("nilbs", "nasa", "snarf", "mlp")
# Work that is left out to save time; some of it for one character.
SPARED = (
    "Baselines are not scored on interpolated poses. Seeds after the first are scored on unseen and far poses only, in "
    "the sweeps over training poses, training time and noise on unseen ones only. Surfaces of baselines are extracted "
    "on the elephant and the 2D man. SNARF searches from every bone for every point: its surfaces are extracted on the "
    "2D man only, and it has every other number of training poses",
    f"The sweeps over amplitude, training time and noise are of {', '.join(SWEPT)}, and all sweeps are scored at the "
    "points near the surface alone",
)
SPARED_OF = {
    "elephant": "The elephant's other mappings are scored in the ablation alone, of a model of its own",
    "makehuman": "On MakeHuman's body NASA is scored on seen and unseen poses and SNARF at a tenth of the points near "
    "the surface of unseen ones, both without extracted surfaces; rigid parts and the search from all bones are left "
    "out",
}
SURFACE_SETS = ("seen", "unseen")
# Characters on which baselines' surfaces are extracted, and the baselines that are left out.
_BASELINE_SURFACES: Mapping[str, Sequence[str]] = {"gingerbread-2d": (), "elephant": SEARCH_ALL_BONES}


def plan(scale: Scale, missing: Sequence[str] = ()) -> Plan:
    """All jobs of the study in the order of `PARTS`, each model's scores after its training; `missing` is left out."""
    builder = Builder()
    builder.missing += missing
    builder.missing += [*SPARED, *(sentence for name, sentence in SPARED_OF.items() if name in scale.characters)]
    if scale.sweep is None:
        builder.missing.append("the sweeps are left out: they are of the elephant")
    for part, add in PARTS.items():
        if scale.sweep is not None or part not in SWEEPS:
            add(scale, builder)
    return builder.plan()


@cache
def defaults() -> str:
    """A digest of all default settings and of `RECIPE`, which is raised when a constant changes that is no setting."""
    settings = {name: values_of(kind()) for name, kind in all_methods().items()}
    return sha256(json.dumps([RECIPE, settings], sort_keys=True).encode()).hexdigest()[:16]


def methods(scale: Scale, builder: Builder) -> None:
    """Accuracy by pose set of every method on every character."""
    # One method after the other, the most important first.
    for name in TRAINED:
        for character, seeds in scale.characters.items():
            for seed in range(seeds):
                _method(scale, builder, character, name, seed)
    for character in scale.characters:
        training = _training(scale, builder, character, "mesh-lbs", settings={"method": "mesh-lbs"}, minutes=None)
        entry = Entry("methods", character, "mesh-lbs", 0, "")
        _score(scale, builder, training, f"{character}/mesh-lbs/seed0/scores", entry)


def _method(scale: Scale, builder: Builder, character: str, name: str, seed: int) -> None:
    training = _training_of(scale, builder, character, name, seed)
    entry = Entry("methods", character, name, seed, "")
    _score_method(scale, builder, training, entry)
    if name != "nilbs" or seed > 0:
        return
    others = ("rigid-parts", *(row for row in OTHER_MAPPINGS if row not in SURFACE_ROWS))
    others = tuple(row for row in others if row not in EVALUATE_ALL_BONES or character not in MANY_BONES)
    if character == scale.sweep:
        others = ("rigid-parts",)  # the ablation has the mappings
    _score(scale, builder, training, f"{training.key}/other-rows", entry, rows=others, own=False)
    spec = {"training": training.key, "of": training.spec, "resolution": scale.resolution}
    picture = builder.job(Job(f"{training.key}/picture", PICTURE, spec, training.key, seconds=60))
    builder.entry(replace(entry, job=picture.key, row=PICTURE))


def _score_method(
    scale: Scale, builder: Builder, training: Job, entry: Entry, *, only: Sequence[str] | None = None
) -> None:
    """Scores of a method's own; with rows beside, for the first seed. `only` are the rows to enter."""
    rows: tuple[str, ...] = ()
    if entry.method == "nilbs":
        rows = SURFACE_ROWS if entry.seed == 0 else ("inverse",)
    poses = _affordable(scale.poses, entry)
    dear = entry.method in SEARCH_ALL_BONES and entry.character in MANY_BONES
    key = f"{training.key}/scores"
    points = scale.points // 10 if dear else scale.points
    _score(scale, builder, training, key, entry, poses=poses, rows=rows, points=points, surface_alone=dear, only=only)


def _affordable(poses: Sequence[str], entry: Entry) -> tuple[str, ...]:
    """Pose sets of a method: fewer of baselines, and of rows that evaluate very many bones at every point."""
    if entry.method == "nilbs":
        return tuple(poses)
    allowed: tuple[str, ...] = SWEEP_SETS if entry.seed else ("seen", *SWEEP_SETS)
    if entry.method in EVALUATE_ALL_BONES and entry.character in MANY_BONES:
        allowed = ("unseen",) if entry.method in SEARCH_ALL_BONES else SURFACE_SETS
    return tuple(name for name in poses if name in allowed)


def _sweep_sets(scale: Scale, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Pose sets of a training in a sweep."""
    return tuple(poses for poses in scale.sweep_poses if _method_name(settings) in OWN or poses == "unseen")


def surfaces(scale: Scale, builder: Builder) -> None:
    """Extracted surfaces of the first seed's models, and of all of the default method's."""
    poses = tuple(name for name in scale.poses if name in SURFACE_SETS)
    for character, seeds in scale.characters.items():
        for seed in range(1, seeds):
            training = _training_of(scale, builder, character, "nilbs", seed)
            entry = Entry("surfaces", character, "nilbs", seed, "")
            key, cells = f"surfaces/{character}-nilbs-seed{seed}", scale.resolution
            _score(scale, builder, training, key, entry, poses=poses, resolution=cells, rows=("floor",))
        for name in TRAINED:
            if name != "nilbs" and name in _BASELINE_SURFACES.get(character, tuple(TRAINED)):
                continue
            training = _training_of(scale, builder, character, name, 0)
            entry = Entry("surfaces", character, name, 0, "")
            key, rows = f"surfaces/{character}-{name}", SURFACE_ROWS if name == "nilbs" else ()
            _score(scale, builder, training, key, entry, poses=poses, resolution=scale.resolution, rows=rows)


def distance(scale: Scale, builder: Builder) -> None:
    """Error of distances read at canonical points, against the posed mesh."""
    for character in scale.characters:
        training = _training_of(scale, builder, character, "nilbs", 0)
        entry = Entry("distance", character, "nilbs", 0, "")
        key = f"distance/{character}"
        _score(scale, builder, training, key, entry, poses=scale.sweep_poses, distances=True)


def frames(scale: Scale, builder: Builder) -> None:
    """Accuracy against the number of training poses."""
    variants = {name: TRAINED[name] for name in ("nilbs", "nasa", "snarf")}
    variants["nilbs, no random poses"] = {"random_pose_std": 0.0}
    for name, settings in variants.items():
        for count in scale.frames[:: 2 if name in SEARCH_ALL_BONES else 1]:
            key = f"frames/{scale.sweep}-{_slug(name)}-{count}"
            training = _sweep_training(scale, builder, key, settings, training_frames=count)
            entry = Entry("frames", str(scale.sweep), name, 0, "", value=count)
            poses = _sweep_sets(scale, settings)
            rows = _inverse(settings)
            _score(scale, builder, training, f"{key}/scores", entry, poses=poses, rows=rows, surface_alone=True)


def amplitude(scale: Scale, builder: Builder) -> None:
    """Accuracy against the amplitude of random poses, of the models of `methods`."""
    poses = {value: f"random {value:g}" for value in scale.amplitudes}
    for name in SWEPT:
        training = _training_of(scale, builder, str(scale.sweep), name, 0)
        rows = ("inverse", "nearest") if name == "nilbs" else ()
        for value, pose_set in poses.items():
            entry = Entry("amplitude", str(scale.sweep), name, 0, "", value=value, poses=(pose_set,))
            key = f"amplitude/{scale.sweep}-{name}"
            sets = tuple(poses.values())
            _score(scale, builder, training, key, entry, poses=sets, rows=rows, surface_alone=True)


def time(scale: Scale, builder: Builder) -> None:
    """Accuracy against training time."""
    for name in SWEPT:
        poses = _sweep_sets(scale, TRAINED[name])
        for minutes in scale.times:
            key = f"time/{scale.sweep}-{name}-{minutes:g}min"
            if minutes == scale.minutes.get(str(scale.sweep)):
                training = _training_of(scale, builder, str(scale.sweep), name, 0)
            else:
                training = _sweep_training(scale, builder, key, TRAINED[name], minutes=minutes)
            entry = Entry("time", str(scale.sweep), name, 0, "", value=minutes)
            rows = _inverse(TRAINED[name])
            _score(scale, builder, training, f"{key}/scores", entry, poses=poses, rows=rows, surface_alone=True)


def ablation(scale: Scale, builder: Builder) -> None:
    """Settings switched one at a time, and other mappings of the default model."""
    for name in scale.ablations:
        settings = ABLATIONS[name]
        key = f"ablation/{scale.sweep}-{_slug(name)}"
        training = _sweep_training(scale, builder, key, settings)
        entry = Entry("ablation", str(scale.sweep), name, 0, "")
        poses = scale.sweep_poses
        _score(scale, builder, training, f"{key}/scores", entry, poses=poses, rows=("inverse",), surface_alone=True)
        if not settings:
            rows = tuple(row for row in OTHER_MAPPINGS if row != "inverse")
            key = f"{key}/mappings"
            _score(scale, builder, training, key, entry, poses=poses, rows=rows, surface_alone=True, own=False)


def noise(scale: Scale, builder: Builder) -> None:
    """Scores at other distances from the surface, of the models of `methods`."""
    for name in SWEPT:
        training = _training_of(scale, builder, str(scale.sweep), name, 0)
        rows = ("inverse", "nearest") if name == "nilbs" else ()
        poses = _sweep_sets(scale, TRAINED[name])
        for factor in scale.noises:
            entry = Entry("noise", str(scale.sweep), name, 0, "", value=factor)
            if factor == 1:  # scored before
                _score_method(scale, builder, training, replace(entry, poses=poses), only=("", *rows))
            else:
                key = f"noise/{scale.sweep}-{name}-x{factor}"
                away = factor * NOISE
                _score(scale, builder, training, key, entry, poses=poses, rows=rows, noise=away, surface_alone=True)


def twist(scale: Scale, builder: Builder) -> None:
    """Volume of a twisted capsule."""
    minutes = float(scale.twist.get("minutes", 0.1))
    spec = {"seed": 0, **scale.settings, **scale.twist, "defaults": defaults()}
    job = builder.job(Job("twist/capsule", TWIST, spec, seconds=120 * minutes))
    builder.entry(Entry("twist", "capsule", "twist", 0, job.key))


def failures(scale: Scale, builder: Builder) -> None:
    """Pictures of failures."""
    spec = {"seed": 0, **scale.settings, **scale.twist, "defaults": defaults()}
    spec.pop("degrees", None)
    minutes = float(spec.get("minutes", 0.1))
    job = builder.job(Job("failures/pictures", FAILURES, spec, seconds=240 * minutes))
    builder.entry(Entry("failures", "", "failures", 0, job.key))


def controls(scale: Scale, builder: Builder) -> None:
    """Predictions with expected scores, which every scoring includes."""
    for character in scale.characters:
        training = _training_of(scale, builder, character, "nilbs", 0)
        _score_method(scale, builder, training, Entry("controls", character, "nilbs", 0, ""), only=("",))


PARTS: Mapping[str, Callable[[Scale, Builder], None]] = {
    "controls": controls,
    "methods": methods,
    "surfaces": surfaces,
    "distance": distance,
    "noise": noise,
    "amplitude": amplitude,
    "ablation": ablation,
    "frames": frames,
    "time": time,
    "twist": twist,
    "failures": failures,
}
SWEEPS = ("frames", "amplitude", "time", "ablation", "noise")


def _training_of(scale: Scale, builder: Builder, character: str, name: str, seed: int) -> Job:
    """The training of a method in the part `methods`."""
    minutes = scale.minutes.get(character)
    return _training(scale, builder, character, name, settings=TRAINED[name], minutes=minutes, seed=seed)


def _training(
    scale: Scale,
    builder: Builder,
    character: str,
    name: str,
    *,
    settings: Mapping[str, Any],
    minutes: float | None,
    seed: int = 0,
) -> Job:
    key = f"{character}/{_slug(name)}/seed{seed}"
    return _train(scale, builder, key, character, settings, minutes, scale.training_frames, seed, keep=True)


def _sweep_training(
    scale: Scale,
    builder: Builder,
    key: str,
    settings: Mapping[str, Any],
    *,
    minutes: float | None = None,
    training_frames: int = 0,
) -> Job:
    """A training of which only the scores are kept."""
    minutes = scale.sweep_minutes if minutes is None else minutes
    count = training_frames or scale.training_frames
    return _train(scale, builder, key, str(scale.sweep), settings, minutes, count, 0, keep=False)


def _train(
    scale: Scale,
    builder: Builder,
    key: str,
    character: str,
    settings: Mapping[str, Any],
    minutes: float | None,
    training_frames: int,
    seed: int,
    *,
    keep: bool,
) -> Job:
    # Settings of every training are used if the method has them.
    own = {s.name for s in method_class(_method_name(settings)).settings()}
    changes = {**{name: value for name, value in scale.settings.items() if name in own}, **settings}
    if minutes is not None:
        changes.pop("steps", None)  # they follow from the time
    spec = {
        "character": character,
        "frames": training_frames,
        "minutes": None if minutes is None else float(minutes),
        "seed": seed,
        "settings": changes,
        "made_of": scale.made_of.get(character, ""),
        "defaults": defaults(),
    }
    seconds = training_seconds(_method_name(settings), minutes, training_frames)
    return builder.job(Job(key, TRAIN, spec, keep=keep, seconds=seconds))


def _score(
    scale: Scale,
    builder: Builder,
    training: Job,
    key: str,
    entry: Entry,
    *,
    poses: Sequence[str] | None = None,
    points: int | None = None,
    resolution: int = 0,
    rows: Sequence[str] = (),
    noise: float = NOISE,
    distances: bool = False,
    surface_alone: bool = False,
    own: bool = True,
    only: Sequence[str] | None = None,
) -> None:
    """Score a model, and enter its own row, if given, and the others into the tables, or `only` some of them.

    With `surface_alone` only the points near the surface are queried: enough for a sweep's tables.
    """
    spec = {
        "training": training.key,
        "of": training.spec,
        "points": scale.points if points is None else points,
        "resolution": resolution,
        "seed": training.spec["seed"],
        "poses": list(scale.poses if poses is None else poses),
        "rows": list(rows),
        "noise": noise,
        "distances": distances,
    }
    if surface_alone:
        spec["ious"] = ["iou_surface"]
    method = _method_name(training.spec["settings"])
    job = Job(key, SCORE, spec, training.key, seconds=scoring_seconds(training.spec["character"], method, spec))
    job = builder.job(job)
    entry = replace(entry, job=job.key)
    shown = ("", *rows) if own else tuple(rows)
    for row in shown if only is None else only:
        builder.entry(replace(entry, row=row, method=_row_name(entry, row) if row else entry.method))


def _row_name(entry: Entry, row: str) -> str:
    """What a row beside a model is called: on the default model by its own name, elsewhere after the model."""
    return row if entry.method in ("nilbs", "default") else f"{entry.method}: {row}"


def _method_name(settings: Mapping[str, Any]) -> str:
    return str(settings.get("method", "nilbs"))


def _inverse(settings: Mapping[str, Any]) -> tuple[str, ...]:
    return ("inverse",) if _method_name(settings) in OWN else ()


def _slug(name: str) -> str:
    """A name as part of a file's name.

    Examples
    --------
    >>> _slug("nilbs, no random poses")
    'nilbs-no-random-poses'
    """
    return "-".join(name.replace(",", " ").replace("'", "").split())
