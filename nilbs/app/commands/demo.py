"""`nilbs demo`: train a field of the gingerbread man, score it and draw it."""

import argparse
import sys

from nilbs.app.options import add_json, add_points, add_resolution, add_seed, whole
from nilbs.characters import FRAMES

EXAMPLE = "nilbs demo --out out/demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "--dim", type=int, choices=(2, 3), default=2, help="2: the flat figure (default); 3: the cookie, a solid"
    )
    parser.add_argument("--out", metavar="DIR", default="out/demo", help="folder of all results (default out/demo)")
    parser.add_argument(
        "--frames", type=whole(1), default=FRAMES, metavar="N", help=f"frames of the random motion (default {FRAMES})"
    )
    parser.add_argument("--steps", type=whole(1), metavar="N", help="training steps")
    add_points(parser)
    add_resolution(parser)
    add_seed(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Write the character, solve for weights, train, score, and draw."""
    from pathlib import Path
    from time import perf_counter

    from nilbs.app.output import show
    from nilbs.app.scoring import SCORE_FILES, write_scores
    from nilbs.characters.bundle import load_character
    from nilbs.characters.gingerbread import write_gingerbread
    from nilbs.characters.motion import random_motion
    from nilbs.io import check_writable, write_weights

    clock, seconds = [perf_counter()], {}

    def done(stage: str) -> None:
        clock.append(perf_counter())
        seconds[stage] = clock[-1] - clock[-2]
        print(f"nilbs: {stage}: {seconds[stage]:.1f} s", file=sys.stderr, flush=True)

    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    for name in SCORE_FILES:
        check_writable(out / name)
    mesh, rig = write_gingerbread(out, args.dim)
    character = load_character(mesh, rig, progress=True)
    weights = out / f"{mesh.stem}-weights.npz"
    write_weights(weights, character.W)
    motion = random_motion(character, frames=args.frames, seed=args.seed)
    done("gingerbread and weights")

    from nilbs.models.fitting import fit

    settings = {"seed": args.seed} | ({} if args.steps is None else {"steps": args.steps})
    model = fit(character, motion, progress=True, **settings)
    path = out / f"{mesh.stem}.nilbs"
    model.save(path)
    done("training")

    from nilbs.models.evaluation import evaluate

    scores = evaluate(model, points=args.points, resolution=args.resolution, seed=args.seed, progress=True)
    tables = write_scores(scores, out)
    done("scores")

    from nilbs.figures import write_figures

    figures = write_figures(model, out, resolution=args.resolution)
    done("pictures")
    files = [mesh, rig, weights, path, *tables, *figures]
    table = "\n".join([str(scores), "", "written:", *(f"  {file}" for file in files)])
    show(scores.values | {"seconds": seconds, "files": files}, as_json=args.json, table=table)
