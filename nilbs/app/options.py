"""Options that several commands share, and the kinds of values they take."""

import argparse
from collections.abc import Callable


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else on standard output")


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add --seed."""
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="seed of all that is random (default 0)")


def add_pose(parser: argparse.ArgumentParser) -> None:
    """Add --motion and --frame, which name a pose of a model."""
    parser.add_argument(
        "--motion", metavar="FILE", help="a motion, .dmat or .json; the motion the model was trained on by default"
    )
    parser.add_argument(
        "--frame", type=whole(0), required=True, metavar="K", help="number of the frame in that motion, from 0"
    )


def whole(least: int) -> Callable[[str], int]:
    """Type of an option that takes a whole number of at least `least`.

    Examples
    --------
    >>> whole(1)("3")
    3
    """

    def number(word: str) -> int:
        try:
            value = int(word)
        except ValueError:
            value = least - 1
        if not least <= value < 2**31:
            raise argparse.ArgumentTypeError(f"{word!r} is not a whole number from {least} on")
        return value

    return number


def not_negative(word: str) -> float:
    """Type of an option that takes a finite number of at least 0.

    Examples
    --------
    >>> not_negative("0.4")
    0.4
    """
    try:
        value = float(word)
    except ValueError:
        value = -1.0
    if not 0 <= value < 1e9:
        raise argparse.ArgumentTypeError(f"{word!r} is not a number of at least 0")
    return value
