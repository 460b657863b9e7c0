"""`nilbs evaluate`: score a model against ordinary skinning."""

import argparse

from nilbs.app.options import add_json, add_seed, whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument("--out", metavar="DIR", help="also write scores.json, scores.txt and pictures here")
    parser.add_argument(
        "--points", type=whole(1), default=100_000, metavar="N", help="points per frame of the scores (default 100000)"
    )
    parser.add_argument(
        "--resolution", type=whole(2), default=128, metavar="N", help="cells along the grid's edge (default 128)"
    )
    add_seed(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Score, write and report."""
    import json
    from pathlib import Path

    from nilbs.app.output import plain, show
    from nilbs.io import check_writable, replacing
    from nilbs.model import load_model

    model = load_model(args.model)
    if args.out is not None:
        Path(args.out).mkdir(parents=True, exist_ok=True)
        check_writable(Path(args.out) / "scores.json")

    from nilbs.evaluation import evaluate

    scores = evaluate(model, points=args.points, resolution=args.resolution, seed=args.seed, progress=True)
    if args.out is not None:
        from nilbs.figures import write_figures

        with replacing(Path(args.out) / "scores.json", "w") as file:
            file.write(json.dumps(plain(scores.json()), indent=1, allow_nan=False) + "\n")
        with replacing(Path(args.out) / "scores.txt", "w") as file:
            file.write(f"{scores}\n")
        write_figures(model, args.out, resolution=args.resolution)
    show(scores.json(), as_json=args.json, table=str(scores))
