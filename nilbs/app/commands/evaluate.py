"""`nilbs evaluate`: score a model against ordinary skinning."""

import argparse

from nilbs.app.options import add_device, add_json, add_points, add_resolution, add_seed
from nilbs.methods.registry import all_methods

EXAMPLE = "nilbs evaluate hero.nilbs --out scores"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument(
        "--out", metavar="DIR", help="also write scores.json, scores.txt, pictures and report.html, a page of all, here"
    )
    rows = {"floor": "the true mesh's own distance on the same grid"}
    for kind in all_methods().values():
        rows |= kind.mappings if kind.trained else {kind.name: kind.summary}
    parser.add_argument(
        "--rows",
        nargs="+",
        default=(),
        choices=tuple(rows),
        metavar="ROW",
        help="score these beside the model: " + "; ".join(f"{row}, {what}" for row, what in rows.items()),
    )
    add_points(parser)
    add_resolution(parser)
    add_seed(parser)
    add_device(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Score, write and report."""
    from pathlib import Path

    from nilbs.app.output import show
    from nilbs.app.scoring import SCORE_FILES, write_scores
    from nilbs.io import check_writable
    from nilbs.models.model import load_model

    model = load_model(args.model, device=args.device)
    if args.out is not None:
        from nilbs.figures import figure_files, write_figures
        from nilbs.reports.evaluation import FILES, write_evaluation_page

        # Before the work: what would fail only after it.
        Path(args.out).mkdir(parents=True, exist_ok=True)
        for name in (*SCORE_FILES, *FILES, *figure_files(model)):
            check_writable(Path(args.out) / name)

    from nilbs.models.evaluation import evaluate

    scores = evaluate(
        model, points=args.points, resolution=args.resolution, seed=args.seed, rows=args.rows, progress=True
    )
    if args.out is not None:
        write_scores(scores, Path(args.out))
        pictures = write_figures(model, args.out, resolution=args.resolution)
        write_evaluation_page(args.out, model, scores.values, pictures=pictures, resolution=args.resolution)
    show(scores.values, as_json=args.json, table=str(scores))
