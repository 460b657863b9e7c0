"""The least change of a motion's joints that keeps a body's parts, and others, apart."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nilbs.characters.motion import Motion
from nilbs.contacts.blending import smallest_blend
from nilbs.contacts.demands import Finders, Reached
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.least_change import least_change, smoothing_inverse
from nilbs.contacts.obstacles import Demands
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.models.model import Model

# Frames around a contact that may change; rounds; frames over which a change is smoothed, and by how much it grows.
REACH, ROUNDS, SMOOTH, SMOOTHER = 8, 40, 1.5, 1.15
# Rounds from the motion itself, before a blend with the rest pose is tried; and what of the cost ends the rounds there.
DIRECT, SETTLED = 14, 0.98
# A stretch that is clear after so many rounds is not tried from a blend.
EASY = 6
# Of the frames of a stretch that were not clear, how many may be left then without it starting again.
FEW = 0.1
# By how much more of the allowed depth is demanded in each round after some.
TIGHTER, PATIENT = 0.05, 3
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
    step: Callable[[], object] = lambda: None,
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
        Called after each round.

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
        step: Callable[[], object],
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

    def clear(self, run: np.ndarray) -> None:
        """Clear a window: from the motion itself, and unless that was easy also from a blend with the rest pose."""
        begun = self.rounds
        direct = self._descend(run, self.change, near=False)
        if direct is not None and self.rounds - begun <= EASY:
            return
        found = [(self.change, direct)]
        untouched = self.change.copy()
        untouched[run] = 0
        self._set(run, untouched, self.now)
        blended = self._blend(run)
        self.finders.forget(run)
        if blended is not None:
            from_blend = self._descend(run, blended, near=True)
            found.append((self.change, from_blend))
        looks = [now or self._look(run, change, exact=True) for change, now in found]
        # The cheapest that is clear, else that with the shallowest contacts.
        ranks = [
            (bool(now.bad[run].any()), now.depth[run].max() if now.bad[run].any() else (change[run] ** 2).sum())
            for (change, _), now in zip(found, looks, strict=True)
        ]
        best = min(range(len(found)), key=lambda k: ranks[k])
        self._set(run, found[best][0], looks[best])

    def _set(self, run: np.ndarray, change: np.ndarray, reached: Reached) -> None:
        self.change, self.now = change, reached
        self.poses[run] = self.changes.turned(run, change[run])

    def _look(self, run: np.ndarray, change: np.ndarray, *, exact: bool = False) -> Reached:
        """What is in contact: by a coarse search, and if all is clear by that, by the exact one."""
        B = self.changes.turned(run, change[run])
        if not exact:
            now = self.finders.reached(run, B, self.now, coarse=True)
            if now.bad[run].any():
                return now
        return self.finders.reached(run, B, self.now)

    def _descend(self, run: np.ndarray, change: np.ndarray, *, near: bool) -> Reached | None:
        """Rounds of solutions from a change; the cheapest that is clear is kept, if there is one."""
        stiff, demands, best, cheapest = self.smooth, None, None, np.inf
        now, cost = self._look(run, change) if near else self.now, float((change[run] ** 2).sum())
        first = int(now.bad[run].sum())
        if first == 0 and self._is_smooth(run, change):
            best, cheapest = (change, now), cost
        for k in range(self.most):
            if not near and k >= DIRECT and now.bad[run].sum() > FEW * first:
                break
            self.rounds += 1
            # What stays a little short of clear is demanded a little more.
            extra = TIGHTER * max(k - PATIENT, 0) * self.finders.depth / self.L
            demands = self.finders.demands(now, run, self.changes, change, demands, near=near)
            for _ in range(1 if near else INNER):
                change, stiff = self._solved(run, demands, change, stiff, SHORT if near else STEP, extra)
            now = self._look(run, change)
            self.step()
            cost = float((change[run] ** 2).sum())
            if not now.bad[run].any() and self._is_smooth(run, change):
                settled = cost > SETTLED * cheapest
                if cost < cheapest:
                    best, cheapest = (change, now), cost
                if settled or not near:
                    break
        self._set(run, *(best or (change, now)))
        return None if best is None else best[1]

    def _solved(
        self, run: np.ndarray, demands: Demands, change: np.ndarray, stiff: float, longest_step: float, extra: float
    ) -> tuple[np.ndarray, float]:
        """The change after one solution of the linearised problem, smoother if it is too rough."""
        gaps = self.finders.obstacles.gaps(self.changes, demands, change)
        # Linear about the present change: slope . new >= least - distance + slope . present.
        slope = gaps.slope.reshape(len(gaps.distance), -1) / self.L
        present = (slope * change[demands.frame].reshape(len(slope), -1)).sum(axis=1)
        missing = (demands.least - gaps.distance) / self.L + extra
        mine = np.flatnonzero(missing > -IDLE)
        found = change.copy()
        before, after = _held(self.motion, run)
        inverse = smoothing_inverse(len(run), stiff, from_rest=before, to_rest=after)
        new = least_change(demands.frame[mine] - run[0], slope[mine], (missing + present)[mine], inverse, smooth=stiff)
        move = new.reshape(len(run), *change.shape[1:]) - change[run]
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

    def _blend(self, run: np.ndarray) -> np.ndarray | None:
        """The change of all frames with a window blended with the rest pose, so that it is clear."""

        def bad(frames: np.ndarray, B: np.ndarray) -> np.ndarray:
            return self.finders.reached(frames, B, self.now).bad[frames]

        turns = smallest_blend(self.changes, run, bad, smooth=self.smooth, ends=_held(self.motion, run))
        if turns is None:
            return None
        change = self.change.copy()
        change[run] = turns
        return change


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
