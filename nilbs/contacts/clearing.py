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

REACH = 8  # frames around a contact that may change
ROUNDS = 40  # searches for contacts, at most
SMOOTH = 1.5  # frames over which a change is smoothed
SMOOTHER = 1.15  # factor of that after a solution that is too rough
DIRECT = 20  # rounds from the motion itself, if a blend with the rest pose is clear
STALLED = 6  # rounds without a gain that end these
FEWER = 0.9  # a round that leaves more than this share of the frames that are not clear is without a gain
NEAR = 12  # rounds from the blend
SETTLED = 0.98  # a clear round from the blend that costs more than this share of the best one ends them
ENOUGH = 0.4  # a change that costs no more than this share of the blend is not searched for from there too
CHEAPER = 2.0  # from the blend, what costs so many times less is better although it is not clear
AROUND = 2  # frames around one that is not clear in which places that are only near are kept apart
PATIENT = 6  # rounds after which more is demanded in frames that are not clear:
TIGHTER = 0.05  # this share of the allowed depth in each
INNER = 2  # solutions between two searches for contacts
STEP = 0.3  # the longest turn of one, in radians
SHORT = 0.1  # that of small moves
IDLE = 0.05  # of L: demands that are met by more are left out
ROUGH = np.radians(2.0)  # second differences of joints up to this, in radians per frame squared, are free
ROUGHER = 2.0  # so are those up to so many times the largest of the motion


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
    roughness : (float, float)
        The largest second differences of the joints before and after, in radians per frame squared.
    rounds : int
        Searches for contacts.
    """

    motion: Motion
    change: np.ndarray
    before: Reached
    after: Reached
    remaining: np.ndarray
    roughness: tuple[float, float]
    rounds: int

    @property
    def smooth(self) -> bool:
        """Whether the joints turn not much more suddenly than before."""
        return self.roughness[1] <= max(ROUGH, ROUGHER * self.roughness[0])

    def values(self, original: Motion, L: float) -> dict[str, Any]:
        """Numbers before and after, as JSON holds them; lengths also as shares of L, angles in degrees."""
        sides = []
        for reached, second in zip((self.before, self.after), self.roughness, strict=True):
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
            "smooth": self.smooth,
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
        If the model has no compiled search, the motion is not of its skeleton, another model has another dimension,
        or a number is out of range.

    Notes
    -----
    What is minimised is the sum over frames and joints of squared rotation vectors relative to the motion, and that of
    their second differences. Points in contact demand a distance from the skin of the other part. In each round the
    distances are linearised at the present change, and the quadratic problem is solved in its dual; then contacts are
    searched again, and demands that were found stay. Roots neither move nor change their size.
    """
    c = model.character
    if motion.skeleton is None or motion.B.shape[1] != len(c.skeleton.BE):
        raise ValueError(f"the motion is not of the skeleton of {c.name}, which has {len(c.skeleton.BE)} bones")
    if wrong := [o.character.name for o in against if o.character.d != c.d]:
        raise ValueError(f"{wrong[0]} has another dimension than {c.name}, which has {c.d}")
    for name, number in {"depth": depth, "distance": distance or 0.0, "rounds": rounds, "smooth": smooth}.items():
        if not 0 <= number < np.inf:
            raise ValueError(f"{name} must be a number of at least 0, got {number}")
    L = c.L
    finders = Finders(model, motion, against, depth * L, None if distance is None else distance * L, finder)
    before = finders.reached(np.arange(len(motion)), motion.B)
    work = _Clearing(finders, motion, before, smooth, rounds, step)
    for run, held in windows_near(motion, before.bad):
        work.clear(run, held)
    cleared = replace(motion, B=work.poses, curves=()) if before.bad.any() else motion
    rough = rough_of_clips(motion), rough_of_clips(cleared)
    return Cleared(cleared, work.change, before, work.now, np.flatnonzero(work.now.bad), rough, work.rounds)


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
        self.finders, self.motion, self.now = finders, motion, before
        self.smooth, self.most, self.step = smooth, rounds, step
        self.held = False, False  # whether frames before and after the window stay as they are
        self.changes = JointChanges(skeleton, motion.B)
        self.change = np.zeros((*motion.B.shape[:2], self.changes.r))
        self.poses = motion.B.copy()
        self.rounds = 0
        self._blends: dict[int, _Tried | None] = {}

    def clear(self, run: np.ndarray, held: tuple[bool, bool]) -> None:
        """Clear a window: from the motion itself; from a blend with the rest pose, too, if that is not much dearer."""
        self.held = held
        found, blend = self._descend(run, self.change, near=False), self._blended(run)
        if blend is not None:
            found = self._repaired(run, found, blend)
            if not found.clear or found.cost(run) > ENOUGH * blend.cost(run):
                self.finders.clear_sides(run)
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
                ends=self.held,
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
        demanded = missing + present
        if moving is not None:
            missing = demanded = np.where(moving, missing, np.minimum(missing, 0.0))
        mine = np.flatnonzero(missing > -IDLE)
        found = change.copy()
        inverse = smoothing_inverse(len(run), stiff, held_before=self.held[0], held_after=self.held[1])
        new = least_change(demands.frame[mine] - run[0], slope[mine], demanded[mine], inverse, smooth=stiff)
        move = new.reshape(len(run), *change.shape[1:]) - (change[run] if moving is None else 0.0)
        longest = np.linalg.norm(move, axis=-1).max(initial=0.0)
        found[run] = change[run] + move * min(1.0, longest_step / max(longest, 1e-12))
        return found, stiff if self._is_smooth(run, found) else stiff * SMOOTHER

    def _is_smooth(self, run: np.ndarray, change: np.ndarray) -> bool:
        """Whether second differences are at most those that are free."""
        frames = next(np.arange(begin, end) for begin, end in stretches(self.motion) if begin <= run[0] < end)
        old, new = self.changes.rotations(frames), self.changes.rotations(frames, change[frames])
        return roughness(new) <= max(ROUGH, ROUGHER * roughness(old))

    def _bad(self, frames: np.ndarray, B: np.ndarray) -> np.ndarray:
        return self.finders.reached(frames, B, self.now).bad[frames]

    def _blended(self, run: np.ndarray) -> "_Tried | None":
        """The change of all frames with a window blended with the rest pose, so that it is clear."""
        first = int(run[0])
        if first not in self._blends:
            turns = smallest_blend(self.changes, run, self._bad, smooth=self.smooth, ends=self.held)
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
    found: list[tuple[np.ndarray, tuple[bool, bool]]] = []
    for begin, end in stretches(motion):
        near = np.convolve(bad[begin:end], np.ones(2 * REACH + 1), mode="full")[REACH : REACH + end - begin] > 0.5
        frames = begin + np.flatnonzero(near)
        runs = [run for run in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(run)]
        found += [(run, (int(run[0]) > begin, int(run[-1]) + 1 < end)) for run in runs]
    return found


def stretches(motion: Motion) -> list[tuple[int, int]]:
    """The first frame of each clip of a motion, and the one after its last."""
    starts = [start for _, start in motion.clips] or [0]
    return list(zip(starts, [*starts[1:], len(motion)], strict=True))


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
    assert motion.skeleton is not None  # `clear_motion` checks it
    theta = JointChanges(motion.skeleton, motion.B).rotations(np.arange(len(motion)))
    return max(roughness(theta[begin:end]) for begin, end in stretches(motion))
