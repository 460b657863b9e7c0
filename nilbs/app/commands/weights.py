"""`nilbs weights`: solve for skinning weights, and report how good they are."""

import argparse

from nilbs.app.options import add_character, add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add_character(parser)
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

    from nilbs.app.output import rows, show
    from nilbs.app.poses import print_note
    from nilbs.characters.bundle import errors_of, load_bundle, rigged
    from nilbs.geometry.rig_weights import solve_weights
    from nilbs.io import check_suffix, check_writable, write_weights

    if args.output is not None:
        check_suffix(args.output, ".npz", ".dmat")
        check_writable(args.output, inputs=args.files)
    notes: list[str] = []

    def noted(line: str) -> None:
        notes.append(line)
        print_note(line)

    mesh, skeleton = rigged(load_bundle(args.files, group=args.group, solve=True, report=noted))
    start = perf_counter()
    with errors_of(*args.files):
        solved = solve_weights(mesh.V, mesh.E, skeleton, method=args.method, progress=True)
    seconds = perf_counter() - start
    for note in solved.notes:
        noted(note)
    values = {
        "min": solved.W.min(),
        "max": solved.W.max(),
        "row_sum_error": np.abs(solved.W.sum(axis=1) - 1).max(),
        "energy": solved.energy,
        "seconds": seconds,
        "method": solved.method,
        "vertices": len(mesh.V),
        "bones": len(skeleton.BE),
        "volume_vertices": len(solved.V_volume),
    }
    if args.output is not None:
        write_weights(args.output, solved.W)
        values["output"] = args.output
    show(values | {"notes": notes}, as_json=args.json, table=rows(values))
