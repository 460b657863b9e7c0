"""Times of contestants that take turns."""

import gc
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from nilbs.race.contestants import Contestant
from nilbs.race.scenes import Scene


def warm_up(contestant: Contestant, scene: Scene) -> np.ndarray:
    """The answer of a first call, which may compile and is not timed."""
    x = contestant.points(scene.x)
    contestant.pose(scene.B)
    return contestant.query(x)


def times(
    contestants: Mapping[str, Contestant],
    block: Callable[[int], Sequence[Scene]],
    repeats: int,
    *,
    turn: Callable[[str], None] = lambda name: None,
) -> dict[str, dict[str, float]]:
    """Times by contestant: medians over repeats, in seconds per pose.

    Parameters
    ----------
    contestants : mapping of str to Contestant
        They take turns within each repeat, and another one begins each.
    block : function of int
        The scenes of a repeat.
    repeats : int
    turn : function of str
        Called before each turn with the contestant's name.

    Returns
    -------
    times : dict
        `pose_s`, `query_s` and `total_s`, and the fastest and slowest repeat, `low_s` and `high_s`.
    """
    names = list(contestants)
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    collecting = gc.isenabled()
    for repeat in range(repeats):
        scenes = block(repeat)
        first = repeat % max(len(names), 1)
        for name in names[first:] + names[:first]:
            turn(name)
            contestant = contestants[name]
            points = [contestant.points(scene.x) for scene in scenes]
            gc.collect()
            gc.disable()
            try:
                pose, query = _spent(contestant, scenes, points)
            finally:
                if collecting:
                    gc.enable()
            spent[name].append((pose / len(scenes), query / len(scenes)))
    return {name: _medians(np.array(found)) for name, found in spent.items()}


def _spent(contestant: Contestant, scenes: Sequence[Scene], points: Sequence[Any]) -> tuple[float, float]:
    """Seconds that all poses and all queries take; of a contestant that takes them together, all are the query's."""
    if (together := getattr(contestant, "together", None)) is not None:
        start = perf_counter()
        together(np.array([scene.B for scene in scenes]), np.array(points))
        return 0.0, perf_counter() - start
    pose = query = 0.0
    for scene, x in zip(scenes, points, strict=True):
        start = perf_counter()
        contestant.pose(scene.B)
        posed = perf_counter()
        contestant.query(x)
        query += perf_counter() - posed
        pose += posed - start
    return pose, query


def _medians(found: np.ndarray) -> dict[str, float]:
    total = found.sum(axis=1)
    pose, query = np.median(found, axis=0)
    return {
        "pose_s": float(pose),
        "query_s": float(query),
        "total_s": float(np.median(total)),
        "low_s": float(total.min()),
        "high_s": float(total.max()),
    }
