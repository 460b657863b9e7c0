"""`nilbs info`: what files hold, and what is wrong with them."""

import argparse

from nilbs.app.options import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="a mesh (.obj, .ply), rig (.tgf), motion (.dmat, .json), weights (.dmat, .npz), points (.npy) or model "
        "(.nilbs); several are also checked against each other",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Read every file and report."""
    from nilbs.app.agreement import disagreements
    from nilbs.app.contents import describe, read
    from nilbs.app.output import rows, show

    contents = [read(path) for path in args.files]
    reports = [describe(content, contents) for content in contents]
    across = disagreements(contents)
    blocks = []
    for report in reports:
        named = {name: value for name, value in report.items() if name not in ("file", "problems")}
        blocks.append("\n".join([report["file"], rows(named, "  "), *_problems(report["problems"], "  ")]))
    if len(contents) > 1:
        blocks.append("\n".join(["together", *_problems(across, "  ")]))
    show({"files": reports, "problems": across}, as_json=args.json, table="\n\n".join(blocks))


def _problems(problems: list[str], indent: str) -> list[str]:
    return [f"{indent}problem: {problem}" for problem in problems] or [f"{indent}no problem found"]
