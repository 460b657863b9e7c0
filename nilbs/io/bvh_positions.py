"""What the positions of a `.bvh` file mean: whether they replace OFFSETs or are added to them, which is left open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

POSITIONS = ("auto", "add", "replace")

_NEAR = 0.01  # of an OFFSET's size: a position that is so near to it, or to zero, counts as equal
_STILL = 1e-5  # of a root's OFFSET: positions of rounding alone
_OTHER_UNIT = 2.0  # positions that are more than so many times the OFFSETs, or less than one over this
_ALIKE = 3  # joints that show another unit


@dataclass(frozen=True)
class Channels:
    """The position channels of a file, joint by joint: column c is along `axis[c]` of joint `of[c]`.

    `offset` (b, 3) are the OFFSETs, `root` (b,) whether a joint is a root, `names` what notes call the joints.
    """

    of: np.ndarray
    axis: np.ndarray
    offset: np.ndarray
    root: np.ndarray
    names: Sequence[str]


@dataclass(frozen=True)
class Placed:
    """Positions (t, p) relative to the parent, the OFFSETs (b, 3), and what was decided."""

    positions: np.ndarray
    offset: np.ndarray
    notes: tuple[str, ...]


def placed(positions: np.ndarray, channels: Channels, how: str = "auto") -> Placed:
    """Where the positions (t, p) of a file put its joints.

    With "replace" they take the place of the OFFSETs, with "add" they are added to them. With "auto" the data decide,
    for all joints below the roots alike: a position that repeats its OFFSET shows that they replace, one of zero that
    they are added, and what is more frequent counts; where there is neither, whichever most joints are nearer to. Most
    positions at one multiple of the OFFSETs are in another unit. Where all OFFSETs below the roots are zero, the first
    frame's positions are taken for them. A root's position replaces its OFFSET, unless all of its positions are zero.
    """
    of, axis, root = channels.of, channels.axis, channels.root
    below = ~root[of]
    given = channels.offset[of, axis]
    if how not in POSITIONS:
        raise ValueError(f"positions must be one of {', '.join(map(repr, POSITIONS))}, got {how!r}")
    if how == "replace" or not len(positions):
        return Placed(positions, channels.offset, ())
    if how == "add":
        return Placed(positions + given, channels.offset, ())
    offset, notes = channels.offset, []
    if below.any() and positions[0, below].any() and not offset[~root].any():
        offset = offset.copy()
        offset[of[below], axis[below]] = positions[0, below]
        notes.append("all OFFSETs below the roots are zero: the first frame's positions are taken for them")
        return Placed(positions, offset, tuple(notes))
    # The columns of each joint whose OFFSET they could repeat.
    each = np.split(np.arange(len(of)), np.flatnonzero(np.diff(of)) + 1) if len(of) else []
    joints, roots = ([c for c in each if root[of[c[0]]] == is_root and given[c].any()] for is_root in (False, True))
    factor = _factor(positions, given, joints)
    if factor is not None:
        positions = positions / factor
        notes.append(f"positions are {factor:.4g} times the OFFSETs, in another unit: they were divided by that")
    added = np.zeros(len(of), dtype=bool)
    if joints:
        added[below], reason = _added(positions, given, joints)
        do = "are added to" if added[below].any() else "take the place of"
        notes.append(f"positions of joints below the roots {do} their OFFSETs ({len(joints)}): {reason}")
    for columns in roots:
        if _near(positions, np.zeros_like(given), given, columns, _STILL).all():
            added[columns] = True
            name = channels.names[of[columns[0]]]
            notes.append(f"the positions of the root {name[:60]!r} are zero: it stays at its OFFSET")
    return Placed(positions + np.where(added, given, 0.0), offset, tuple(notes))


def written(positions: np.ndarray, channels: Channels) -> tuple[np.ndarray, tuple[str, ...]]:
    """Positions (t, p) such that `placed` finds those given, and a note where there are none."""
    given = np.where(channels.root[channels.of], 0.0, channels.offset[channels.of, channels.axis])
    close = 1e-9 * np.abs(positions).max(initial=0)
    for form in (positions, positions - given):
        found = placed(form, channels)
        if np.abs(found.positions - positions).max(initial=0) <= close and found.offset is channels.offset:
            return form, ()
    return positions, ("its positions look like others: read it with positions='replace', --positions replace",)


def _near(x: np.ndarray, y: np.ndarray, given: np.ndarray, columns: np.ndarray, near: float = _NEAR) -> np.ndarray:
    """In which frames the columns of a joint lie near to others, by the size of its OFFSET."""
    return np.abs(x[:, columns] - y[columns]).max(axis=1) <= near * np.abs(given[columns]).max()


def _factor(positions: np.ndarray, given: np.ndarray, joints: list[np.ndarray]) -> float | None:
    """What most positions are of their OFFSETs, if that is neither none nor about all."""
    if len(joints) < _ALIKE:
        return None
    ratios = [positions[:, columns] @ given[columns] / (given[columns] @ given[columns]) for columns in joints]
    factor = float(np.median(ratios))
    if not 0 < factor < np.inf or 1 / _OTHER_UNIT <= factor <= _OTHER_UNIT:
        return None
    alike = [_near(positions / factor, given, given, columns).mean() for columns in joints]
    return factor if np.mean(alike) > 0.5 else None


def _added(positions: np.ndarray, given: np.ndarray, joints: list[np.ndarray]) -> tuple[bool, str]:
    """Whether positions of joints are added to their OFFSETs, and why."""
    repeated = np.mean([_near(positions, given, given, columns).mean() for columns in joints])
    zero = np.mean([_near(positions, np.zeros_like(given), given, columns).mean() for columns in joints])
    if repeated != zero:
        share, what = (zero, "are zero") if zero > repeated else (repeated, "repeat them")
        return zero > repeated, f"{max(1, round(100 * share))} % {what}"
    nearer = 0
    for columns in joints:
        o = given[columns]
        long = columns[np.abs(o) > 0.05 * np.abs(o).max()]
        nearer += bool(((2 * positions[:, long] * given[long] < given[long] ** 2).mean(axis=0) > 0.5).all())
    if 2 * nearer > len(joints):
        return True, "most are nearer to zero than to these"
    return False, "most are nearer to these than to zero"
