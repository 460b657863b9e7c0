"""About how long jobs of the study take, for reports before and during a run."""

from collections.abc import Mapping
from typing import Any

from benchmarks.study.characters import SOURCES
from benchmarks.study.scale import EVALUATE_ALL_BONES
from nilbs.models.protocol import POINTS, RESOLUTION

# Seconds a pose on one thread of two, rounded from what jobs took, the elephant's where it has them: the truth and both
# point sets; the points of a row; its surface at 128 cells; distances. Points and surfaces take longer with more bones
# if all of them are evaluated.
_TRUTH_SECONDS, _DISTANCE_SECONDS, _START_SECONDS = 1.3, 2.0, 5.0
_POINTS_SECONDS = {
    "nilbs": 2.5,
    "paper": 1.2,
    "nasa": 2.8,
    "nasa-rigid": 2.2,
    "snarf": 50.0,
    "mlp": 2.0,
    "mesh-lbs": 2.5,
    "floor": 0.0,
    "nearest": 4.0,
    "rigid-parts": 15.0,
    "all-bones": 42.0,
    "inverse": 1.2,
    "reverse": 1.2,
    "one-search": 2.4,
    "fixed-point": 2.4,
}
_GRID_SECONDS = 40.0  # of a training that fills grids of the rest pose, in space
_SURFACE_SECONDS = {"snarf": 60.0, "nasa": 8.0, "nasa-rigid": 6.0}
_BONES = {"gingerbread-2d": 13, "gingerbread-3d": 13, "arm": 4, "elephant": 24, "makehuman": 163}


def training_seconds(method: str, minutes: float | None, frames: int) -> float:
    """Of a training, with its frames labelled and its grids filled; without minutes, of a quick one."""
    if minutes is None:
        return _START_SECONDS
    return 60 * minutes + 0.2 * frames + _START_SECONDS + (_GRID_SECONDS if method in ("nilbs", "paper") else 0.0)


def scoring_seconds(character: str, method: str, spec: Mapping[str, Any]) -> float:
    """Of the scoring with this spec of a model of the method."""
    share, poses = spec["points"] / POINTS, 10 * len(spec["poses"])
    cells = (spec["resolution"] / RESOLUTION) ** 2 * (0.05 if SOURCES[character].dim == 2 else 1.0)
    share *= 0.5 if "ious" in spec else 1.0  # one of the two point sets
    seconds = (_TRUTH_SECONDS + _DISTANCE_SECONDS * spec["distances"]) * share
    for name in (method, *spec["rows"]):
        bones = _BONES[character] / _BONES["elephant"] if name in EVALUATE_ALL_BONES else 1.0
        seconds += bones * (_POINTS_SECONDS.get(name, 1.0) * share + _SURFACE_SECONDS.get(name, 6.0) * cells)
    return _START_SECONDS + poses * seconds
