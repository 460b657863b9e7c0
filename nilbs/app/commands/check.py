"""`nilbs check`: where a moving character meets itself or others."""

import argparse

from nilbs.app.contact_options import add_contact_options, load_models
from nilbs.app.options import add_json

FILES = ("contacts.json", "contacts.txt", "contacts.png", "contacts.glb")

EXAMPLE = "nilbs check hero.nilbs --out contacts"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add_contact_options(parser)
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

    check_motion_options(args)
    model, others = load_models(args)
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
