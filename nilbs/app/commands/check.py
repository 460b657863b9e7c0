"""`nilbs check`: where a moving character meets itself or others."""

import argparse

from nilbs.app.options import add_json, add_motion, not_negative, whole

FILES = ("contacts.json", "contacts.txt", "contacts.png", "contacts.glb")

EXAMPLE = "nilbs check hero.nilbs --out contacts"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
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
    parser.add_argument("--out", metavar="DIR", help=f"also write {', '.join(FILES)} here")
    add_json(parser)


def run(args: argparse.Namespace) -> None:
    """Check, write and report."""
    from pathlib import Path

    import numpy as np

    from nilbs.app.output import show
    from nilbs.app.poses import check_motion_options, motion_of_file
    from nilbs.contacts.self_contacts import SelfContactFinder
    from nilbs.contacts.timeline import pair_timeline, self_timeline, table
    from nilbs.geometry.progress import progress_bar
    from nilbs.io import check_writable
    from nilbs.models.model import load_model

    check_motion_options(args)
    model = load_model(args.model)
    others = {path: load_model(path) for path in args.against}
    for path, other in others.items():
        if other.character.d != model.character.d:
            found, wanted = other.character.d, model.character.d
            raise ValueError(f"{path}: this model has {found} dimensions, {args.model} has {wanted}")
    if args.out is not None:
        Path(args.out).mkdir(parents=True, exist_ok=True)
        for name in FILES:
            check_writable(Path(args.out) / name)
    motion = model.motion if args.motion is None else motion_of_file(args, model.character.skeleton)
    finder = SelfContactFinder(model, samples=args.points, apart=args.apart / 100, steps=args.steps)
    total = len(motion) * (1 + len(others))
    with progress_bar(total=total, desc="contacts", unit="frame") as bar:
        timelines = [self_timeline(finder, motion, step=bar.update)]
        for path, other in others.items():
            name = Path(path).stem
            timelines.append(pair_timeline(model, motion, name, other, samples=args.points, step=bar.update))
    L, names = model.character.L, model.character.skeleton.names
    pairs = [(names[i], names[j]) for i, j in np.argwhere(np.triu(finder.exempt, 1))]
    share = len(pairs) / max(len(names) * (len(names) - 1) / 2, 1)
    text = table(timelines, L, {"pairs of bones that may overlap": share})
    values = {"model": args.model, "motion": motion.source, "contacts": [t.values(L) for t in timelines]}
    values |= {"exempt": pairs, "exempt_share": share}
    if args.out is not None:
        from nilbs.app.scoring import write_results
        from nilbs.figures.contact_scene import write_contact_scene
        from nilbs.figures.timeline import timeline_figure

        as_json, as_text, picture, scene = (Path(args.out) / name for name in FILES)
        write_results(as_json, as_text, values, text)
        timeline_figure(timelines, L, picture, title=f"{model.character.name}: contacts")
        write_contact_scene(scene, finder, motion, timelines, list(others.values()), samples=args.points)
    show(values, as_json=args.json, table=text)
