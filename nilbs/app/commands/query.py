"""`nilbs query`: evaluate a model at points in a pose."""

import argparse

from nilbs.app.options import add_device, add_json, add_pose

EXAMPLE = "nilbs query hero.nilbs points.npy --frame 12 -o inside.npy"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument("points", metavar="POINTS.npy", help="posed points, an array (n, d)")
    add_pose(parser)
    parser.add_argument(
        "--closest",
        action="store_true",
        help="closest places on the posed skin instead: signed distance to it, facet, barycentric coordinates, place "
        "and outward normal of each point, arrays of these names in an .npz file",
    )
    parser.add_argument(
        "--distance",
        action="store_true",
        help="signed distance of the rest shape at the canonical points, in mesh units, negative inside; not occupancy",
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="the (n,) values to write, .npy; with --closest .npz"
    )
    add_device(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Evaluate, write and report."""
    from time import perf_counter

    from nilbs.app.output import show
    from nilbs.app.poses import chosen_pose
    from nilbs.io import FileFormatError, check_suffix, check_writable, read_npy, write_npy, write_npz
    from nilbs.models.model import load_model

    if args.closest and args.distance:
        raise ValueError("--closest and --distance each choose what is written: leave one out")
    check_suffix(args.output, ".npz" if args.closest else ".npy")
    check_writable(args.output, inputs=[args.points])
    x = read_npy(args.points)
    model = load_model(args.model, device=args.device)
    d = model.character.d
    if x.ndim != 2 or x.shape[1] != d:
        raise FileFormatError(args.points, f"points must be (n, {d}) for this model, the file holds {x.shape}")
    pose = chosen_pose(model, args)
    start = perf_counter()
    if args.closest:
        posed = model.posed(pose)
        places = posed.closest_places(x)
        inside = int((places["distance"] < 0).sum())
        seconds = perf_counter() - start
        write_npz(args.output, places)
    else:
        values = model.distance(x, pose) if args.distance else model.occupancy(x, pose)
        inside = int(((values < 0) if args.distance else (values > 0.5)).sum())
        seconds = perf_counter() - start
        write_npy(args.output, values)
    report = {
        "points": len(x),
        "quantity": "closest places" if args.closest else "distance" if args.distance else "occupancy",
        "inside": inside,
        "seconds": seconds,
        "output": args.output,
    }
    show(report, as_json=args.json)
