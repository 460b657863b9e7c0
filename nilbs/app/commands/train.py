"""`nilbs train`: fit a field to a rigged mesh and its motion, and write it as one file."""

import argparse
from typing import TYPE_CHECKING

from nilbs.app.method_options import add_method, chosen_method
from nilbs.app.options import (
    add_character,
    add_device,
    add_json,
    add_motion,
    add_seed,
    add_solve,
    not_negative,
    positive,
    whole,
)
from nilbs.characters import AMPLITUDE, FRAMES

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.characters.motion import Motion

EXAMPLE = "nilbs train hero.obj hero.tgf hero-weights.npz -o hero.nilbs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add_character(parser)
    add_motion(parser, "that of the character's files, where they bring one, else smooth random motion")
    parser.add_argument("--random", action="store_true", help="smooth random motion, even where a file brings one")
    parser.add_argument(
        "--weights",
        metavar="FILE",
        help="a file of skinning weights, whatever its numbers look like; by default they are those of a file of "
        "weights alone, else those in the rig's file, else bounded biharmonic weights are solved for",
    )
    add_solve(parser)
    parser.add_argument(
        "--frames",
        type=whole(1),
        default=FRAMES,
        metavar="N",
        help=f"how many frames to train on, spread evenly over the motion (default {FRAMES})",
    )
    parser.add_argument(
        "--amplitude",
        type=not_negative,
        metavar="RAD",
        help=f"rms local rotation of every bone but the roots in random motion (default {AMPLITUDE})",
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--steps",
        type=whole(0),
        metavar="N",
        help="training steps; 0, of nilbs and paper: the grids, no network",
    )
    length.add_argument(
        "--minutes", type=positive, metavar="M", help="as many training steps as fit into this time on this machine"
    )
    parser.add_argument("--resume", action="store_true", help="go on from MODEL.checkpoint, if it exists")
    add_device(parser, default="auto")
    parser.add_argument("-o", "--output", metavar="MODEL", required=True, help="the model to write, .nilbs")
    add_seed(parser)
    add_json(parser)
    add_method(parser)


def run(args: argparse.Namespace) -> None:
    """Train, write and report."""
    from pathlib import Path
    from time import perf_counter

    from nilbs.app.output import show
    from nilbs.app.poses import bvh_positions, print_note, training_motion
    from nilbs.characters.bundle import character_of, load_bundle
    from nilbs.io import check_suffix, check_writable

    # Before the work: what would fail only after it.
    check_suffix(args.output, ".nilbs")
    checkpoint = f"{args.output}.checkpoint"
    for path in (args.output, checkpoint):
        check_writable(path)
    if Path(checkpoint).exists() and not args.resume:
        raise ValueError(
            f"{checkpoint} holds a training that was stopped: go on with --resume, or remove it to start anew"
        )
    if args.motion is not None and args.random:
        raise ValueError("--random and --motion each give a motion: leave one out")
    method = chosen_method(args)
    start = perf_counter()
    bundle = load_bundle(
        args.files,
        weights=args.weights,
        group=args.group,
        solve=args.solve,
        positions=bvh_positions(args, *args.files, args.motion or ""),
        report=print_note,
    )
    given = training_motion(args, bundle)
    # These take a while to import: files that do not fit are reported before.
    from nilbs.app.memory import peak_memory_mib
    from nilbs.models.fitting import fit, remove_checkpoint

    if args.device not in ("auto", "cpu"):
        from nilbs.models.torch_field import torch_device

        torch_device(args.device)
    character = character_of(bundle, progress=True, report=print_note)
    motion = _random_motion(args, character) if given is None else given.spread(args.frames)
    try:
        model = fit(
            character,
            motion,
            method,
            device=args.device,
            minutes=args.minutes,
            checkpoint=checkpoint,
            resume=args.resume,
            progress=True,
            report=print_note,
        )
    except KeyboardInterrupt as interrupt:
        if Path(checkpoint).exists():
            interrupt.add_note("the same command with --resume goes on from the last checkpoint")
        raise
    model.save(args.output)
    remove_checkpoint(checkpoint)
    values = {
        "model": args.output,
        "method": method.name,
        # Of the last steps: that of one step is noisy.
        "loss": model.history[-100:].mean() if len(model.history) else None,
        "seconds": perf_counter() - start,
        "peak_memory_mib": peak_memory_mib(),
        "frames": len(motion),
        "motion": motion.source,
        "steps": len(model.history),
        "seed": args.seed,
    }
    show(values, as_json=args.json)


def _random_motion(args: argparse.Namespace, character: "Character") -> "Motion":
    from nilbs.app.poses import print_note
    from nilbs.characters.motion import random_motion

    if (character.skeleton.P < 0).all():
        print_note("every bone is a root, and random motion turns all bones but these: give a motion with --motion")
    amplitude = AMPLITUDE if args.amplitude is None else args.amplitude
    return random_motion(character, frames=args.frames, amplitude=amplitude, seed=args.seed)
