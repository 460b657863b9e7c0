"""Clear clips by `nilbs clear`, beside the smallest uniform blend of each frame with the rest pose that is as clear."""

import argparse
import sys
from collections.abc import Sequence
from time import process_time

import numpy as np

from nilbs.app.main import exit_status
from nilbs.app.options import positive
from nilbs.characters.motion import Motion, load_motion
from nilbs.contacts.blending import smallest_blend
from nilbs.contacts.clearing import REACH, SMOOTH, clear_motion, rough_of_clips, windows_near
from nilbs.contacts.demands import CLEAR
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.models.model import Model, load_model


def blend_cost(model: Model, motion: Motion, bad: np.ndarray, finder: SelfContactFinder, depth: float) -> float:
    """The summed squared rotation vectors of the smallest smooth blend that is clear; inf if none is."""
    changes, cost = JointChanges(model.character.skeleton, motion.B), 0.0

    def is_bad(frames: np.ndarray, B: np.ndarray) -> np.ndarray:
        return np.array([finder(pose).depth.max(initial=0.0) > CLEAR * depth for pose in B], dtype=bool)

    for run, ends in windows_near(motion, bad):
        turns = smallest_blend(changes, run, is_bad, smooth=SMOOTH, ends=ends)
        cost += np.inf if turns is None else float((turns**2).sum())
    return cost


def row_of(name: str, model: Model, motion: Motion, depth: float) -> str:
    """One line of the table."""
    finder, L, start = SelfContactFinder(model), model.character.L, process_time()
    found = clear_motion(model, motion, depth=depth, finder=finder)
    seconds = process_time() - start
    deepest = max(float(finder(pose).depth.max(initial=0.0)) for pose in found.motion.B)
    contact = np.flatnonzero(found.before.count > 0)
    away = np.ones(len(motion), dtype=bool)
    for k in contact:
        away[max(k - REACH, 0) : k + REACH + 1] = False
    far = float(np.abs(found.motion.B - motion.B)[away].max(initial=0.0))
    blend = blend_cost(model, motion, found.before.bad, finder, depth * L)
    cost = float((found.change**2).sum())
    rough = np.degrees([rough_of_clips(motion), rough_of_clips(found.motion)])
    return (
        f"| {name} | {len(motion)} | {len(contact)} | {100 * found.before.depth.max() / L:.3f} "
        f"| {100 * deepest / L:.3f} "
        f"| {cost:.4g} | {blend:.4g} | {far:.1g} | {rough[0]:.1f} | {rough[1]:.1f} | {len(found.remaining)} "
        f"| {seconds:.0f} |"
    )


def run(args: argparse.Namespace) -> None:
    """Clear each motion and print the table."""
    model = load_model(args.model)
    motion = model.motion if args.motion is None else load_motion(args.motion, model.character, clip=args.clip)
    columns = ["clip", "frames", "in contact", "deepest, % of L", "after", "change, rad^2", "blend", "far frames"]
    print(f"| {' | '.join([*columns, 'rough, degrees', 'after', 'not clear', 's'])} |")
    print("|---" * 12 + "|")
    starts = [start for _, start in motion.clips] or [0]
    names = [name for name, _ in motion.clips] or [motion.source]
    for name, begin, end in zip(names, starts, [*starts[1:], len(motion)], strict=True):
        part = Motion(motion.B[begin:end], np.arange(end - begin), name, motion.times[begin:end], motion.skeleton)
        print(row_of(name, model, part, args.depth / 100), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; the status is that of `nilbs.app.main.main`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.clear_clip", description=__doc__)
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument("--motion", metavar="FILE", help="a motion; by default the one that the model was trained on")
    parser.add_argument("--clip", metavar="NAME", help="the motion to use, if the file holds several")
    parser.add_argument("--depth", type=positive, default=0.5, metavar="PERCENT", help="of L, allowed (default 0.5)")
    args = parser.parse_args(argv)
    return exit_status(lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())
