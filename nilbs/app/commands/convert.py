"""`nilbs convert`: meshes, rigs, weights and motions from the files that there are to the files that are wanted."""

import argparse
from typing import TYPE_CHECKING

from nilbs.app.options import add_group, add_json, add_mapping, add_solve

if TYPE_CHECKING:
    from nilbs.characters.motion import Motion
    from nilbs.geometry.skeleton import Skeleton


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "inputs",
        nargs="+",
        metavar="IN",
        help="files of one character, in any order: a mesh, a rig, weights, motions, or several of these in one file",
    )
    parser.add_argument(
        "-o",
        "--output",
        nargs="+",
        metavar="OUT",
        required=True,
        help=".glb or .gltf (everything), .obj, .ply, .off, .stl or .3mf (the mesh), .txt (rig and weights, as "
        "RigNet), .tgf (the rig), .dmat (the motion or the weights), .npz (the weights), .bvh (rig and motion)",
    )
    add_group(parser)
    add_solve(parser)
    add_mapping(parser)
    parser.add_argument(
        "--write-map",
        metavar="FILE",
        help="write the guess which bone of the motion moves which of the rig, .json, to correct it for --map",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Read, write and report."""
    from nilbs.app.inputs import gather
    from nilbs.app.output import show
    from nilbs.characters.motion import load_motion
    from nilbs.characters.saving import check_outputs, write_files
    from nilbs.io import check_suffix, check_writable
    from nilbs.io.bone_map import write_bone_map

    if args.write_map is not None:
        check_suffix(args.write_map, ".json")
        check_writable(args.write_map, inputs=[*args.inputs, *([] if args.map is None else [args.map])])
    check_outputs(args.output, inputs=args.inputs)
    notes: list[str] = []
    mapped: list[str] = []
    guesses: list[tuple[dict[str, str], tuple[str, ...]]] = []

    def motion_for(path: str, skeleton: "Skeleton") -> "Motion":
        mapped.append(path)
        if args.write_map is not None:
            guesses.append((_guess(path, args.clip, skeleton), skeleton.names))
            if len(mapped) > 1:
                raise ValueError(f"--write-map writes the map of one motion, and there are {' and '.join(mapped)}")
        return load_motion(path, skeleton, bone_map=args.map, clip=args.clip, report=notes.append)

    try:
        inputs = gather(
            args.inputs,
            load_motion=motion_for,
            clip=args.clip,
            group=args.group,
            solve=args.solve,
            report=notes.append,
        )
    finally:
        if len(guesses) == 1:  # also where nothing came of it: it is there to be corrected
            write_bone_map(args.write_map, *guesses[0])
    for option, value, serves, what in (
        ("--group", args.group, inputs.mesh is not None, "a mesh"),
        ("--clip", args.clip, bool(inputs.clips), "a motion"),
        ("--map", args.map, bool(mapped), "a motion for another rig"),
        ("--write-map", args.write_map, bool(mapped), "a motion for another rig"),
    ):
        if value is not None and not serves:
            raise ValueError(f"{option} is for {what}, and no file brings one")
    written = write_files(args.output, mesh=inputs.mesh, skeleton=inputs.skeleton, W=inputs.W, clips=inputs.clips)
    sizes = inputs.sizes()
    notes += [f"{file.path}: {note}" for file in written for note in file.notes]
    notes += [f"no output holds the {what}" for what in sizes if not any(what in file.holds for file in written)]
    lines = [f"{path}: {', '.join(held) or 'nothing that was taken'}" for path, held in inputs.taken.items()]
    lines += [f"-> {file.path}: {'; '.join(f'{what} of {sizes[what]}' for what in file.holds)}" for file in written]
    values = {
        "inputs": inputs.taken,
        "outputs": {str(file.path): list(file.holds) for file in written},
        "sizes": sizes,
        "notes": notes,
    }
    show(values, as_json=args.json, table="\n".join([*lines, *(f"note: {note}" for note in notes)]))


def _guess(motion_path: str, clip: str | None, skeleton: "Skeleton") -> dict[str, str]:
    """Which bones would follow which; none where no name agrees."""
    from pathlib import Path

    from nilbs.characters.clips import chosen_clip
    from nilbs.characters.report import silent
    from nilbs.geometry.retargeting import guess_bone_map
    from nilbs.io.registry import OWN_MOTIONS

    if Path(motion_path).suffix.lower() in OWN_MOTIONS:
        raise ValueError(f"--write-map: {motion_path} moves the rig's own bones, there is nothing to map")
    source = chosen_clip(Path(motion_path), clip, silent).skeleton
    try:
        return guess_bone_map(source, skeleton.in_space())
    except ValueError:
        return {}
