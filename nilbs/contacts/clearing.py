"""The least change of a motion's joints that keeps a body's parts, and others, apart."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from nilbs.characters.motion import Motion
from nilbs.contacts.blending import smallest_blend, smallest_move
from nilbs.contacts.demands import Finders, Reached
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.least_change import least_change, smoothing_inverse
from nilbs.contacts.obstacles import Demands
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.models.model import Model

# Frames around a contact that may change; rounds; frames over which a change is smoothed, and by how much it grows.
REACH, ROUNDS, SMOOTH, SMOOTHER = 8, 40, 1.5, 1.15
# Rounds from the motion itself, and those without a gain, where a blend with the rest pose is clear; rounds from that,
# and what of the cost, at least, ends them.
DIRECT, STALLED, NEAR, SETTLED = 20, 6, 12, 0.98
# A round must leave fewer frames that are not clear than this share; and frames around these that are looked at closer.
FEWER, AROUND = 0.9, 2
# A stretch is cheap enough at this share of the cost of the blend.
ENOUGH = 0.4
# From a blend, what is cheaper by this is better although it is not clear.
CHEAPER = 2.0
# By how much more of the allowed depth is demanded in frames that are not clear, in each round after some.
TIGHTER, PATIENT = 0.05, 6
# Solutions between two searches for contacts, and the longest turn of one, in radians; from a blend, one, and shorter.
INNER, STEP, SHORT = 2, 0.3, 0.1
# Demands whose distance exceeds what is demanded by more, in units of L, are left out.
IDLE = 0.05
# The largest second difference that is free, in radians a frame squared, and of the motion's own.
ROUGH, ROUGHER = np.radians(2.0), 2.0


@dataclass(frozen=True)
class Cleared:
    """A motion that was changed to keep parts apart.

    Attributes
    ----------
    motion : Motion
        The changed one.
    change : (t, b, 1 or 3) float array
        By how much each joint is turned, a rotation vector in the axes of the bone's parent.
    before, after : Reached
        What is in contact in each frame.
    remaining : (k,) int array
        Frames that are not clear.
    rounds : int
        Searches for contacts.
    """

    motion: Motion
    change: np.ndarray
    before: Reached
    after: Reached
    remaining: np.ndarray
    rounds: int

    def values(self, original: Motion, L: float) -> dict[str, Any]:
        """Numbers before and after, as JSON holds them; lengths also as shares of L, angles in degrees."""
        rough = [rough_of_clips(m) for m in (original, self.motion)]
        sides = []
        for reached, second in zip((self.before, self.after), rough, strict=True):
            deepest, nearest = float(reached.depth.max(initial=0.0)), float(reached.distance.min(initial=np.inf))
            sides.append(
                {
                    "frames_in_contact": int((reached.count > 0).sum()),
                    "deepest": deepest,
                    "deepest_of_L": deepest / L,
                    "smallest_distance_of_L": nearest / L if np.isfinite(nearest) else None,
                    "largest_second_difference": float(np.degrees(second)),
                }
            )
        frames = [
            {"frame": int(original.frames[k]), "depth_of_L": float(self.after.depth[k]) / L} for k in self.remaining
        ]
        return {
            "before": sides[0],
            "after": sides[1],
            "summed_squared_change": float((self.change**2).sum()),
            "frames_changed": int(self.change.any(axis=(1, 2)).sum()),
            "rounds": self.rounds,
            "not_clear": frames,
        }


def clear_motion(
    model: Model,
    motion: Motion,
    *,
    depth: float = 0.005,
    distance: float | None = None,
    against: Sequence[Model] = (),
    finder: SelfContactFinder | None = None,
    rounds: int = ROUNDS,
    smooth: float = SMOOTH,
    step: Callable[[int], object] = lambda left: None,
) -> Cleared:
    """The least change of a motion's joint angles that keeps parts apart.

    Parameters
    ----------
    model : Model
        Of a method whose compiled engine searches canonical points.
    motion : Motion
        Of the model's skeleton.
    depth : float
        The deepest contact that is allowed, as a share of L.
    distance : float, optional
        How far apart parts are kept, as a share of L; by default contacts up to `depth` are allowed.
    against : sequence of Model
        Others in the same world, which move as they were trained to, at the same time.
    finder : SelfContactFinder, optional
        Finds contacts of the model with itself.
    rounds : int
        Searches for contacts, at most.
    smooth : float
        Frames over which changes are smoothed.
    step : function
        Called after each round with the number of frames that are not clear.

    Returns
    -------
    cleared : Cleared
        Frames more than `REACH` away from any that is not clear are as they were.

    Raises
    ------
    ValueError
        If the model has no compiled search, or as for all queries.

    Notes
    -----
    What is minimised is the sum over frames and joints of squared rotation vectors relative to the motion, and that of
    their second differences. Points in contact demand a distance from the skin of the other part. In each round the
    distances are linearised at the present change, and the quadratic problem is solved in its dual; then contacts are
    searched again, and demands that were found stay. Roots neither move nor change their size.
    """
    L = model.character.L
    finders = Finders(model, motion, against, depth * L, None if distance is None else distance * L, finder)
    before = finders.reached(np.arange(len(motion)), motion.B)
    work = _Clearing(finders, motion, before, smooth, rounds, step)
    for run, _ in windows_near(motion, before.bad):
        work.clear(run)
    cleared = replace(motion, B=work.poses, curves=()) if before.bad.any() else motion
    return Cleared(cleared, work.change, before, work.now, np.flatnonzero(work.now.bad), work.rounds)


class _Clearing:
    """A motion that is changed, window by window."""

    def __init__(
        self,
        finders: Finders,
        motion: Motion,
        before: Reached,
        smooth: float,
        rounds: int,
        step: Callable[[int], object],
    ) -> None:
        skeleton, self.L = finders.model.character.skeleton, finders.model.character.L
        self.finders, self.motion, self.now, self.smooth, self.most, self.step = (
            finders,
            motion,
            before,
            smooth,
            rounds,
            step,
        )
        self.changes = JointChanges(skeleton, motion.B)
        self.change = np.zeros((*motion.B.shape[:2], self.changes.r))
        self.poses = motion.B.copy()
        self.rounds = 0
        self._blends: dict[int, _Tried | None] = {}

    def clear(self, run: np.ndarray) -> None:
        """Clear a window: from the motion itself; from a blend with the rest pose, too, if that is not much dearer."""
        found, blend = self._descend(run, self.change, near=False), self._blended(run)
        if blend is not None:
            found = self._repaired(run, found, blend)
            if not found.clear or found.cost(run) > ENOUGH * blend.cost(run):
                self.finders.forget(run)
                near = self._repaired(run, self._descend(run, blend.change, near=True), blend)
                found = min(found, near, blend, key=lambda tried: tried.rank(run))
        self.change = found.change
        self.now = self._look(run, found.change, exact=True)
        self.poses[run] = self.changes.turned(run, found.change[run])

    def _look(self, run: np.ndarray, change: np.ndarray, *, exact: bool = False) -> Reached:
        """What is in contact: by a coarse search, and if all is clear by that, by the exact one."""
        B = self.changes.turned(run, change[run])
        if not exact:
            now = self.finders.reached(run, B, self.now, coarse=True)
            if now.bad[run].any():
                return now
        return self.finders.reached(run, B, self.now)

    def _tried(self, run: np.ndarray, change: np.ndarray, now: Reached) -> "_Tried":
        return _Tried(change, now, not now.bad[run].any() and self._is_smooth(run, change))

    def _descend(self, run: np.ndarray, change: np.ndarray, *, near: bool) -> "_Tried":
        """Rounds of solutions from a change, and the best of what they went through.

        From the motion itself, the least change is solved for until that leaves no fewer frames that are not clear;
        these are then cleared by the least moves from there.
        """
        stiff, demands, extra, local, better = self.smooth, None, np.zeros(len(self.motion)), False, 0
        best = self._tried(run, change, self._look(run, change) if near else self.now)
        now = best.reached
        for k in range(min(self.most, NEAR) if near else self.most):
            if not near and (k >= DIRECT or k - better >= STALLED) and self._blended(run) is not None:
                break
            self.rounds += 1
            # Where a frame stays a little short of clear a little more is demanded.
            extra[run] += np.where(now.bad[run] & (k > PATIENT), TIGHTER * self.finders.depth / self.L, 0.0)
            around = np.convolve(now.bad[run], np.ones(2 * AROUND + 1), mode="full")[AROUND : AROUND + len(run)] > 0.5
            beside = run if near else run[around] if local else run[:0]
            demands, fresh = self.finders.demands(now, run, self.changes, change, demands, near=beside)
            longest = SHORT if near or local else STEP
            for _ in range(1 if near or local else INNER):
                change, stiff = self._solved(
                    run, demands, change, stiff, longest, extra, moving=fresh if local else None
                )
            now = self._look(run, change)
            self.step(int(now.bad.sum()))
            tried = self._tried(run, change, now)
            settled = tried.clear and tried.cost(run) > SETTLED * best.cost(run)
            if not near and not local and k > 0 and now.bad[run].sum() > FEWER * best.reached.bad[run].sum():
                local, change, now = True, best.change, best.reached
            # From a blend, what is much cheaper is better, too.
            if tried.rank(run) < best.rank(run) or (near and best.cost(run) > CHEAPER * tried.cost(run)):
                best, better = tried, k + 1
            if tried.clear and (settled or not near):
                break
        return best

    def _repaired(self, run: np.ndarray, tried: "_Tried", target: "_Tried") -> "_Tried":
        """What was tried, moved towards what is clear where it is not; as it was if that is too rough."""
        for smooth in self.smooth * SMOOTHER ** np.arange(0, 12, 3):
            if tried.clear:
                break
            turns = smallest_move(
                self.changes, run, tried.change[run], target.change[run], self._bad, smooth=smooth,
                ends=_held(self.motion, run),
            )  # fmt: skip
            if turns is not None:
                change = tried.change.copy()
                change[run] = turns
                moved = self._tried(run, change, self._look(run, change, exact=True))
                tried = moved if moved.clear else tried
        return tried

    def _solved(
        self,
        run: np.ndarray,
        demands: Demands,
        change: np.ndarray,
        stiff: float,
        longest_step: float,
        extra: np.ndarray,
        *,
        moving: np.ndarray | None,
    ) -> tuple[np.ndarray, float]:
        """The change after one solution of the linearised problem, smoother if it is too rough.

        With demands (k,) that are `moving`, the least move from the present change instead of the least change: only
        these are to be met, the others must not be missed by more than they are.
        """
        gaps = self.finders.obstacles.gaps(self.changes, demands, change)
        # Linear about the present change: slope . new >= least - distance + slope . present.
        slope = gaps.slope.reshape(len(gaps.distance), -1) / self.L
        present = (slope * change[demands.frame].reshape(len(slope), -1)).sum(axis=1)
        missing = (demands.least - gaps.distance) / self.L + extra[demands.frame]
        wanted = missing + present
        if moving is not None:
            missing = wanted = np.where(moving, missing, np.minimum(missing, 0.0))
        mine = np.flatnonzero(missing > -IDLE)
        found = change.copy()
        before, after = _held(self.motion, run)
        inverse = smoothing_inverse(len(run), stiff, from_rest=before, to_rest=after)
        new = least_change(demands.frame[mine] - run[0], slope[mine], wanted[mine], inverse, smooth=stiff)
        move = new.reshape(len(run), *change.shape[1:]) - (change[run] if moving is None else 0.0)
        longest = np.linalg.norm(move, axis=-1).max(initial=0.0)
        found[run] = change[run] + move * min(1.0, longest_step / max(longest, 1e-12))
        return found, stiff if self._is_smooth(run, found) else stiff * SMOOTHER

    def _is_smooth(self, run: np.ndarray, change: np.ndarray) -> bool:
        """Whether second differences are at most those that are free."""
        starts = np.array([start for _, start in self.motion.clips] or [0])
        begin = int(starts[np.searchsorted(starts, run[0], side="right") - 1])
        end = int(np.append(starts, len(self.motion))[np.searchsorted(starts, run[0], side="right")])
        frames = np.arange(begin, end)
        old, new = self.changes.rotations(frames), self.changes.rotations(frames, change[frames])
        return roughness(new) <= max(ROUGH, ROUGHER * roughness(old))

    def _bad(self, frames: np.ndarray, B: np.ndarray) -> np.ndarray:
        return self.finders.reached(frames, B, self.now).bad[frames]

    def _blended(self, run: np.ndarray) -> "_Tried | None":
        """The change of all frames with a window blended with the rest pose, so that it is clear."""
        first = int(run[0])
        if first not in self._blends:
            ends = _held(self.motion, run)
            turns = smallest_blend(self.changes, run, self._bad, smooth=self.smooth, ends=ends)
            self._blends[first] = None
            if turns is not None:
                change = self.change.copy()
                change[run] = turns
                self._blends[first] = self._tried(run, change, self._look(run, change, exact=True))
        return self._blends[first]


class _Tried(NamedTuple):
    """A change of all frames, what is then in contact, and whether a window is clear and smooth."""

    change: np.ndarray
    reached: Reached
    clear: bool

    def cost(self, run: np.ndarray) -> float:
        """The summed squared change of a window."""
        return float((self.change[run] ** 2).sum())

    def rank(self, run: np.ndarray) -> tuple[bool, int, float]:
        """What is clear comes first, then that with the fewest frames that are not, then the cheapest."""
        return not self.clear, int(self.reached.bad[run].sum()), self.cost(run)


def windows_near(motion: Motion, bad: np.ndarray) -> list[tuple[np.ndarray, tuple[bool, bool]]]:
    """Runs of frames that may change, near one that is not clear and in one clip; and which of their sides are held."""
    found: list[np.ndarray] = []
    starts = [start for _, start in motion.clips] or [0]
    for begin, end in zip(starts, [*starts[1:], len(motion)], strict=True):
        near = np.convolve(bad[begin:end], np.ones(2 * REACH + 1), mode="full")[REACH : REACH + end - begin] > 0.5
        frames = begin + np.flatnonzero(near)
        found += [run for run in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(run)]
    return [(run, _held(motion, run)) for run in found]


def _held(motion: Motion, run: np.ndarray) -> tuple[bool, bool]:
    """Whether frames of the same clip come before a run, and after it: they stay as they are."""
    starts = [start for _, start in motion.clips] or [0]
    return int(run[0]) not in starts, int(run[-1]) + 1 not in [*starts[1:], len(motion)]


def roughness(theta: np.ndarray) -> float:
    """The largest second difference of rotation vectors (t, b, 1 or 3) over frames, in radians.

    Vectors that differ by full turns are one rotation: each is taken nearest to the one before.

    Examples
    --------
    >>> round(roughness(np.radians([[[0.0, 0, 170]], [[0, 0, 180]], [[0, 0, -168]]])) * 180 / np.pi, 6)
    2.0
    """
    theta, turn = theta.copy(), 2 * np.pi
    for k in range(1, len(theta)):
        length = np.linalg.norm(theta[k], axis=-1, keepdims=True)
        axis = theta[k] / np.where(length > 0, length, 1.0)
        if theta.shape[-1] == 1:
            axis = np.ones_like(axis)
        steps = np.round(((theta[k - 1] - theta[k]) * axis).sum(axis=-1, keepdims=True) / turn)
        theta[k] += turn * steps * axis
    return float(np.linalg.norm(np.diff(theta, 2, axis=0), axis=-1).max(initial=0.0))


def rough_of_clips(motion: Motion) -> float:
    """`roughness` of the joints of a motion, the largest of its clips'."""
    assert motion.skeleton is not None
    starts = [start for _, start in motion.clips] or [0]
    theta = JointChanges(motion.skeleton, motion.B).rotations(np.arange(len(motion)))
    ends = [*starts[1:], len(motion)]
    return max(roughness(theta[begin:end]) for begin, end in zip(starts, ends, strict=True))
