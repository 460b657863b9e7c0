"""`nilbs convert`: meshes, rigs, weights and motions converted from files to other files."""

import argparse
from typing import TYPE_CHECKING

from nilbs.app.options import add_group, add_json, add_mapping, add_solve

if TYPE_CHECKING:
    from nilbs.geometry.skeleton import Skeleton
    from nilbs.io.bundle import Bundle

EXAMPLE = "nilbs convert hero.glb -o hero.obj hero.bvh hero.npz"


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
    from dataclasses import replace

    from nilbs.app.output import show
    from nilbs.app.poses import bvh_positions, retargeting, retargeting_options
    from nilbs.characters.bundle import character_of, load_bundle
    from nilbs.characters.clips import clips_named, on_skeleton
    from nilbs.characters.report import Detail
    from nilbs.characters.saving import check_outputs, write_bundle
    from nilbs.io import check_suffix, check_writable
    from nilbs.io.bone_map import write_bone_map
    from nilbs.io.bundle import Influences

    if args.write_map is not None:
        check_suffix(args.write_map, ".json")
        check_writable(args.write_map, inputs=[*args.inputs, *([] if args.map is None else [args.map])])
    check_outputs(args.output, inputs=args.inputs)
    notes: list[str] = []
    positions = bvh_positions(args, *args.inputs)
    bundle = load_bundle(args.inputs, group=args.group, solve=args.solve, positions=positions, report=notes.append)
    rigs = [path for path, parts in bundle.taken.items() if "rig" in parts]
    clips = clips_named(bundle.clips, args.clip) if args.clip is not None and bundle.clips else bundle.clips
    foreign = [clip for clip in clips if clip.file not in rigs and clip.skeleton is not bundle.skeleton]
    for option, value, serves, what in (
        ("--group", args.group, bundle.mesh, "a mesh"),
        ("--clip", args.clip, clips, "a motion"),
        *((option, value, foreign, "a motion for another rig") for option, value in retargeting_options(args).items()),
        ("--write-map", args.write_map, foreign, "a motion for another rig"),
    ):
        if value is not None and not serves:
            raise ValueError(f"{option} is for {what}, and no file brings one")
    if foreign and bundle.skeleton is not None:
        if args.write_map is not None:
            files = dict.fromkeys(clip.file for clip in foreign)
            if len(files) > 1:
                raise ValueError(f"--write-map writes the map of one motion, and there are {' and '.join(files)}")
            # Written before the motion is mapped, so that a map that fails can be corrected.
            write_bone_map(
                args.write_map, _guess(foreign[0].skeleton, bundle.skeleton.in_space()), bundle.skeleton.names
            )
        own = [clip for clip in clips if clip.skeleton is bundle.skeleton]
        clips = (*own, *on_skeleton(foreign, bundle.skeleton, how=retargeting(args), report=notes.append))
    if args.solve:
        W = character_of(bundle, progress=True, report=notes.append).W
        bundle = replace(bundle, influences=Influences.of_matrix(W))
    bundle = replace(bundle, clips=clips)
    written = write_bundle(bundle, args.output)
    sizes = _sizes(bundle)
    notes += [f"{file.path}: {note}" for file in written for note in file.notes]
    notes += [f"no output holds the {what}" for what in sizes if not any(what in file.holds for file in written)]
    lines = [f"{path}: {', '.join(held) or 'nothing that was taken'}" for path, held in bundle.taken.items()]
    lines += [f"-> {file.path}: {'; '.join(f'{what} of {sizes[what]}' for what in file.holds)}" for file in written]
    values = {
        "inputs": bundle.taken,
        "outputs": {str(file.path): list(file.holds) for file in written},
        "sizes": sizes,
        "notes": notes,
    }
    show(
        values,
        as_json=args.json,
        table="\n".join([*lines, *(f"note: {note}" for note in notes if args.verbose or not isinstance(note, Detail))]),
    )


def _sizes(bundle: "Bundle") -> dict[str, str]:
    """How much there is of everything that there is, in words."""
    sizes = {}
    if bundle.mesh is not None:
        sizes["mesh"] = f"{len(bundle.mesh.V)} vertices, {len(bundle.mesh.E)} faces"
    if bundle.skeleton is not None:
        sizes["rig"] = f"{len(bundle.skeleton.BE)} bones"
    if bundle.influences is not None and bundle.influences.shape is not None:
        sizes["weights"] = "{} vertices, {} bones".format(*bundle.influences.shape)
    if bundle.clips:
        sizes["motion"] = "; ".join(f"{clip.name}: {len(clip.B)} frames" for clip in bundle.clips)
    return sizes


def _guess(source: "Skeleton", rig: "Skeleton") -> dict[str, str]:
    """Which bones would follow which; none where no name agrees."""
    from nilbs.geometry.retargeting import guess_bone_map

    try:
        return guess_bone_map(source, rig)
    except ValueError:
        return {}
