"""`nilbs weights`: solve for skinning weights, and say how good they are."""

import argparse

from nilbs.app.options import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("mesh", metavar="MESH", help="the rest mesh, .obj or .ply; flat (z = 0) for two dimensions")
    parser.add_argument("rig", metavar="RIG", help="its joints and bones, .tgf")
    parser.add_argument("-o", "--output", metavar="FILE", help="the weights to write, .npz or .dmat")
    parser.add_argument(
        "--method",
        choices=("joint", "igl"),
        default="joint",
        help="all bones at once (the default), or libigl's reference bone by bone",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Solve, write and report."""
    from time import perf_counter

    import numpy as np

    from nilbs.character import check_joints_near, rig_in_mesh_dimension, solve_weights
    from nilbs.io import check_suffix, check_writable, read_mesh, read_tgf, write_weights

    if args.output is not None:
        check_suffix(args.output, ".npz", ".dmat")
        check_writable(args.output)
    V, E = read_mesh(args.mesh)
    C, BE = read_tgf(args.rig)
    start = perf_counter()
    try:
        check_joints_near(V, rig_in_mesh_dimension(V, C))
        solved = solve_weights(V, E, C, BE, method=args.method, progress=True)
    except ValueError as error:
        raise ValueError(f"{args.mesh} with {args.rig}: {error}") from error
    seconds = perf_counter() - start
    values = {
        "min": solved.W.min(),
        "max": solved.W.max(),
        "row_sum_error": np.abs(solved.W.sum(axis=1) - 1).max(),
        "energy": solved.energy,
        "seconds": seconds,
        "method": solved.method,
        "vertices": len(V),
        "bones": len(BE),
        "volume_vertices": len(solved.V),
    }
    if args.output is not None:
        write_weights(args.output, solved.W[: len(V)])
        values["output"] = args.output
    from nilbs.app.output import show

    show(values, as_json=args.json)
