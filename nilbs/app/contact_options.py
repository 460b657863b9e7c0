"""What the commands that search for contacts share: their options, and the models that these name."""

import argparse
from typing import TYPE_CHECKING

from nilbs.app.options import add_motion, not_negative, whole

if TYPE_CHECKING:
    from nilbs.models.model import Model


def add_contact_options(parser: argparse.ArgumentParser) -> None:
    """The model, its motion, others in its world, and which contacts with itself count."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    add_motion(parser, "the motion that the model was trained on")
    parser.add_argument(
        "--against",
        nargs="+",
        default=(),
        metavar="OTHER",
        help="other models in the same world, .nilbs: each moves as it was trained to, at the same time",
    )
    parser.add_argument(
        "--apart",
        type=not_negative,
        default=0.5,
        metavar="PERCENT",
        help="parts nearer than this at rest may overlap, in per cent of the longest edge (default 0.5)",
    )
    parser.add_argument(
        "--steps",
        type=whole(0),
        default=2,
        metavar="N",
        help="so may parts whose bones are at most so many bones apart along the skeleton (default 2)",
    )
    parser.add_argument(
        "--points",
        type=whole(1),
        default=50_000,
        metavar="N",
        help="points in the body's volume, and on skins, that are followed (default 50000)",
    )


def load_models(args: argparse.Namespace) -> tuple["Model", dict[str, "Model"]]:
    """The model, and the others by their paths, all of one dimension."""
    from nilbs.models.model import load_model

    model = load_model(args.model)
    others = {path: load_model(path) for path in args.against}
    for path, other in others.items():
        found, expected = other.character.d, model.character.d
        if found != expected:
            raise ValueError(f"{path}: this model has {found} dimensions, {args.model} has {expected}")
    return model, others
