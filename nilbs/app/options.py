"""Options of several commands, and the types of their values."""

import argparse
from collections.abc import Callable

from nilbs.models.protocol import POINTS, RESOLUTION


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else on standard output")


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add --seed."""
    parser.add_argument(
        "--seed", type=whole(0), default=0, metavar="N", help="seed of the random number generator (default 0)"
    )


def add_character(parser: argparse.ArgumentParser) -> None:
    """Add FILES and --group."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="files of one character, in any order: a mesh (.obj, .ply, .off, .stl or .3mf; flat, z = 0, for two "
        "dimensions), a rig (.tgf, .txt, .mhskel, .bvh), weights (.dmat, .npz, .mhw); or one file that holds several "
        "of these (.glb, .gltf, .fbx, .npz of the SMPL family)",
    )
    add_group(parser)


def add_group(parser: argparse.ArgumentParser) -> None:
    """Add --group."""
    parser.add_argument("--group", metavar="NAME", help="use one group or object of the mesh; all by default")


def add_solve(parser: argparse.ArgumentParser) -> None:
    """Add --solve."""
    parser.add_argument("--solve", action="store_true", help="solve for weights even if the rig's file has some")


def add_motion(parser: argparse.ArgumentParser, otherwise: str) -> None:
    """Add --motion and the options of `add_mapping`; `otherwise` is the motion without --motion."""
    parser.add_argument(
        "--motion",
        metavar="FILE",
        help=f"a motion, .dmat, .json, .bvh, .npz of AMASS, .glb, .gltf or .fbx; {otherwise} by default",
    )
    add_mapping(parser)


def add_mapping(parser: argparse.ArgumentParser) -> None:
    """Add the options of how the motion of a file is read, and how it moves the rig."""
    parser.add_argument(
        "--map",
        metavar="FILE",
        help="bone map, .json: the bone of the motion that each bone of the rig follows",
    )
    parser.add_argument(
        "--clip",
        metavar="NAME",
        help="the motion to use, if the file holds several: its name, or a part that no other has; all by default",
    )
    parser.add_argument(
        "--rest-frame",
        type=int,
        metavar="K",
        help="the frame of the motion that is like the rig's rest pose, -1: its own rest pose; found by default",
    )
    for option, what in (("--up", "points up"), ("--forward", "points to where the body looks")):
        parser.add_argument(
            option, metavar="AXIS", help=f"the axis of the motion that {what}: x, y, z, -x, -y or -z; found by default"
        )
    parser.add_argument(
        "--show", metavar="FILE", help="draw the skeletons of the motion and of the rig side by side, .png"
    )
    parser.add_argument("--verbose", action="store_true", help="also show which bones follow which")
    add_positions(parser)


def add_positions(parser: argparse.ArgumentParser) -> None:
    """Add --positions: what the positions of a .bvh file mean."""
    parser.add_argument(
        "--positions",
        choices=("auto", "add", "replace"),
        help="of a .bvh file: add positions to the OFFSETs of its joints, or replace these; by default the data decide",
    )


def add_pose(parser: argparse.ArgumentParser) -> None:
    """Add --motion with --frame or --time: a pose of a model."""
    add_motion(parser, "the motion that the model was trained on")
    when = parser.add_mutually_exclusive_group(required=True)
    when.add_argument(
        "--frame",
        type=whole(0),
        metavar="K",
        help="number of the frame, from 0: of the training frames, or of --motion",
    )
    when.add_argument(
        "--time",
        type=not_negative,
        metavar="SECONDS",
        help="time in that motion, also between two frames; before the first and after the last the pose is theirs",
    )


def add_device(parser: argparse.ArgumentParser, *, default: str = "cpu") -> None:
    """Add --device."""
    parser.add_argument(
        "--device",
        default=default,
        metavar="NAME",
        help=f"cpu, cuda, ..., or auto: a GPU if there is one (default {default})",
    )


def add_points(parser: argparse.ArgumentParser) -> None:
    """Add --points."""
    parser.add_argument(
        "--points",
        type=whole(1),
        default=POINTS,
        metavar="N",
        help=f"points per frame of the scores (default {POINTS})",
    )


def add_resolution(parser: argparse.ArgumentParser) -> None:
    """Add --resolution."""
    parser.add_argument(
        "--resolution",
        type=whole(2),
        default=RESOLUTION,
        metavar="N",
        help=f"cells along the longest edge of the grid that surfaces are extracted on (default {RESOLUTION})",
    )


def whole(least: int, most: int = 2**31 - 1) -> Callable[[str], int]:
    """Type of an option that takes a whole number from `least` to `most`.

    Examples
    --------
    >>> whole(1)("3")
    3
    >>> whole(0)("99999999999")
    Traceback (most recent call last):
    argparse.ArgumentTypeError: '99999999999' is not a whole number from 0 to 2147483647
    """

    def number(word: str) -> int:
        try:
            value = int(word)
        except ValueError:
            value = least - 1
        if not least <= value <= most:
            limit = "on" if most == 2**31 - 1 and value < least else f"to {most}"
            raise argparse.ArgumentTypeError(f"{word!r} is not a whole number from {least} {limit}")
        return value

    return number


def not_negative(word: str) -> float:
    """Type of an option that takes a number from 0 to 1e9.

    Examples
    --------
    >>> not_negative("0.4")
    0.4
    >>> not_negative("1e300")
    Traceback (most recent call last):
    argparse.ArgumentTypeError: '1e300' is not a number from 0 to 1e9
    """
    try:
        value = float(word)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1e9:
        raise argparse.ArgumentTypeError(f"{word!r} is not a number from 0 to 1e9")
    return value


def positive(word: str) -> float:
    """Type of an option that takes a finite number above 0.

    Examples
    --------
    >>> positive("0.4")
    0.4
    """
    value = not_negative(word)
    if not value:
        raise argparse.ArgumentTypeError(f"{word!r} is not a number above 0")
    return value
