"""`nilbs extract`: the surface of a model in a pose."""

import argparse

from nilbs.app.options import add_device, add_json, add_pose, add_resolution

EXAMPLE = "nilbs extract hero.nilbs --time 0.5 -o surface.obj"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    add_pose(parser)
    add_resolution(parser)
    kinds = ".obj, .ply, .off, .stl or .3mf; in two dimensions .obj or .ply"
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help=f"the mesh to write, {kinds}")
    add_device(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Extract, write and report."""
    from time import perf_counter

    from nilbs.app.output import show
    from nilbs.app.poses import chosen_pose
    from nilbs.geometry.facets import is_watertight
    from nilbs.io import check_suffix, check_writable, write_mesh
    from nilbs.io.registry import MESHES, OUTLINES
    from nilbs.models.model import load_model

    check_suffix(args.output, *MESHES)
    check_writable(args.output)
    model = load_model(args.model, device=args.device)
    if model.character.d == 2:
        check_suffix(args.output, *OUTLINES)
    pose = chosen_pose(model, args)
    start = perf_counter()
    U, F = model.extract(pose, resolution=args.resolution)
    seconds = perf_counter() - start
    if not len(F):
        raise ValueError(
            f"{args.model}: nothing is inside in this pose on a grid of {args.resolution} cells: no surface"
        )
    write_mesh(args.output, U, F)
    report = {
        "vertices": len(U),
        "facets": len(F),
        "watertight": is_watertight(F),
        "seconds": seconds,
        "output": args.output,
    }
    show(report, as_json=args.json)
