"""Where the time of one pose goes: the stages of a query, beside the machine's memory bandwidth.

Usage: python -m benchmarks.profile MODEL [--points N] [--threads T] [--json FILE]

Every stage is timed alone, as the median of repeats. Stages of compiled code that share one loop are timed by kernels
that do the one thing for all points: what they read is then in the cache as often as in the whole.
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from nilbs.engine.compiled import compiled, in_pieces, set_threads, threads
from nilbs.engine.distances import rest_distance
from nilbs.engine.lattice import Images
from nilbs.engine.search import PIECE, PosedSearch, SearchEngine, find_starts, kept
from nilbs.engine.sorted_points import SortedPoints
from nilbs.engine.weights import transforms
from nilbs.geometry.sampling import near_surface_samples, uniform_samples
from nilbs.methods.base import NOISE
from nilbs.models.model import Model, load_model

REPEATS = 15
# Bytes that are copied to measure bandwidth: more than any cache holds.
COPIED = 2**28


@compiled
def _all_starts(points, begin, end, lattice, cells, room):  # type: ignore[no-untyped-def]
    find_starts(points, begin, end, lattice, cells, room)


@compiled
def _all_distances(x_rest, begin, end, distances, found):  # type: ignore[no-untyped-def]
    for i in range(begin, end):
        found[i] = rest_distance(x_rest[i, 0], x_rest[i, 1], x_rest[i, 2], distances)


def milliseconds(function: Callable[[], Any]) -> float:
    """Median time of a call, which is called once before."""
    function()
    spent = []
    for _ in range(REPEATS):
        start = perf_counter()
        function()
        spent.append(perf_counter() - start)
    return 1e3 * float(np.median(spent))


def bandwidth() -> float:
    """Gigabytes per second that all threads read and write when they copy."""
    source, target = np.ones(COPIED // 8), np.empty(COPIED // 8)

    def copy(begin: int, end: int) -> None:
        target[begin:end] = source[begin:end]

    spent = milliseconds(lambda: in_pieces(copy, len(source), piece=2**18))
    return 2 * COPIED / spent / 1e6


def stages(model: Model, x: np.ndarray, B: np.ndarray) -> dict[str, Any]:
    """Milliseconds of each stage, and what a query looked up."""
    engine, frame = model.engine(), model.posed(B).frame
    assert isinstance(engine, SearchEngine)
    posed: PosedSearch = engine(frame.B)
    images = posed.images_of_cells
    points = SortedPoints.of(x, frame.to_unit, images.low, images.high)
    answer = posed(x, frame.to_unit)
    looks = posed.evaluations
    # In the order in which a query reads them.
    x_rest = answer.x_rest[points.number]
    x_rest = x_rest[np.isfinite(x_rest[:, 0])]
    place = np.zeros((len(x_rest), 3), dtype=np.float32)
    place[:, : engine.d] = x_rest
    found = np.empty(len(x_rest), dtype=np.float32)

    def starts(begin: int, end: int) -> None:
        _all_starts(points, begin, end, engine.lattice, images.cell, kept.room)

    def distances(begin: int, end: int) -> None:
        _all_distances(place, begin, end, engine.distances, found)

    count = len(points.number)
    forward = milliseconds(lambda: posed.images(x_rest)) if len(x_rest) else 0.0
    times = {
        "unit frame and checks": milliseconds(lambda: model.posed(B)),
        "pose the lattice of starts": milliseconds(lambda: Images.of(engine.lattice, transforms(frame.B))),
        "sort points": milliseconds(lambda: SortedPoints.of(x, frame.to_unit, images.low, images.high)),
        "find starts": milliseconds(lambda: in_pieces(starts, count, piece=PIECE)),
        "forward map, all look-ups": forward * looks / max(len(x_rest), 1),
        "rest distance, one a root": milliseconds(lambda: in_pieces(distances, len(place), piece=PIECE)),
    }
    whole = milliseconds(lambda: model.posed(B).occupancy(x))
    times["Newton steps, choice of roots, rest"] = max(whole - sum(times.values()), 0.0)
    return {"whole": whole, "stages": times, "look_ups": looks / len(x), "roots": len(x_rest) / len(x)}


def bytes_kept(engine: SearchEngine) -> dict[str, float]:
    """MiB of what a query reads."""
    parts = {"weights": engine.weights, "distances": engine.distances, "lattice": engine.lattice}
    return {
        name: sum(array.nbytes for array in part if isinstance(array, np.ndarray)) / 2**20
        for name, part in parts.items()
    }


def profile(model: Model, *, points: int) -> dict[str, Any]:
    """The profile of a model in the middle frame of its motion."""
    B = np.asarray(model.motion[len(model.motion) // 2])
    U, c, rng = model.skinning.posed(B), model.character, np.random.default_rng(0)
    center, half = (U.min(axis=0) + U.max(axis=0)) / 2, 0.55 * np.ptp(U, axis=0).max()
    sets = {
        "near": near_surface_samples(U, c.F, points, std=NOISE * c.L, rng=rng),
        "uniform": uniform_samples(center - half, center + half, points, rng=rng),
    }
    engine = model.engine()
    assert isinstance(engine, SearchEngine)
    return {
        "points": points,
        "threads": threads(),
        "bandwidth_gb_s": bandwidth(),
        "kept_mib": bytes_kept(engine),
        "sets": {name: stages(model, x, B) for name, x in sets.items()},
    }


def table(found: dict[str, Any]) -> str:
    """The profile as a table."""
    kept = ", ".join(f"{name} {size:.1f} MiB" for name, size in found["kept_mib"].items())
    lines = [
        f"{found['points']:,} points of one pose, {found['threads']} threads",
        f"memory bandwidth: {found['bandwidth_gb_s']:.1f} GB/s",
        f"read by queries: {kept}",
        "",
        f"{'milliseconds':38}" + "".join(f"{name:>10}" for name in found["sets"]),
    ]
    sets = list(found["sets"].values())
    lines += [f"{stage:38}" + "".join(f"{s['stages'][stage]:10.2f}" for s in sets) for stage in sets[0]["stages"]]
    lines += [f"{'whole':38}" + "".join(f"{s['whole']:10.2f}" for s in sets)]
    lines += [f"{'look-ups a point':38}" + "".join(f"{s['look_ups']:10.2f}" for s in sets)]
    once = 1e3 * sum(found["kept_mib"].values()) * 2**20 / (found["bandwidth_gb_s"] * 1e9)
    lines += ["", f"Reading all that is kept once, at that bandwidth, takes {once:.2f} ms."]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Print the profile of a model file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.profile", description=__doc__.splitlines()[0])
    parser.add_argument("model", help="model file of the method nilbs")
    parser.add_argument("--points", type=int, default=100_000, help="points of the pose (default: 100000)")
    parser.add_argument("--threads", type=int, help="threads (default: all cores)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where to write the numbers")
    args = parser.parse_args(arguments)
    set_threads(args.threads)
    found = profile(load_model(args.model), points=args.points)
    print(table(found))
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
