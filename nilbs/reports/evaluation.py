"""The page of `nilbs evaluate`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nilbs.figures.canvas import error_colours
from nilbs.figures.reconstruction import reconstruction_figure
from nilbs.figures.views import View
from nilbs.geometry.distance import closest_points
from nilbs.geometry.surface import Surface
from nilbs.models.evaluation import evaluation_poses
from nilbs.reports.page import Cell, Page, Picture, Scene, Table
from nilbs.reports.scene import scene_of_surfaces

if TYPE_CHECKING:
    from nilbs.models.model import Model

FILES = ("report.html", "worst.png")
# Worst is the frame with the smallest of this score, or of the next where it is not scored.
_RANKED = ("iou_surface", "iou_bbox")


def write_evaluation_page(
    folder: str | Path, model: "Model", values: Mapping[str, Any], *, pictures: Sequence[Path] = (), resolution: int
) -> Path:
    """Write report.html, and worst.png, which shows the worst frames, into an existing folder.

    Parameters
    ----------
    folder : path
    model : Model
    values : mapping
        Its scores, as `nilbs.models.evaluation.Scores` has them.
    pictures : sequence of Path
        PNG files to show.
    resolution : int
        Cells of the grid on which the surfaces of the worst frames are extracted.
    """
    page, worst = (Path(folder) / name for name in FILES)
    poses = worst_poses(model, values)
    surfaces = {label: Surface(*model.extract(pose, resolution=resolution)) for label, pose in poses.items()}
    shown = [Picture(path.stem, path) for path in pictures]
    if poses:
        reconstruction_figure(model, worst, poses=poses, surfaces=surfaces)
        shown.insert(0, Picture("worst frames", worst, "the frame of each set of poses with the lowest score"))
    training = values["training"]
    Page(
        title=f"{model.character.name}: scores",
        summary="A model compared with the truth, the mesh skinned by linear blend skinning. Lengths are in % of L.",
        facts={
            "method": model.method.name,
            "bones": len(model.character.skeleton.BE),
            "trained on": f"{training['frames']} frames, {training.get('steps') or 0} steps: {training['motion']}",
            "L, in mesh units": values["L"],
            "points a frame": values["points"],
            "cells of a surface": values["resolution"],
            "surface noise, in L": values["noise"],
            "seed": values["seed"],
        },
        tables=[scores_table(values), _seconds(values)],
        scene=_scene(model, poses, surfaces) if model.character.d == 3 and poses else None,
        pictures=shown,
        more=[_frames(values)],
    ).write(page)
    return page


def worst_poses(model: "Model", values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The pose of each set in which the model scores worst, by a label that names set and frame."""
    found = {}
    for name, frame in _worst(values).items():
        found[f"{name}, frame {frame}"] = evaluation_poses(
            model.character, model.motion, name, seed=values["seed"]
        )[frame]  # fmt: skip
    return found


def scores_table(values: Mapping[str, Any]) -> Table:
    """A line for each row and set of poses: means, with the worst frame below."""
    sets = [
        (row, name, scores)
        for row, by in {"": values["poses"], **values["rows"]}.items()
        for name, scores in by.items()
    ]
    scored = list(dict.fromkeys(score for *_, scores in sets for score in scores))
    lines = []
    for row, name, scores in sets:
        line = [Cell(row or "model"), Cell(name)]
        for score in scored:
            found = scores.get(score, {"mean": None, "worst": None})
            worst = "" if found["worst"] is None else f"{found['worst']:.4g}"
            line.append(Cell(found["mean"], worst))
        lines.append(line)
    return Table(
        "Scores",
        ["row", "poses", *scored],
        lines,
        "Means over the frames of a set; below, the worst frame. A click on a head sorts.",
    )


def _worst(values: Mapping[str, Any]) -> dict[str, int]:
    """The worst frame of each set."""
    found = {}
    for name, scores in values["poses"].items():
        ranked = next((scores[score]["frames"] for score in _RANKED if score in scores), None)
        if ranked:
            found[name] = int(np.argmin(ranked))
    return found


def _seconds(values: Mapping[str, Any]) -> Table:
    rows = [[Cell(row or "model"), Cell(seconds)] for row, seconds in values["query_seconds"].items()]
    return Table("Time", ["row", "seconds for 100,000 points of a pose"], rows)


def _frames(values: Mapping[str, Any]) -> Table:
    """Every frame of the model."""
    worst, lines = _worst(values), []
    scored = list(dict.fromkeys(score for scores in values["poses"].values() for score in scores))
    for name, scores in values["poses"].items():
        for frame in range(max((len(found["frames"]) for found in scores.values()), default=0)):
            numbers = [scores[score]["frames"][frame] if score in scores else None for score in scored]
            bad = frame == worst.get(name)
            lines.append([Cell(name), Cell(frame, marked=bad), *(Cell(number, marked=bad) for number in numbers)])
    return Table(
        "Frames of the model", ["poses", "frame", *scored], lines, "The worst of each set stands out.", folded=True
    )


def _scene(model: "Model", poses: Mapping[str, np.ndarray], surfaces: Mapping[str, Surface]) -> Scene:
    """True and reconstructed surfaces, coloured by their distance as in the picture."""
    c = model.character
    truths = {label: c.skin(pose) for label, pose in poses.items()}
    errors = {label: 100 * closest_points(truths[label], c.F, U)[0] / c.L for label, (U, _) in surfaces.items()}
    every = np.concatenate(list(errors.values()))
    top = max(float(np.percentile(every, 99)), 1e-6) if len(every) else 1.0
    colours = error_colours()
    meshes: dict[str, tuple[Surface, np.ndarray | None]] = {}
    for label, surface in surfaces.items():
        meshes[f"{label}|reconstructed"] = surface, colours(errors[label] / top)[:, :3]
        meshes[f"{label}|true"] = Surface(truths[label], c.F), None
    text = f"Coloured by the distance to the true surface, from pale, 0, to dark red, {top:.3g} % of L and more."
    return Scene("Worst frames", scene_of_surfaces(meshes, View.front(c.V)), text)
