"""
Score a field against the skinned mesh
======================================

Run it as it is, or on your files::

    python examples/04_score_against_mesh_lbs.py
    python examples/04_score_against_mesh_lbs.py --mesh arm.obj --rig arm.tgf --steps 4000

Expect, within a minute: a table of four sets of poses (training frames, between them, random, far). Beside the field
it has the row ``floor``, the true surface on the same grid: no method can score better there. Few points, few steps and
a coarse grid keep this short. For full scores use ``nilbs train`` and ``nilbs evaluate``.
"""

import argparse
import json
from pathlib import Path

import nilbs

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description="Train briefly and score the field.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument("--model", type=Path, help="score this model file instead of training one")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--points", type=int, default=10_000, help="points a frame")
    parser.add_argument("--resolution", type=int, default=64, help="cells along the edge of the grid")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    if args.model is not None:
        model = nilbs.load_model(args.model)
    else:
        character = nilbs.load_character(args.mesh, args.rig, progress=True)
        motion = nilbs.random_motion(character, frames=args.frames, seed=args.seed)
        model = nilbs.fit(character, motion, steps=args.steps, seed=args.seed, progress=True)

    scores = nilbs.evaluate(
        model, points=args.points, resolution=args.resolution, seed=args.seed, rows=("floor",), progress=True
    )
    print(scores)
    path = args.out / "04_scores.json"
    path.write_text(json.dumps(scores.values, indent=1))
    print(path)


if __name__ == "__main__":
    main()
