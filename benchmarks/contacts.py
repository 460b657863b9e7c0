"""Contacts beside the truth: two bodies beside libigl's signed distance, and a body with itself by winding numbers."""

import argparse
import sys
from collections.abc import Sequence
from time import perf_counter

import numpy as np

from nilbs.app.main import exit_status
from nilbs.characters.motion import Motion, load_motion
from nilbs.contacts.penetration import penetration
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.contacts.timeline import self_timeline
from nilbs.engine.winding import winding_number
from nilbs.geometry.distance import closest_points
from nilbs.geometry.sampling import facet_samples
from nilbs.models.model import Model, load_model

PAIRS, POINTS, VOLUME, WORST = 10, 20_000, 200_000, 5


def truth(U: np.ndarray, F: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth and way out (n, 3) by libigl: its signed distance with the fast winding number, building included."""
    import igl

    s, _, c, _ = igl.signed_distance(x, U, F, igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER)
    # libigl returns d (1 - 2 w): where it is negative, w is above one half.
    inside = s < 0
    way = np.where(inside[:, None], c - x, 0.0)
    return np.linalg.norm(way, axis=1), way


def overlapping(model: Model, poses: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A pose of each body, moved so that 5 to 30 % of places on each skin are inside the other; and the shares."""
    c = model.character
    B = [poses[k].copy() for k in rng.integers(len(poses), size=2)]
    U = [model.skinning.posed(b) for b in B]
    wide = np.ptp(U[0], axis=0)
    direction = np.array([1.0, 0.0, 0.3]) * rng.choice([-1, 1])
    low, high = 0.0, 1.0
    for _ in range(12):
        share = (low + high) / 2
        shift = direction * share * wide
        some = [u[:: max(1, len(u) // 2000)] for u in (U[0], U[1] + shift)]
        inside = [
            (winding_number(U[1] + shift, c.F, some[0]) > 0.5).mean(),
            (winding_number(U[0], c.F, some[1]) > 0.5).mean(),
        ]
        if min(inside) > 0.06 and max(inside) < 0.28:
            break
        low, high = (share, high) if max(inside) > 0.2 else (low, share)
    B[1][:, :3, 3] += shift
    return B[0], B[1], np.array(inside)


def two_bodies(model: Model, motion: Motion, *, pairs: int = PAIRS) -> list[str]:
    """Lines of the comparison with libigl."""
    c, rng = model.character, np.random.default_rng(0)
    F = np.ascontiguousarray(c.F)
    seconds = np.zeros((pairs, 2))
    ious, depths, angles, shares = [], [], [], []
    penetration(model, c.V[:10], motion[0])  # compiled, and the tree of the rest pose made
    for k in range(pairs):
        *B, _ = overlapping(model, motion.B, rng)
        for own, other in ((0, 1), (1, 0)):
            x, _ = facet_samples(model.skinning.posed(B[own]), F, POINTS, rng=rng)
            for which in (0, 1) if (k + own) % 2 else (1, 0):
                start = perf_counter()
                if which == 0:
                    found = penetration(model, x, B[other])
                else:
                    depth, way = truth(model.skinning.posed(B[other]), F, x)
                seconds[k, which] += perf_counter() - start
            inside, true = found.facet >= 0, depth > 0
            shares.append(true.mean())
            ious.append((inside & true).sum() / max((inside | true).sum(), 1))
            both = inside & true
            depths.append(np.abs(found.depth - depth)[both] / c.L)
            deep = both & (depth > 1e-3 * c.L)
            cosine = (found.way_out * way).sum(axis=1)[deep] / (found.depth * depth)[deep]
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    ours, theirs = seconds.sum(axis=0)
    return [
        f"two bodies, {pairs} pairs, {POINTS} points each way, "
        f"{100 * min(shares):.1f} to {100 * max(shares):.1f} % inside",
        f"  seconds: nilbs {ours:.3f}, libigl {theirs:.3f}, ratio {theirs / ours:.1f} "
        f"(of pairs {np.min(seconds[:, 1] / seconds[:, 0]):.1f} to {np.max(seconds[:, 1] / seconds[:, 0]):.1f})",
        f"  IoU of inside sets: mean {np.mean(ious):.4f}, worst {np.min(ious):.4f} (wanted 0.98)",
        f"  depth: p95 difference {100 * np.percentile(np.concatenate(depths), 95):.4f} % of L (wanted 0.05)",
        f"  direction: p95 {np.percentile(np.concatenate(angles), 95):.2f} degrees, deeper than 0.1 % of L (wanted 5)",
    ]


def true_depth(model: Model, finder: SelfContactFinder, pose: np.ndarray) -> float:
    """The largest distance to the skin of points uniform inside the posed surface that are covered twice."""
    c, rng = model.character, np.random.default_rng(0)
    U = model.skinning.posed(pose)
    low, high = U.min(axis=0), U.max(axis=0)
    twice, count = [], 0
    while count < VOLUME:
        x = rng.uniform(low, high, (4 * VOLUME, 3))
        w = winding_number(U, c.F, x)
        inside = np.flatnonzero(w > 0.5)[: VOLUME - count]
        count += len(inside)
        twice.append(x[inside[w[inside] > 1.5]])
    x = np.concatenate(twice)
    if not len(x):
        return 0.0
    distance, _, _ = closest_points(U, c.F, x)
    return _not_exempt(model, finder, pose, x, distance)


def _not_exempt(
    model: Model, finder: SelfContactFinder, pose: np.ndarray, x: np.ndarray, distance: np.ndarray
) -> float:
    """The largest distance of points that two parts cover of which the pair is not exempt.

    A part covers a point where the winding number of its own skin, which is open, is above a quarter.
    """
    c, U = model.character, model.skinning.posed(pose)
    for i in np.argsort(-distance)[:400].tolist():
        part = finder.part_of_facet
        corner = U[c.F] - x[i]
        length = np.linalg.norm(corner, axis=-1)
        a, b, d = corner.swapaxes(0, 1)
        la, lb, ld = length.T
        angle = 2 * np.arctan2(
            np.einsum("ij,ij->i", a, np.cross(b, d)),
            la * lb * ld + (a * b).sum(1) * ld + (b * d).sum(1) * la + (d * a).sum(1) * lb,
        )
        share = np.bincount(part, angle / (4 * np.pi), minlength=len(finder.exempt))
        around = np.flatnonzero(share > 0.25)
        if (~finder.exempt[np.ix_(around, around)]).any():
            return float(distance[i])
    return 0.0


def itself(name: str, model: Model, motion: Motion) -> list[str]:
    """Lines of the comparison of the worst frames with the truth."""
    finder, L = SelfContactFinder(model), model.character.L
    names = model.character.skeleton.names
    worst = self_timeline(finder, motion).worst[:WORST]
    true = np.array([true_depth(model, finder, pose) for pose in motion.B]) / L
    fifth = np.sort(true)[::-1][min(WORST, len(true)) - 1]
    pairs = [f"{names[i]}+{names[j]}" for i, j in np.argwhere(np.triu(finder.exempt, 1))]
    share = len(pairs) / max(len(names) * (len(names) - 1) / 2, 1)
    index = {int(f): k for k, f in enumerate(motion.frames)}
    rows = [
        f"  frame {f.frame}: found {100 * f.depth / L:.3f}, true {100 * true[index[f.frame]]:.3f} % of L"
        + (f", {true[index[f.frame]] / fifth:.3f} of the fifth" if fifth > 0 else "")
        for f in worst
    ]
    return [
        f"{name}: {len(motion)} frames, fifth-worst true depth {100 * fifth:.3f} % of L; "
        f"{100 * share:.1f} % of pairs exempt (at most 30)",
        *rows,
        f"  exempt: {', '.join(pairs)}",
    ]


def run(args: argparse.Namespace) -> None:
    """Measure and print."""
    model = load_model(args.model)
    motion = model.motion if args.motion is None else load_motion(args.motion, model.character)
    if "bodies" in args.only:
        print("\n".join(two_bodies(model, motion)), flush=True)
    if "itself" in args.only:
        starts = [start for _, start in motion.clips] or [0]
        names = [name for name, _ in motion.clips] or [motion.source]
        for name, begin, end in zip(names, starts, [*starts[1:], len(motion)], strict=True):
            part = Motion(motion.B[begin:end], np.arange(end - begin), name, motion.times[begin:end], motion.skeleton)
            print("\n".join(itself(name, model, part)), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; the status is that of `nilbs.app.main.main`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contacts", description=__doc__)
    parser.add_argument("model", metavar="MODEL", help="a trained model, .nilbs")
    parser.add_argument("--motion", metavar="FILE", help="a motion; by default the one that the model was trained on")
    parser.add_argument(
        "--only", nargs="+", choices=("bodies", "itself"), default=["bodies", "itself"], help="what is measured"
    )
    args = parser.parse_args(argv)
    return exit_status(lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())
