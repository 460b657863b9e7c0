"""`nilbs info`: what files hold, and what is wrong with them."""

import argparse

from nilbs.app.options import add_group, add_json, add_positions

_OWN_LINES = ("file", "notes", "problems", "verdict")

EXAMPLE = "nilbs info hero.glb"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="a mesh (.obj, .ply, .off, .stl, .3mf), rig (.tgf, .txt, .mhskel), all of a character (.glb, .gltf, .fbx, "
        ".npz), motion (.dmat, .json, .bvh, .npz of AMASS), weights (.dmat, .npz, .mhw), points (.npy) or "
        "model (.nilbs); several are also checked against each other",
    )
    add_group(parser)
    add_positions(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Read every file and report."""
    from nilbs.app.agreement import disagreements
    from nilbs.app.descriptions import describe, describe_model, describe_points
    from nilbs.app.output import rows, show
    from nilbs.app.poses import bvh_positions
    from nilbs.characters.bundle import read_files
    from nilbs.io import check_suffix, read_npy
    from nilbs.io.registry import READABLE

    suffixes = {path: check_suffix(path, *READABLE, ".npy", ".nilbs") for path in args.files}
    points = {path: read_npy(path) for path, suffix in suffixes.items() if suffix == ".npy"}
    paths = [path for path, suffix in suffixes.items() if suffix not in (".npy", ".nilbs")]
    files = read_files(paths, positions=bvh_positions(args, *paths))
    # A rig's file comes before the skeleton of a motion.
    skeletons = sorted(files, key=lambda path: files[path].is_motion)
    rig = next((files[path].skeleton for path in skeletons if files[path].skeleton is not None), None)
    reports = []
    for path, suffix in suffixes.items():
        if suffix == ".npy":
            reports.append(describe_points(path, points[path]))
        elif suffix == ".nilbs":
            from nilbs.models.model import load_model

            reports.append(describe_model(path, load_model(path)))
        else:
            reports += describe(path, files[path], rig, group=args.group)
    across = disagreements(files, points, args.group)
    blocks = []
    for report in reports:
        named = {name: value for name, value in report.items() if name not in _OWN_LINES}
        notes = [f"  note: {note}" for note in report.get("notes", [])]
        lines = [report["file"], rows(named, "  "), *notes, *_problems(report["problems"], "  ")]
        blocks.append("\n".join(lines))
    if len(reports) > 1:
        blocks.append("\n".join(["together", *_problems(across, "  ")]))
    blocks += [f"{report['file']}: {report['verdict']}" for report in reports if "verdict" in report]
    show({"files": reports, "problems": across}, as_json=args.json, table="\n\n".join(blocks))


def _problems(problems: list[str], indent: str) -> list[str]:
    return [f"{indent}problem: {problem}" for problem in problems] or [f"{indent}no problem found"]
