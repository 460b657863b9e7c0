"""`nilbs weights`: solve for skinning weights, or take those of a mesh that fits, and report how good they are."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nilbs.app.options import add_character, add_json

if TYPE_CHECKING:
    import numpy as np

    from nilbs.io.bundle import Bundle

SUFFIXES = (".npz", ".dmat", ".glb", ".gltf")

EXAMPLE = "nilbs weights hero.obj hero.tgf -o hero-weights.npz"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add_character(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="the weights to write, .npz or .dmat, or the mesh with its rig and weights, .glb or .gltf",
    )
    parser.add_argument(
        "--method",
        choices=("joint", "igl"),
        help="how to solve: all bones at once, joint (the default), or libigl's reference bone by bone, igl",
    )
    transfer = parser.add_argument_group("weights of another mesh")
    transfer.add_argument(
        "--from",
        dest="source",
        nargs="+",
        metavar="FILE",
        help="do not solve: take the weights and the rig of this character, which the mesh fits (clothes, a remesh, "
        "another level of detail); its files, in any order",
    )
    transfer.add_argument("--from-group", metavar="NAME", help="use one group or object of the mesh of --from")
    transfer.add_argument(
        "--both-sides",
        action="store_true",
        help="let closest points match that face the other way: for clothes with a lining",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Solve or transfer, write and report."""
    from nilbs.app.output import rows, show
    from nilbs.app.poses import print_note
    from nilbs.characters.saving import write_bundle
    from nilbs.io import check_suffix, check_writable, write_weights

    _check_options(args)
    suffix = ""
    if args.output is not None:
        suffix = check_suffix(args.output, *SUFFIXES)
        check_writable(args.output, inputs=[*args.files, *(args.source or ())])
    notes: list[str] = []

    def noted(line: str) -> None:
        notes.append(line)
        print_note(line)

    bundle, W, values = (_solved if args.source is None else _transferred)(args, noted)
    if args.output is not None:
        if suffix in (".npz", ".dmat"):
            write_weights(args.output, W)
        else:
            for file in write_bundle(bundle, [args.output]):
                for note in file.notes:
                    noted(f"{file.path}: {note}")
        values["output"] = args.output
    show(values | {"notes": notes}, as_json=args.json, table=rows(values))


def _check_options(args: argparse.Namespace) -> None:
    """Refuse options of the other way to make weights."""
    if args.source is not None and args.method is not None:
        raise ValueError("--method is for solving, and --from takes the weights of another mesh: leave one out")
    for option, value in (("--from-group", args.from_group), ("--both-sides", args.both_sides)):
        if value and args.source is None:
            raise ValueError(f"{option} is for the weights of another mesh: name its files with --from")


def _solved(args: argparse.Namespace, noted: Callable[[str], None]) -> "tuple[Bundle, np.ndarray, dict[str, Any]]":
    """The character with bounded biharmonic weights, these weights, and what to report."""
    from dataclasses import replace
    from time import perf_counter

    import numpy as np

    from nilbs.characters.bundle import errors_of, load_bundle, rigged
    from nilbs.geometry.rig_weights import solve_weights
    from nilbs.io.bundle import Influences

    bundle = load_bundle(args.files, group=args.group, solve=True, report=noted)
    mesh, skeleton = rigged(bundle)
    start = perf_counter()
    with errors_of(*args.files):
        solved = solve_weights(mesh.V, mesh.E, skeleton, method=args.method or "joint", progress=True)
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
        "bones": len(skeleton.BE) - len(skeleton.points),
        **({"point_handles": len(skeleton.points)} if len(skeleton.points) else {}),
        "volume_vertices": len(solved.V_volume),
    }
    return replace(bundle, influences=Influences.of_matrix(solved.W)), solved.W, values


def _transferred(args: argparse.Namespace, noted: Callable[[str], None]) -> "tuple[Bundle, np.ndarray, dict[str, Any]]":
    """The mesh with rig, weights and motion of the character of --from, these weights, and what to report."""
    from time import perf_counter

    from nilbs.characters.bundle import errors_of, load_bundle, load_mesh, rigged
    from nilbs.characters.character import in_dimension
    from nilbs.geometry.plane import in_space
    from nilbs.geometry.weight_transfer import transfer_weights
    from nilbs.io.bundle import Bundle, Influences, Mesh

    mesh = load_mesh(args.files, group=args.group, report=noted)
    source = load_bundle(args.source, group=args.from_group, report=noted)
    other, skeleton = rigged(source)
    if source.influences is None:
        raise ValueError(f"{' and '.join(args.source)}: there are no weights: give their file too")
    V = mesh.V if other.V.shape[1] == 2 else in_space(mesh.V)
    start = perf_counter()
    with errors_of(*args.files, *args.source):
        skeleton = in_dimension(skeleton, V.shape[1])
        W = source.influences.dense(len(other.V), len(skeleton.BE), args.source[0])
        found = transfer_weights(V, mesh.E, other.V, other.E, W, both_sides=args.both_sides)
    seconds = perf_counter() - start
    for note in found.notes:
        noted(note)
    accepted, filled = int(found.accepted.sum()), int(found.filled.sum())
    values = {
        "vertices": len(V),
        "matched": accepted,
        "filled": filled,
        "closest": len(V) - accepted - filled,
        "bones": len(skeleton.BE),
        "seconds": seconds,
    }
    bundle = Bundle(Mesh(V, mesh.E), skeleton, Influences.of_matrix(found.W), source.clips)
    return bundle, found.W, values
