"""Scores of a model against the mesh skinned by ordinary linear blend skinning, on seen and on unseen poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.engine.surface_tree import SurfaceTree
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics, random_rotations
from nilbs.geometry.metrics import HIGHER_IS_BETTER, intersection_over_union, surface_scores
from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.sampling import near_surface_samples, uniform_samples
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.base import NOISE
from nilbs.methods.mesh_lbs.field import PosedMesh
from nilbs.methods.registry import untrained
from nilbs.models.fitting import fit
from nilbs.models.model import Model
from nilbs.models.protocol import IOUS, POINTS, POSE_SETS, RESOLUTION

POSES = 10
# Standard deviation in radians of each bone's local angle.
UNSEEN_STD, FAR_STD = 0.28, 0.8
# Sets the draws of a scoring apart from those of a training with the same seed.
_STREAM = 7001


@dataclass(frozen=True)
class Scores:
    """Scores by pose set, and what they were taken with.

    Attributes
    ----------
    values : dict
        What JSON files of scores hold (schema 1): lengths in % of L; each score with its mean, its worst frame and all
        frames. What is undefined in a frame, as distances to an empty surface are, has neither mean nor worst.
    """

    values: dict[str, Any]

    def __str__(self) -> str:
        """A table of means, the worst frame in brackets for the two IoUs."""
        v = self.values
        training = v["training"]
        lines = [
            f"L {v['L']:.4g} mesh units, surface noise {v['noise']:g} L, {v['points']} points, "
            f"resolution {v['resolution']}, seed {v['seed']}",
            f"trained on {training['frames']} frames, {training.get('steps') or 0} steps: {training['motion']}",
            "truth: the mesh skinned by LBS, inside where |winding number| > 1/2; lengths in % of L",
            "",
            f"{'':26}{'iou_bbox':>17}{'iou_surface':>17}{'chamfer_l1':>12}{'p95':>8}{'hausdorff':>11}{'normals':>9}"
            f"{'f_score':>9}{'parts':>7}{'closed':>8}{'lookups':>9}",
        ]
        for row, sets in {"": v["poses"], **v["rows"]}.items():
            for name, scores in sets.items():
                lines.append(_table_row(f"{row + ' ' if row else ''}{name}", scores))
        return "\n".join(lines)


def evaluate(
    model: Model,
    *,
    points: int = POINTS,
    resolution: int = RESOLUTION,
    seed: int = 0,
    poses: Sequence[str] = POSE_SETS,
    rows: Sequence[str] = (),
    noise: float = NOISE,
    ious: Sequence[str] = IOUS,
    distances: bool = False,
    progress: bool = False,
) -> Scores:
    """Score a model.

    Parameters
    ----------
    model : Model
    points : int
        Points of each of the two sets, and samples of each surface, per frame.
    resolution : int
        Cells of the extraction grid along each edge; 0 scores no surfaces.
    seed : int
        Of points, samples and random poses.
    poses : sequence of str
        Which of "seen", "interpolated", "unseen" and "far"; and "random S" for other random poses, whose angles have a
        standard deviation of S radians.
    rows : sequence of str
        What to score beside the model: "floor", the truth's own surface on the same grid; the names of methods that
        learn nothing; the mappings of the model's method.
    noise : float
        Standard deviation of the points near the surface, in units of L.
    ious : sequence of str
        "iou_bbox" and "iou_surface", or one of them: at which points to score.
    distances : bool
        Whether to compare distances at the points near the surface with the posed mesh's own: those read at rest
        (`distance_error`) and those corrected by the local stretch (`posed_distance_error`), mean absolute differences
        in % of L.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    scores : Scores

    Raises
    ------
    ValueError
        If a pose set, a row or a score is unknown, or a number is not positive.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.models.fitting import fit
    >>> from nilbs.characters.motion import random_motion
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="mesh-lbs")
    >>> scores = evaluate(model, points=100, resolution=8, poses=["seen"])
    >>> scores.values["poses"]["seen"]["iou_bbox"]["mean"]
    1.0
    """
    from nilbs.geometry.progress import progress_bar

    if points < 1 or resolution == 1 or resolution < 0 or not noise >= 0:
        raise ValueError(
            "points must be at least 1, resolution 0 or at least 2, noise at least 0; "
            f"got {points}, {resolution}, {noise}"
        )
    _check_scores(model, rows, ious, distances=distances)
    frames = {name: evaluation_poses(model.character, model.motion, name, seed=seed) for name in poses}
    predictors = {row: _predictor(model, row) for row in ("", *rows)}
    results: dict[str, dict[str, list[dict[str, Any]]]] = {row: {name: [] for name in poses} for row in predictors}
    controls: list[dict[str, dict[str, float]]] = []
    seconds = dict.fromkeys(predictors, 0.0)
    total = sum(len(B) for B in frames.values())
    with progress_bar(total=total, desc="scoring", unit="pose", shown=progress) as bar:
        for name, B in frames.items():
            for k, pose in enumerate(B):
                stream = [seed, _STREAM, _pose_stream(name), k]
                scene = _Scene.of(model.character, pose, points, resolution, noise, ious, stream)
                if k == 0:  # one pose of a set is enough, because the truth is evaluated at all of its points again
                    controls.append(scene.controls())
                for row, posed in predictors.items():
                    start = perf_counter()
                    prediction = posed(pose)
                    inside = scene.inside(prediction)
                    seconds[row] += perf_counter() - start
                    results[row][name].append(scene.scores(prediction, inside, distances=distances))
                bar.update()
    tables = {row: {name: _summary(scores) for name, scores in sets.items()} for row, sets in results.items()}
    model_table = tables.pop("")
    return Scores(
        {
            "schema": 1,
            "L": model.character.L,
            "noise": noise,
            "points": points,
            "resolution": resolution,
            "seed": seed,
            "training": model.config,
            "controls": {
                kind: {score: float(np.mean([control[kind][score] for control in controls])) for score in ious}
                for kind in (controls[0] if controls else ())
            },
            # For 100,000 points of a pose, and their share of the setup of the pose: half, where each of two sets has
            # as many, and more where sets are smaller.
            "query_seconds": {
                row: POINTS * spent / (len(ious) * points * max(total, 1))
                for row, spent in seconds.items()
                if row != "floor"
            },
            "poses": model_table,
            "rows": tables,
        }
    )


def _check_scores(model: Model, rows: Sequence[str], ious: Sequence[str], *, distances: bool) -> None:
    own = model.method.mappings
    for name in rows:
        known = ["floor", *untrained(), *own]
        if name not in known:
            raise ValueError(
                f"{name!r} is no row of a model of the method {model.method.name}{nearest_name(name, known)}; rows are "
                f"{', '.join(known)}"
            )
    if distances and (not own or set(rows) - {"floor", *own}):
        raise ValueError("distances are compared for the methods nilbs and paper and their own rows only")
    if not ious or set(ious) - set(IOUS):
        raise ValueError(f"ious must be some of {', '.join(IOUS)}, got {', '.join(ious) or 'none'}")
    if distances and "iou_surface" not in ious:
        raise ValueError("distances are compared at the points of iou_surface, which must be scored too")


def evaluation_poses(character: Character, motion: Motion, name: str, *, seed: int) -> np.ndarray:
    """Poses (p, b, d+1, d+1) of a set; fewer than ten if the motion of training frames has fewer frames or gaps.

    "seen": ten evenly spaced training frames. "interpolated": the middles of ten evenly spaced gaps between them, none
    between two clips. "unseen" and "far": ten random poses, drawn with `seed`, all bones but the roots turned from rest
    about a random axis by a normal angle of standard deviation 0.28 and 0.8 rad. "random S": the same with S rad.
    """
    c = character
    if name == "seen":
        return motion.take(POSES).B
    if name == "interpolated":
        gaps = motion.gaps()
        gaps = gaps[np.round(np.linspace(0, len(gaps) - 1, min(POSES, len(gaps)))).astype(int)]
        return motion.at(frame=gaps + 0.5)
    rng = np.random.default_rng([seed, _STREAM, _pose_stream(name)])
    return forward_kinematics(
        c.skeleton.C,
        c.skeleton.BE,
        c.skeleton.P,
        random_rotations(c.skeleton.P, c.d, POSES, std=_angle_std(name), rng=rng),
    )


def _angle_std(name: str) -> float:
    """Standard deviation of the angles of a set of random poses, in radians."""
    known = {"unseen": UNSEEN_STD, "far": FAR_STD}
    if name in known:
        return known[name]
    kind, _, number = name.partition(" ")
    try:
        std = float(number) if kind == "random" else -1.0
    except ValueError:
        std = -1.0
    if not 0 <= std < 100:
        meant = nearest_name(name, POSE_SETS)
        raise ValueError(f"{name!r} is none of {', '.join(POSE_SETS)} and no 'random S' with S in radians{meant}")
    return std


def _pose_stream(name: str) -> int:
    """A number of its own for every set of poses."""
    return POSE_SETS.index(name) if name in POSE_SETS else len(POSE_SETS) + round(1e6 * _angle_std(name))


class _Posed(Protocol):
    """What is scored, in a pose."""

    @property
    def lookups(self) -> float | None: ...
    def occupancy(self, x: np.ndarray) -> np.ndarray: ...
    def distance(self, x: np.ndarray) -> np.ndarray: ...
    def posed_distance(self, x: np.ndarray) -> np.ndarray: ...
    def extract_on(self, grid: Grid, *, polish: bool) -> tuple[np.ndarray, np.ndarray]: ...


def _predictor(model: Model, row: str) -> Callable[[np.ndarray], _Posed | None]:
    """A row's answers, by pose; the model's own is the row without a name. The floor has none of its own."""
    if row == "floor":
        return lambda pose: None
    if row == "" or row in model.method.mappings:
        return lambda pose: model.posed(pose, mapping=row or None)
    baseline = fit(model.character, model.motion, row)
    return lambda pose: baseline.posed(pose)


@dataclass(frozen=True)
class _Scene:
    """One pose's truth, and the points that it is compared at."""

    character: Character
    truth: PosedMesh
    grid: Grid
    resolution: int
    samples: int
    points: dict[str, np.ndarray]  # by score
    true: dict[str, np.ndarray]
    stream: list[int]

    @classmethod
    def of(
        cls,
        c: Character,
        pose: np.ndarray,
        points: int,
        resolution: int,
        noise: float,
        ious: Sequence[str],
        stream: list[int],
    ) -> "_Scene":
        U = linear_blend_skinning(c.V, c.W, pose)
        truth, grid = PosedMesh(U, c.F), Grid.cube(U, resolution or 1)
        rng = np.random.default_rng([*stream, 1])
        bbox = uniform_samples(grid.lower, grid.upper, points, rng=rng)  # also where it is not scored: the stream's
        surface = near_surface_samples(U, c.F, points, std=noise * c.L, rng=rng)
        scored = {name: x for name, x in (("iou_bbox", bbox), ("iou_surface", surface)) if name in ious}
        true = {name: truth.inside(x) for name, x in scored.items()}
        return cls(c, truth, grid, resolution, points, scored, true, stream)

    def controls(self) -> dict[str, dict[str, float]]:
        """Scores of predictions whose scores are known: the truth evaluated again, nothing, and its opposite."""
        again = {name: self.truth.inside(x).astype(np.float64) for name, x in self.points.items()}
        predictions = {
            "perfect": again,
            "empty": {name: 0.0 * value for name, value in again.items()},
            "inverted": {name: 1.0 - value for name, value in again.items()},
        }
        return {kind: self._ious(_above_half(occupancies)) for kind, occupancies in predictions.items()}

    def inside(self, posed: _Posed | None) -> dict[str, np.ndarray]:
        """Which points a prediction has inside; the truth itself if there is no prediction."""
        if posed is None:
            return self.true
        occupancy = posed.occupancy(np.concatenate(list(self.points.values())))
        ends = np.cumsum([len(x) for x in self.points.values()])
        return _above_half(dict(zip(self.points, np.split(occupancy, ends[:-1]), strict=True)))

    def scores(self, posed: _Posed | None, inside: dict[str, np.ndarray], *, distances: bool) -> dict[str, Any]:
        """Scores of a prediction; of the truth's own surface where there is none."""
        scores: dict[str, Any] = self._ious(inside) | {"lookups": None if posed is None else posed.lookups}
        if posed is None:
            return scores | self._surface(self.truth.extract_on)
        if distances:
            x, c = self.points["iou_surface"], self.character
            true = signed_distance(self.truth.U, c.F, x)
            for name, found in (("distance_error", posed.distance), ("posed_distance_error", posed.posed_distance)):
                scores[name] = 100 / c.L * float(np.abs(found(x) - true).mean())
        # Not polished: for all methods alike, and for the floor, levels at the nodes of the grid make the surface.
        return scores | self._surface(partial(posed.extract_on, polish=False))

    def _ious(self, inside: dict[str, np.ndarray]) -> dict[str, float]:
        return {name: intersection_over_union(inside[name], true) for name, true in self.true.items()}

    def _surface(self, extract_on: Callable[[Grid], tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
        if not self.resolution:
            return {}
        rng, c = np.random.default_rng([*self.stream, 2]), self.character
        U, F = extract_on(self.grid)
        return surface_scores(
            U, F, self.truth.U, self.truth.F, unit=c.L, n=self.samples, rng=rng, closest=_closest_points
        )


def _closest_points(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, facet and place of the closest points of a surface; `nilbs.geometry.distance` has the twin."""
    found = SurfaceTree(V, F).posed(V).closest(x)
    return found.distance, found.facet, found.point


def _above_half(occupancies: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Which points are inside, by predicted occupancies."""
    return {name: occupancy > 0.5 for name, occupancy in occupancies.items()}


def _summary(frames: list[dict[str, Any]]) -> dict[str, Any]:
    names = frames[0] if frames else {}
    summary = {}
    for name in names:
        values = [scores[name] for scores in frames]
        mean = worst = None
        if None not in values:  # a mean over some of the frames would hide those where there is no surface
            mean, worst = float(np.mean(values)), float((min if name in HIGHER_IS_BETTER else max)(values))
        summary[name] = {"mean": mean, "worst": worst, "frames": values}
    return summary


def _table_row(name: str, scores: dict[str, Any]) -> str:
    def mean(score: str, width: int, decimals: int) -> str:
        value = scores.get(score, {}).get("mean")
        return f"{'-':>{width}}" if value is None else f"{value:{width}.{decimals}f}"

    def with_worst(score: str) -> str:
        worst = scores.get(score, {}).get("worst")
        return mean(score, 9, 4) + ("        " if worst is None else f" ({worst:.3f})"[:8].rjust(8))

    return (
        f"{name:26}{with_worst('iou_bbox')}{with_worst('iou_surface')}{mean('chamfer_l1', 12, 3)}{mean('p95', 8, 3)}"
        f"{mean('hausdorff', 11, 2)}{mean('normal_consistency', 9, 4)}{mean('f_score', 9, 4)}{mean('components', 7, 1)}"
        f"{mean('watertight', 8, 2)}{mean('lookups', 9, 2)}"
    )
