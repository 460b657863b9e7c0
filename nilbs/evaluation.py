"""Scores of a model against the mesh skinned by ordinary linear blend skinning, on seen and on unseen poses."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nilbs.character import Character
from nilbs.fields.mesh_lbs import MeshLbs
from nilbs.fields.nearest import NearestVertex
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics, interpolate_poses, random_rotations
from nilbs.geometry.metrics import intersection_over_union, surface_scores
from nilbs.geometry.sampling import near_surface_samples, uniform_samples
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.model import Model
from nilbs.motion import Motion
from nilbs.settings import NOISE, POINTS, RESOLUTION

POSE_SETS = ("seen", "interpolated", "unseen", "far")
ROWS = ("floor", "inverse", "nearest")
POSES = 10
# Standard deviation in radians of each bone's local angle.
UNSEEN_STD, FAR_STD = 0.28, 0.8
# Scores whose worst frame is the one with the smallest value.
HIGHER_IS_BETTER = ("iou_bbox", "iou_surface", "normal_consistency", "f_score", "watertight")
# Sets the draws of a scoring apart from those of a training with the same seed.
_STREAM = 7001


@dataclass(frozen=True)
class Scores:
    """Scores by pose set, and what they were taken with.

    Attributes
    ----------
    values : dict
        What `json` returns.
    """

    values: dict[str, Any]

    def json(self) -> dict[str, Any]:
        """Schema 1: lengths in % of L; each score with its mean, its worst frame and all frames."""
        return self.values

    def __str__(self) -> str:
        """A table of means, the worst frame in brackets for the two IoUs."""
        v = self.values
        lines = [
            f"L {v['L']:.4g} mesh units, surface noise {v['noise']:g} L, {v['points']} points, "
            f"resolution {v['resolution']}, seed {v['seed']}",
            f"trained on {v['training']['frames']} frames, {v['training']['steps']} steps: {v['training']['motion']}",
            "truth: the mesh skinned by LBS, inside where |winding number| > 1/2; lengths in % of L",
            "",
            f"{'':22}{'iou_bbox':>17}{'iou_surface':>17}{'chamfer_l1':>12}{'p95':>8}{'hausdorff':>11}{'normals':>9}"
            f"{'f_score':>9}{'parts':>7}{'closed':>8}",
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
    progress: bool = False,
) -> Scores:
    """Score a model.

    Parameters
    ----------
    model : Model
    points : int
        Points of each of the two sets, and samples of each surface, per frame.
    resolution : int
        Cells of the extraction grid along each edge.
    seed : int
        Of points, samples and random poses.
    poses : sequence of str
        Which of "seen", "interpolated", "unseen" and "far".
    rows : sequence of str
        Reference methods to score beside the model: "floor", the true mesh's signed distance on the same grid;
        "inverse", the model's inverse map alone (eq. 8); "nearest", inverse skinning with the weights of the nearest
        posed vertex.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    scores : Scores

    Raises
    ------
    ValueError
        If a pose set or a row is unknown, or a number is not positive.
    """
    from tqdm import tqdm

    for given, known in ((poses, POSE_SETS), (rows, ROWS)):
        for name in given:
            if name not in known:
                raise ValueError(f"{name!r} is none of {', '.join(known)}")
    if points < 1 or resolution < 2:
        raise ValueError(f"points must be at least 1 and resolution at least 2, got {points} and {resolution}")
    frames = {name: evaluation_poses(model.character, model.motion, name, seed=seed) for name in poses}
    results: dict[str, dict[str, list[dict[str, Any]]]] = {row: {name: [] for name in poses} for row in ("", *rows)}
    total = sum(len(B) for B in frames.values())
    with tqdm(total=total, desc="scoring", unit="pose", disable=not progress, delay=2) as bar:
        for name, B in frames.items():
            for k, pose in enumerate(B):
                stream = [seed, _STREAM, POSE_SETS.index(name), k]
                for row, scores in _score_pose(model, pose, points, resolution, rows, stream).items():
                    results[row][name].append(scores)
                bar.update()
    tables = {row: {name: _summary(scores) for name, scores in sets.items()} for row, sets in results.items()}
    model_table = tables.pop("")
    return Scores(
        {
            "schema": 1,
            "L": model.character.L,
            "noise": NOISE,
            "points": points,
            "resolution": resolution,
            "seed": seed,
            "training": model.config,
            "poses": model_table,
            "rows": tables,
        }
    )


def evaluation_poses(character: Character, motion: Motion, name: str, *, seed: int) -> np.ndarray:
    """Poses of a set.

    Parameters
    ----------
    character : Character
    motion : Motion
        The training frames.
    name : str
        "seen": ten evenly spaced training frames. "interpolated": the middles of ten evenly spaced gaps between them.
        "unseen" and "far": ten random poses from the rest pose, every bone but the roots turned about a random axis by
        a normal angle of standard deviation 0.28 and 0.8 rad.
    seed : int
        Of the random poses.

    Returns
    -------
    B : (p, b, d+1, d+1) float array
        Fewer than ten where the motion has fewer frames or gaps.
    """
    c = character
    if name == "seen":
        return motion.take(POSES).B
    if name == "interpolated":
        count = min(POSES, len(motion) - 1)
        gaps = np.round(np.linspace(0, len(motion) - 2, count)).astype(int)
        middles = [interpolate_poses(c.C, c.BE, c.P, motion.B[k], motion.B[k + 1], 0.5) for k in gaps]
        return np.array(middles).reshape(-1, *motion.B.shape[1:])
    std = {"unseen": UNSEEN_STD, "far": FAR_STD}[name]
    rng = np.random.default_rng([seed, _STREAM, POSE_SETS.index(name)])
    return forward_kinematics(c.C, c.BE, c.P, random_rotations(c.P, c.d, POSES, std=std, rng=rng))


def _score_pose(
    model: Model, pose: np.ndarray, points: int, resolution: int, rows: Iterable[str], stream: list[int]
) -> dict[str, dict[str, Any]]:
    """Scores of one pose, by row; the model's own is the row without a name."""
    c = model.character
    U = linear_blend_skinning(c.V, c.W, pose)
    truth, grid = MeshLbs(U, c.F), Grid.cube(U, resolution)
    rng = np.random.default_rng([*stream, 1])
    bbox = uniform_samples(grid.lower, grid.upper, points, rng=rng)
    surface = near_surface_samples(U, c.F, points, std=NOISE * c.L, rng=rng)
    true = {"iou_bbox": truth.inside(bbox), "iou_surface": truth.inside(surface)}

    def scored(inside: dict[str, np.ndarray], mesh: tuple[np.ndarray, np.ndarray]) -> dict[str, Any]:
        ious = {name: intersection_over_union(inside[name], true[name]) for name in true}
        samples = np.random.default_rng([*stream, 2])
        return ious | surface_scores(*mesh, U, c.F, unit=c.L, n=points, rng=samples)

    points_by_name = {"iou_bbox": bbox, "iou_surface": surface}
    predicted = {name: model.occupancy(x, pose) > 0.5 for name, x in points_by_name.items()}
    results = {"": scored(predicted, model.extract_on(grid, pose))}
    for row in rows:
        if row == "floor":
            results[row] = scored(true, truth.extract_on(grid))
        elif row == "inverse":
            inside = {n: model.occupancy(x, pose, mapping=row) > 0.5 for n, x in points_by_name.items()}
            results[row] = scored(inside, model.extract_on(grid, pose, mapping=row))
        else:
            nearest = NearestVertex(c.V, c.F, c.W, pose)
            results[row] = scored({n: nearest.inside(x) for n, x in points_by_name.items()}, nearest.extract_on(grid))
    return results


def _summary(frames: list[dict[str, Any]]) -> dict[str, Any]:
    names = frames[0] if frames else {}
    summary = {}
    for name in names:
        values = [scores[name] for scores in frames]
        known = [float(value) for value in values if value is not None]
        worst = (min if name in HIGHER_IS_BETTER else max)(known, default=None)
        summary[name] = {"mean": float(np.mean(known)) if known else None, "worst": worst, "frames": values}
    return summary


def _table_row(name: str, scores: dict[str, Any]) -> str:
    def mean(score: str, width: int, decimals: int) -> str:
        value = scores.get(score, {}).get("mean")
        return f"{'-':>{width}}" if value is None else f"{value:{width}.{decimals}f}"

    def with_worst(score: str) -> str:
        worst = scores.get(score, {}).get("worst")
        return mean(score, 9, 4) + ("        " if worst is None else f" ({worst:.3f})"[:8].rjust(8))

    return (
        f"{name:22}{with_worst('iou_bbox')}{with_worst('iou_surface')}{mean('chamfer_l1', 12, 3)}{mean('p95', 8, 3)}"
        f"{mean('hausdorff', 11, 2)}{mean('normal_consistency', 9, 4)}{mean('f_score', 9, 4)}{mean('components', 7, 1)}"
        f"{mean('watertight', 8, 2)}"
    )
