"""The motion that `--motion FILE`, with --map, --clip and --positions, names, and its pose at a frame or a time."""

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

    from nilbs.characters.clips import Retargeting
    from nilbs.characters.motion import Motion
    from nilbs.characters.report import Report
    from nilbs.geometry.skeleton import Skeleton
    from nilbs.io.bundle import Bundle
    from nilbs.models.model import Model


def print_note(line: str) -> None:
    """Print a note on standard error."""
    print(f"nilbs: {line}", file=sys.stderr)


def bvh_positions(args: argparse.Namespace, *paths: str) -> str:
    """How the positions of .bvh files are read; refused if it is asked for and none of the files is one."""
    if args.positions is not None and not any(path.lower().endswith(".bvh") for path in paths):
        raise ValueError("--positions is for the positions of a .bvh file, and there is none")
    return args.positions or "auto"


def notes(args: argparse.Namespace) -> "Report":
    """Prints notes on standard error; details only with --verbose."""
    from nilbs.characters.report import Detail

    hinted = False

    def note(line: str) -> None:
        nonlocal hinted
        if args.verbose or not isinstance(line, Detail):
            print_note(line)
        elif not hinted:
            hinted = True
            print_note("which bones follow which is shown by --verbose")

    return note


def retargeting(args: argparse.Namespace) -> "Retargeting":
    """How the options put a motion on the character."""
    from nilbs.characters.clips import Retargeting
    from nilbs.io import check_suffix, check_writable

    if args.show is None:
        return Retargeting(args.map, args.rest_frame, args.up, args.forward)
    check_suffix(args.show, ".png")
    check_writable(args.show)

    def show(source: "Skeleton", target: "Skeleton", bone_map: "Mapping[str, str | None]") -> None:
        from nilbs.figures.bone_map import bone_map_figure

        bone_map_figure(source, target, bone_map, args.show, title="Bones of one colour follow each other")

    return Retargeting(args.map, args.rest_frame, args.up, args.forward, show)


def retargeting_options(args: argparse.Namespace) -> dict[str, object]:
    """The options that were given of putting a motion on another rig."""
    options = {"--map": args.map, "--rest-frame": args.rest_frame, "--up": args.up, "--forward": args.forward}
    options |= {"--show": args.show}
    return {name: value for name, value in options.items() if value is not None}


def _motion_options(args: argparse.Namespace) -> dict[str, object]:
    """The options that were given of a motion's file."""
    options = {"--clip": args.clip, "--positions": args.positions, **retargeting_options(args)}
    return {name: value for name, value in options.items() if value is not None}


def motion_of_file(args: argparse.Namespace, skeleton: "Skeleton") -> "Motion":
    """The motion of a skeleton in the file of `--motion`."""
    from nilbs.characters.motion import load_motion

    positions = bvh_positions(args, args.motion, *getattr(args, "files", ()))
    how = vars(retargeting(args))
    return load_motion(args.motion, skeleton, clip=args.clip, positions=positions, report=notes(args), **how)


def training_motion(args: argparse.Namespace, bundle: "Bundle") -> "Motion | None":
    """The motion in `--motion`, else that of the character's files; None for random motion."""
    from nilbs.characters.bundle import rigged
    from nilbs.characters.motion import motion_of_clips

    _, skeleton = rigged(bundle)
    if args.motion is None and (args.random or not bundle.clips):
        for option in [name for name in _motion_options(args) if name != "--positions"]:  # a rig may be a .bvh, too
            why = "the motion is random" if args.random else "no file brings one"
            raise ValueError(f"{option} is for the motion of a file, and {why}")
        return None
    if args.amplitude is not None:
        file = bundle.clips[0].file if args.motion is None else args.motion
        raise ValueError(f"--amplitude is of random motion, and {file} brings one: leave it out, or give --random")
    if args.motion is not None:
        return motion_of_file(args, skeleton)
    return motion_of_clips(bundle.clips, skeleton, clip=args.clip, how=retargeting(args), report=notes(args))


def check_motion_options(args: argparse.Namespace) -> None:
    """Refuse options of a motion's file if there is no --motion."""
    if args.motion is None:
        for option in _motion_options(args):
            raise ValueError(f"{option} is for the motion of a file: give one with --motion")


def chosen_pose(model: "Model", args: argparse.Namespace) -> "np.ndarray":
    """The pose (b, d+1, d+1) of a model at `--frame` or `--time`; an error names the motion without such a frame."""
    check_motion_options(args)
    motion = model.motion if args.motion is None else motion_of_file(args, model.character.skeleton)
    name = "the motion of the model" if args.motion is None else args.motion
    if args.time is not None:
        first, last = motion.times[[0, -1]]
        if args.time > last + 1e-6:  # in single precision a file's times are a little less than they should be
            print_note(f"{name} lasts from {first:g} to {last:g} s: the pose is that of its end")
        return motion.at(seconds=args.time)
    if not args.frame < len(motion):
        raise ValueError(f"{name}: there is no frame {args.frame}; it has {len(motion)} frames, counted from 0")
    return motion[args.frame]
