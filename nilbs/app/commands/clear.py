"""`nilbs clear`: the least change of a motion that keeps a character's parts, and others, apart."""

import argparse
from typing import TYPE_CHECKING, Any

from nilbs.app.contact_options import add_contact_options, load_models
from nilbs.app.options import add_json, not_negative, whole

if TYPE_CHECKING:
    from collections.abc import Mapping

NOT_CLEAR = 3  # the exit code where a frame is not clear, or the change is too rough
SIDES = ("before", "after")
SUFFIXES = (".bvh", ".glb", ".gltf")

EXAMPLE = "nilbs clear hero.nilbs -o cleared.glb"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add_contact_options(parser)
    parser.add_argument(
        "--depth",
        type=not_negative,
        default=0.5,
        metavar="PERCENT",
        help="the deepest contact that is left, in per cent of the longest edge (default 0.5)",
    )
    parser.add_argument(
        "--distance",
        type=not_negative,
        metavar="PERCENT",
        help="keep parts so far apart instead, in per cent of the longest edge; parts nearer at rest are exempt",
    )
    parser.add_argument(
        "--rounds", type=whole(1), default=40, metavar="N", help="searches for contacts in a stretch (default 40)"
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="the changed motion: .bvh, or .glb or .gltf with the mesh"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Clear, write and report; the exit code."""
    from nilbs.app.output import show
    from nilbs.app.poses import check_motion_options, motion_of_file, print_note
    from nilbs.characters.saving import check_outputs, save_character
    from nilbs.contacts.clearing import clear_motion
    from nilbs.contacts.self_contacts import SelfContactFinder
    from nilbs.geometry.progress import progress_bar
    from nilbs.io import check_suffix

    check_motion_options(args)
    check_suffix(args.output, *SUFFIXES)
    inputs = [args.model, *args.against, *([] if args.motion is None else [args.motion])]
    check_outputs([args.output], inputs=inputs)
    model, others = load_models(args)
    if args.distance is None and not args.depth:
        raise ValueError("--depth 0 leaves no contact at all: give --distance 0 for parts that do not touch")
    motion = model.motion if args.motion is None else motion_of_file(args, model.character.skeleton)
    apart = max(args.apart, args.distance or 0.0) / 100
    finder = SelfContactFinder(model, samples=args.points, apart=apart, steps=args.steps)
    with progress_bar(total=len(motion), desc="clearing", unit="frame") as bar:
        cleared = clear_motion(
            model,
            motion,
            depth=args.depth / 100,
            distance=None if args.distance is None else args.distance / 100,
            against=tuple(others.values()),
            finder=finder,
            rounds=args.rounds,
            step=lambda left: bar.update(len(motion) - left - bar.n),
        )
    (written,) = save_character(model.character, args.output, motion=cleared.motion)
    for note in written.notes:
        print_note(f"{args.output}: {note}")
    values = {"model": args.model, "motion": motion.source, "output": args.output}
    values |= cleared.values(motion, model.character.L)
    show(values, as_json=args.json, table=_table(values))
    return 0 if cleared.smooth and not len(cleared.remaining) else NOT_CLEAR


def _table(values: "Mapping[str, Any]") -> str:
    """Numbers before and after, for people."""
    rows = [("frames in contact", "frames_in_contact", "d", 1), ("deepest, % of L", "deepest_of_L", ".3f", 100)]
    if any(values[side]["smallest_distance_of_L"] is not None for side in SIDES):
        rows.append(("smallest distance, % of L", "smallest_distance_of_L", ".3f", 100))
    rows.append(("largest second difference, degrees", "largest_second_difference", ".2f", 1))
    lines = [f"{'':<34}  {'before':>9}  {'after':>9}"]
    for name, key, form, unit in rows:
        both = ("more" if values[side][key] is None else format(values[side][key] * unit, form) for side in SIDES)
        lines.append(f"{name:<34}  " + "  ".join(f"{text:>9}" for text in both))
    lines.append(f"summed squared change of the joints: {values['summed_squared_change']:.4g} rad^2")
    lines.append(f"frames changed: {values['frames_changed']}; rounds: {values['rounds']}")
    left = values["not_clear"]
    if left:
        deepest = max(left, key=lambda row: row["depth_of_L"])
        numbers = ", ".join(str(row["frame"]) for row in left[:20]) + (" and more" if len(left) > 20 else "")
        depth = f"{100 * deepest['depth_of_L']:.3f} % of L in frame {deepest['frame']}"
        lines.append(f"not clear: {len(left)} frames ({numbers}), the deepest {depth}")
    else:
        lines.append("clear in every frame")
    if not values["smooth"]:
        lines.append("not smooth: the joints turn more suddenly than twice the motion's own; give more --rounds")
    lines.append(f"written: {values['output']}")
    return "\n".join(lines)
