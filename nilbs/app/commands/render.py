"""`nilbs render`: what a camera sees of a posed model, by sphere tracing."""

import argparse

from nilbs.app.options import add_json, add_pose, whole

EXAMPLE = "nilbs render hero.nilbs --frame 12 -o hero.png hero.npz"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    add_pose(parser)
    parser.add_argument(
        "--pixels", type=whole(2, 8192), default=512, metavar="N", help="edge of the square picture (default 512)"
    )
    for name, default, what in (("azimuth", 30.0, "from further right"), ("elevation", 18.0, "from above")):
        parser.add_argument(
            f"--{name}", type=float, default=default, metavar="DEGREES", help=f"look {what} (default {default:g})"
        )
    parser.add_argument(
        "-o",
        "--output",
        nargs="+",
        metavar="FILE",
        required=True,
        help="a picture of the shaded skin, .png, and arrays, .npz: depth (h, w) from the picture's plane, in mesh "
        "units, inf beside the body; normal and canonical (h, w, 3), nan there; axes, rows right, up and towards the "
        "viewer; lower and upper, corners of the window along the first two. The top row comes first",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Trace, write and report."""
    from pathlib import Path
    from time import perf_counter

    import numpy as np

    from nilbs.app.output import show
    from nilbs.app.poses import chosen_pose
    from nilbs.figures.views import View
    from nilbs.io import check_suffix, check_writable, write_npz
    from nilbs.models.model import load_model
    from nilbs.models.rays import first_hits

    for path in args.output:
        check_suffix(path, ".png", ".npz")
        check_writable(path)
    if len({Path(path).suffix.lower() for path in args.output}) < len(args.output):
        raise ValueError("give at most one .png and one .npz")
    model = load_model(args.model)
    c = model.character
    if c.d == 2:
        raise ValueError(f"{args.model}: this model is flat: render one of a solid, or draw this with nilbs animate")
    pose = chosen_pose(model, args)
    start = perf_counter()
    view = View.front(c.V).turned(azimuth=args.azimuth, elevation=args.elevation)
    U = model.skinning.posed(pose)
    lower, upper = view.window(U)
    right, up, toward = view.axes
    step = (np.arange(args.pixels) + 0.5) / args.pixels
    across, high = np.meshgrid(lower[0] + step * (upper[0] - lower[0]), upper[1] - step * (upper[1] - lower[1]))
    # The plane of the picture touches the body.
    plane = float((U @ toward).max())
    origin = across[..., None] * right + high[..., None] * up + plane * toward
    hits = first_hits(model, origin.reshape(-1, 3), np.broadcast_to(-toward, (args.pixels**2, 3)), pose)
    seconds = perf_counter() - start
    size = (args.pixels, args.pixels)
    for path in args.output:
        if path.lower().endswith(".png"):
            from nilbs.figures.shading import write_shaded

            write_shaded(hits.normal.reshape(*size, 3), view, path)
            continue
        arrays = {"depth": hits.t.reshape(size), "normal": hits.normal.reshape(*size, 3)}
        arrays |= {"canonical": hits.x_rest.reshape(*size, 3)}
        write_npz(path, arrays | {"axes": view.axes, "lower": lower, "upper": upper})
    covered = np.isfinite(hits.t).mean()
    report = {"pixels": args.pixels, "covered": float(covered), "seconds": seconds, "output": ", ".join(args.output)}
    show(report, as_json=args.json)
