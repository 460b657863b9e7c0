"""`nilbs animate`: a moving model as a film, or as a numbered sequence of meshes."""

import argparse

from nilbs.app.options import add_json, add_motion, add_resolution, positive, whole

FILMS, MESHES = (".gif", ".mp4"), (".obj", ".ply", ".stl")

EXAMPLE = "nilbs animate hero.nilbs --fps 12 -o hero.gif"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    add_motion(parser, "the motion that the model was trained on")
    parser.add_argument("--fps", type=positive, default=24.0, metavar="N", help="frames a second (default 24)")
    parser.add_argument(
        "--field", action="store_true", help="the surface of the field, extracted in each frame; not the skinned mesh"
    )
    add_resolution(parser)
    parser.add_argument(
        "--pixels",
        type=whole(16, 4096),
        default=480,
        metavar="N",
        help="edge of a film's square pictures (default 480)",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        required=True,
        help="a film, .gif or .mp4 (with the package imageio-ffmpeg), or the name of meshes, .obj, .ply or .stl, which "
        "are numbered: walk.obj becomes walk_0000.obj, walk_0001.obj and so on",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Pose, write and report."""
    from pathlib import Path

    import numpy as np

    from nilbs.app.output import show
    from nilbs.app.poses import check_motion_options, motion_of_file
    from nilbs.geometry.progress import progress_bar
    from nilbs.io import check_suffix, check_writable, write_mesh
    from nilbs.models.model import load_model

    check_motion_options(args)
    check_suffix(args.output, *FILMS, *MESHES)
    path = Path(args.output)
    is_film = path.suffix.lower() in FILMS
    if path.suffix.lower() == ".mp4":
        import imageio_ffmpeg  # noqa: F401  (before the work, if it is missing)
    model = load_model(args.model)
    c = model.character
    if c.d == 2 and path.suffix.lower() == ".stl":
        raise ValueError(f"{path}: this model is flat, and .stl holds triangles only: choose .obj or .ply")
    motion = model.motion if args.motion is None else motion_of_file(args, c.skeleton)
    first, last = motion.times[[0, -1]]
    times = first + np.arange(int(np.floor((last - first) * args.fps + 1e-9)) + 1) / args.fps
    digits = max(4, len(str(len(times) - 1)))
    names = [path] if is_film else [path.with_stem(f"{path.stem}_{k:0{digits}d}") for k in range(len(times))]
    for name in names:
        check_writable(name)

    def surfaces():  # type: ignore[no-untyped-def]
        for seconds in progress_bar(times, desc="frames", unit="frame"):
            pose = motion.at(seconds=float(seconds))
            yield tuple(model.extract(pose, args.resolution)) if args.field else (model.skinning.posed(pose), c.F)

    if is_film:
        from nilbs.figures.animation import pictures, write_film
        from nilbs.figures.views import View

        some = times[:: max(1, len(times) // 50)]
        bounds = [model.skinning.posed(motion.at(seconds=float(seconds))) for seconds in some]
        frames = pictures(surfaces(), bounds, View.front(c.V).turned(), pixels=args.pixels)
        write_film(frames, path, fps=args.fps)
    else:
        for name, (U, F) in zip(names, surfaces(), strict=True):
            write_mesh(name, U, F)
    report = {
        "frames": len(times),
        "seconds": float(times[-1] - times[0]),
        "frames_a_second": args.fps,
        "surface": "field" if args.field else "skinned mesh",
        "output": str(path) if is_film else f"{names[0]} ... {names[-1].name}",
    }
    show(report, as_json=args.json)
