"""Creatures with clips: each is made a model on its own clips, and scored beside the nearest vertex.

Usage: python -m benchmarks.creatures FOLDER --out DIR [--seeds N] [--points N] [--divide K] [--only NAME ...]

FOLDER holds a .glb file for each creature. The default mapping uses no network, so models have none: they are those of
`nilbs train FILE --steps 0`. Scores are those of `nilbs evaluate --rows nearest`, without extracted surfaces. DIR gets
creatures.csv and creatures.md.

The truth poses the corners of a triangle and keeps it flat; nilbs poses every point of it by weights, so that it bends.
With --divide K the truth is the mesh whose triangles are divided in four K times, and the models are the same: what is
better there is due to the size of the triangles.
"""

import argparse
import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.study.outputs import machine_facts
from nilbs.app.main import exit_status
from nilbs.app.options import whole
from nilbs.app.poses import print_note
from nilbs.characters import FRAMES
from nilbs.characters.bundle import load_animated
from nilbs.characters.character import Character
from nilbs.geometry.diagnosis import surface_report
from nilbs.geometry.facets import facet_normals
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.winding import occupancy
from nilbs.io.atomic import replacing
from nilbs.models.evaluation import evaluate
from nilbs.models.fitting import fit
from nilbs.models.model import Model
from nilbs.models.protocol import IOUS, POINTS, POSE_SETS
from nilbs.race.subdivision import subdivided_model

BASELINE = "nearest"
SEEDS = 3
CELLS, SAMPLES = 3, 20_000  # what is thinner than so many cells of the rest cache, and where it is tried
FILES = ("creatures.csv", "creatures.md")
COLUMNS = ("creature", "seed", "poses", "score", "nilbs", BASELINE, "worst")


@dataclass(frozen=True)
class Row:
    """A score of a creature on a pose set with a seed: the means of both methods, and nilbs' worst frame."""

    creature: str
    seed: int
    poses: str
    score: str
    nilbs: float
    nearest: float
    worst: float


def rows_of(name: str, model: Model, *, seeds: int, points: int) -> list[Row]:
    """All scores of a creature."""
    found = []
    for seed in range(seeds):
        values = evaluate(model, points=points, resolution=0, seed=seed, rows=[BASELINE], progress=True).values
        for poses in POSE_SETS:
            ours, theirs = values["poses"][poses], values["rows"][BASELINE][poses]
            found += [
                Row(name, seed, poses, score, ours[score]["mean"], theirs[score]["mean"], ours[score]["worst"])
                for score in IOUS
            ]
    return found


def thin_share(character: Character, cell: float) -> float:
    """The share of the surface where a way of three cells along the inward normal leads out of the body.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> body = capsule(resolution=16)
    >>> thin_share(body, body.L / 1000), thin_share(body, body.L)
    (0.0, 1.0)
    """
    c = character
    x, facet = facet_samples(c.V, c.F, SAMPLES, rng=np.random.default_rng(0))
    inner = x - CELLS * cell * facet_normals(c.V, c.F)[facet]
    return 1 - float(occupancy(c.V, c.F, inner).mean())


def remark(model: Model) -> str:
    """What about a mesh makes scores low: where it is open or crosses itself, and how much of it is thin."""
    c, cells = model.character, getattr(model.method, "cache_resolution", None)
    report = surface_report(c.V, c.F)
    parts = [f"open: {report.open_ridges} edges" if report.open_ridges else "closed"]
    if report.crowded_ridges:
        parts.append(f"{report.crowded_ridges} edges of three facets or more")
    if len(report.intersections):
        parts.append(f"{len(report.intersections)} crossings")
    if cells:
        parts.append(f"{100 * thin_share(c, c.L / cells):.1f} % thin")
    return ", ".join(parts)


def csv_text(rows: Sequence[Row]) -> str:
    """Scores in long form.

    Examples
    --------
    >>> csv_text([Row("fox", 0, "seen", "iou_bbox", 0.9, 0.8, 0.7)]).splitlines()[1]
    'fox,0,seen,iou_bbox,0.9,0.8,0.7'
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(vars(row) for row in rows)
    return text.getvalue()


def markdown(rows: Sequence[Row], remarks: dict[str, str]) -> str:
    """A table with a line for each creature and pose set: means over seeds, and the ratio of the mean errors.

    Examples
    --------
    >>> rows = [Row("fox", s, "seen", "iou_surface", 0.99, 0.97 + s / 100, 0.9) for s in (0, 1)]
    >>> print(markdown(rows, {"fox": "closed"}).splitlines()[2])
    | fox | seen | - | - | - | 0.9900 ± 0.0000 | 0.9750 ± 0.0050 | 0.40 | closed |
    """
    headings = [f"{kind}: {name}" for kind in ("bbox IoU", "surface IoU") for name in ("nilbs", BASELINE, "ratio")]
    lines = [
        f"| creature | poses | {' | '.join(headings)} | mesh |",
        "|---|---" + "|---" * (len(headings) + 1) + "|",
    ]
    for creature in dict.fromkeys(row.creature for row in rows):
        for poses in dict.fromkeys(row.poses for row in rows if row.creature == creature):
            cells = []
            for score in IOUS:
                those = [r for r in rows if (r.creature, r.poses, r.score) == (creature, poses, score)]
                cells += _cells(np.array([(r.nilbs, r.nearest) for r in those])) if those else ["-"] * 3
            lines.append(f"| {creature} | {poses} | {' | '.join(cells)} | {remarks.get(creature, '')} |")
    return "\n".join(lines) + "\n"


def _cells(scores: np.ndarray) -> list[str]:
    """Both means, with half their ranges if there are several seeds, and the ratio of the mean errors."""
    mean, spread = scores.mean(axis=0), np.ptp(scores, axis=0) / 2
    texts = [f"{m:.4f}" + (f" ± {s:.4f}" if len(scores) > 1 else "") for m, s in zip(mean, spread, strict=True)]
    return [*texts, f"{(1 - mean[0]) / (1 - mean[1]):.2f}" if mean[1] < 1 else "-"]


def run(args: argparse.Namespace) -> None:
    """Make and score the models, and write what there is after each of them."""
    files = sorted(Path(args.folder).glob("*.glb"))
    files = [file for file in files if not args.only or file.stem in args.only]
    if not files:
        raise ValueError(f"{args.folder}: there is no .glb file" + (" of these names" if args.only else ""))
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    remarks: dict[str, str] = {}
    truth = f"The mesh with its triangles divided in four {args.divide} times is the truth. " if args.divide else ""
    machine = machine_facts()
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    start = process_time()
    for file in files:
        character, motion = load_animated(file, report=print_note)
        model = fit(character, motion.spread(FRAMES), steps=0, report=print_note)
        scored = subdivided_model(model, args.divide)
        rows += rows_of(file.stem, scored, seeds=args.seeds, points=args.points)
        remarks[file.stem] = remark(model)
        minutes = (process_time() - start) / 60
        facts = (
            f"{truth}{'Seed 0. ' if args.seeds == 1 else f'{args.seeds} seeds, from 0: mean ± half the range. '}"
            f"Ratio: 1 - IoU of nilbs over that of {BASELINE}. "
            f"Thin: with less than {CELLS} cells of the rest cache of body below it. "
            f"{args.points} uniform points and as many at the surface, a frame. "
            f"{machine['processor']}, {machine['cores']} cores; {versions}; {minutes:.0f} minutes of processor time."
        )
        for name, text in zip(FILES, (csv_text(rows), f"{markdown(rows, remarks)}\n{facts}\n"), strict=True):
            with replacing(out / name, "w") as written:
                written.write(text)
    print((out / FILES[1]).read_text(encoding="utf-8"), end="")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; the status is that of `nilbs.app.main.main`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.creatures", description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", help="folder of .glb files: a mesh, a rig, weights and clips each")
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write creatures.csv and creatures.md")
    parser.add_argument("--seeds", type=whole(1, 100), default=SEEDS, metavar="N", help=f"seeds (default {SEEDS})")
    parser.add_argument(
        "--points", type=whole(1), default=POINTS, metavar="N", help=f"points per frame (default {POINTS})"
    )
    parser.add_argument(
        "--divide", type=whole(0, 4), default=0, metavar="K", help="divide the truth's triangles in four K times"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these creatures only, by their files' names")
    args = parser.parse_args(argv)
    return exit_status(lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())
