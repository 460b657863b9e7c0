"""The characters that `nilbs view` shows."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nilbs.viewer.state import Body, Scene


def scene_of(args: argparse.Namespace) -> "Scene":
    """The characters, motions and points in the files that the options name."""
    from pathlib import Path

    from nilbs.app.poses import motion_of_file
    from nilbs.io import FileFormatError, read_npy
    from nilbs.models.model import load_model
    from nilbs.viewer.state import Body, Scene

    models = [path for path in args.files if path.lower().endswith(".nilbs")]
    others = [path for path in args.files if path not in models]
    for name, given in (("--group", args.group is not None), ("--solve", args.solve)):
        if given and not others:
            raise ValueError(f"{name} is for the files of a character, and there are only models")
    bodies: list[Body] = []
    for path in models:
        model = load_model(path)
        first = not bodies
        motion = motion_of_file(args, model.character.skeleton) if first and args.motion is not None else model.motion
        bodies.append(Body(Path(path).stem, model, motion))
    if others:
        bodies.append(_character(args, others, motion_is_taken=bool(bodies)))
    x = None if args.points is None else read_npy(args.points)
    scene = Scene(bodies, points=x)
    if x is not None and (x.ndim != 2 or x.shape[1] != scene.d):
        raise FileFormatError(args.points, f"points must be (n, {scene.d}) here, the file holds {x.shape}")
    return scene


def _character(args: argparse.Namespace, paths: list[str], *, motion_is_taken: bool) -> "Body":
    """The character in files, with the motion of `--motion`, else of the files, else a random one."""
    from nilbs.app.poses import bvh_positions, motion_of_file, notes
    from nilbs.characters.bundle import character_of, load_bundle
    from nilbs.characters.motion import motion_of_clips, random_motion
    from nilbs.viewer.state import Body

    report = notes(args)
    positions = bvh_positions(args, *paths, *([args.motion] if args.motion else []))
    bundle = load_bundle(paths, group=args.group, solve=args.solve, positions=positions, report=report)
    character = character_of(bundle, progress=True, report=report)
    if args.motion is not None and not motion_is_taken:
        motion = motion_of_file(args, character.skeleton)
    elif bundle.clips:
        motion = motion_of_clips(bundle.clips, character.skeleton, report=report)
    else:
        report("no file brings a motion: it is random")
        motion = random_motion(character)
    return Body.of_character(character, motion)
