"""Curves: local translations, rotations and scales over time, and the transforms of bones that they move."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol, Self

import numpy as np

from nilbs.geometry.kinematics import bone_order, composed, local_transforms
from nilbs.geometry.plane import transforms_in_plane
from nilbs.geometry.quaternions import compose, quaternions, slerp_quaternions, unit_quaternions, without_jumps
from nilbs.geometry.validation import arrays, check_indices

PARTS = {"translation": 3, "rotation": 4, "scale": 3}
STEP, LINEAR, SPLINE = "step", "linear", "cubicspline"
LARGEST = 1e60  # of a number in a transform, so that a product of a few stays finite
_BLOCK = 2**18  # transforms of nodes that are held at a time
_ROUNDING = 1e-12  # of the largest number: what differs less from rest does not move


class PosesOverTime(Protocol):
    """The transforms of bones at any time."""

    @property
    def key_times(self) -> np.ndarray:
        """The times (k,) at which something has a key, increasing."""

    def at(self, times: np.ndarray) -> np.ndarray:
        """Transforms (t, b, d+1, d+1), rest to posed, at times (t,)."""

    def shifted(self, start: float, to: float) -> Self:
        """The same, with what was at the time `start` at the time `to`."""


class Curve(NamedTuple):
    """One part of one node over time.

    `times` (k,) seconds, increasing; `values` (k, c), or for a cubic spline (k, 3, c) with the slopes before and after
    each value.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: str


@dataclass(frozen=True)
class Channels:
    """Curves of one part and one interpolation, of m nodes.

    Attributes
    ----------
    part, interpolation : str
        One of `PARTS`; "step", "linear" or "cubicspline". Rotations are quaternions (x, y, z, w) of any length.
    nodes, ends : (m,) int array
        Which node each curve moves, and where its keys end.
    times : (k,) float array
        Seconds, of one curve after the other; not decreasing from key to key of one.
    values : (k, c) or (k, 3, c) float array
        As in `Curve`.
    """

    part: str
    interpolation: str
    nodes: np.ndarray
    ends: np.ndarray
    times: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        nodes, ends = arrays(nodes=(self.nodes, "m", int), ends=(self.ends, "m", int))
        c = PARTS[self.part]
        shape = f"k 3 {c}" if self.interpolation == SPLINE else f"k {c}"
        times, values = arrays(times=(self.times, "k"), values=(self.values, shape))
        if (np.diff(ends, prepend=0) < 1).any() or ends[-1:].sum() != len(times):
            raise ValueError(f"ends of curves must increase from 1 to the number of keys, {len(times)}")
        if (np.delete(np.diff(times), ends[:-1] - 1) < 0).any():
            raise ValueError("times of keys must not decrease")
        if self.interpolation not in (STEP, LINEAR, SPLINE):
            raise ValueError(f"unknown interpolation {self.interpolation!r}")
        for name, value in (("nodes", nodes), ("ends", ends), ("times", times), ("values", values)):
            object.__setattr__(self, name, value)

    @property
    def first(self) -> np.ndarray:
        """Where the keys of each curve begin."""
        return np.concatenate([[0], self.ends[:-1]]).astype(np.int64)

    def curves(self) -> dict[int, Curve]:
        """Each curve by its node."""
        pairs = zip(self.nodes.tolist(), self.first.tolist(), self.ends.tolist(), strict=True)
        return {node: Curve(self.times[k:end], self.values[k:end], self.interpolation) for node, k, end in pairs}

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values (t, m, c) at times (t,); before the first key and after the last those of that key."""
        i = np.searchsorted(self._codes, self._ticks_before(times)[:, None] + self._offsets, side="right") - 1
        i = np.clip(i, self.first, self.ends - 1)
        values = self._values
        if self.interpolation == STEP:
            return values[i]
        j = np.minimum(i + 1, self.ends - 1)
        h = (self.times[j] - self.times[i])[..., None]
        s = np.clip((times[:, None] - self.times[i])[..., None] / np.where(h > 0, h, 1.0), 0.0, 1.0)
        if self.interpolation == LINEAR:
            turns = self.part == "rotation"
            return slerp_quaternions(values[i], values[j], s) if turns else (1 - s) * values[i] + s * values[j]
        value = (2 * s**3 - 3 * s**2 + 1) * values[i, 1] + (s**3 - 2 * s**2 + s) * (values[i, 2] * h)
        value += (3 * s**2 - 2 * s**3) * values[j, 1] + (s**3 - s**2) * (values[j, 0] * h)
        return unit_quaternions(value)[0] if self.part == "rotation" else value

    @cached_property
    def _values(self) -> np.ndarray:
        turns = self.part == "rotation" and self.interpolation != SPLINE
        return unit_quaternions(self.values)[0] if turns else self.values

    # A look-up in all curves at once: keys are sorted by curve and, within it, by the number of their time.

    @cached_property
    def _ticks(self) -> np.ndarray:
        return np.unique(self.times)

    @cached_property
    def _offsets(self) -> np.ndarray:
        return np.arange(len(self.nodes)) * (len(self._ticks) + 1)

    @cached_property
    def _codes(self) -> np.ndarray:
        return np.searchsorted(self._ticks, self.times) + np.repeat(self._offsets, np.diff(self.ends, prepend=0))

    def _ticks_before(self, times: np.ndarray) -> np.ndarray:
        return np.searchsorted(self._ticks, times, side="right") - 1


@dataclass(frozen=True)
class Curves:
    """How bones move with the nodes of a tree, which curves move.

    At a time t a node's transform relative to its parent is `frame` T(t) R(t) S(t): its translation, rotation and
    scale, by the curves of its channels, and at rest where a part has none. A bone moves by
    B(t) = G(t) `inverse`, with G(t) the product down the tree to its node.

    Attributes
    ----------
    P : (n,) int array
        Parent nodes, -1 at a root.
    translation, rotation, scale : (n, 3), (n, 4), (n, 3) float array
        At rest; rotations are unit quaternions (x, y, z, w).
    frame : (n, 4, 4) float array
        The identity, except for nodes whose file holds a matrix.
    bones : (b,) int array
        The node of each bone.
    inverse : (b, 4, 4) float array
        From the rest pose to the frame of the node at rest.
    channels : tuple of Channels
    d : int
        Dimension of the transforms B: 2 for those of a flat character.
    """

    P: np.ndarray
    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    frame: np.ndarray
    bones: np.ndarray
    inverse: np.ndarray
    channels: tuple[Channels, ...] = ()
    d: int = 3

    def __post_init__(self) -> None:
        named = {"P": ("n", int), "translation": ("n 3",), "rotation": ("n 4",), "scale": ("n 3",)}
        named |= {"frame": ("n 4 4",), "bones": ("b", int), "inverse": ("b 4 4",)}
        checked = arrays(**{name: (getattr(self, name), *kind) for name, kind in named.items()})
        for name, value in zip(named, checked, strict=True):
            object.__setattr__(self, name, value)
        n = len(self.P)
        bone_order(self.P)
        check_indices("bones", self.bones, n, "nodes")
        moved = [(channels.part, node) for channels in self.channels for node in channels.nodes.tolist()]
        for channels in self.channels:
            check_indices("nodes", channels.nodes, n, "nodes")
        if len(set(moved)) < len(moved):
            raise ValueError("a part of a node has two curves")

    def at(self, times: np.ndarray) -> np.ndarray:
        """Transforms (t, b, d+1, d+1) of the bones, rest to posed, at times (t,).

        Before its first key and after its last a curve has the value of that key.

        Raises
        ------
        ValueError
            If a number is out of bounds, or a bone of a flat character leaves the plane.

        Examples
        --------
        >>> still, turned = np.eye(4), np.diag([-1.0, -1, 1, 1])
        >>> C, BE, P = [[0, 0, 0]], [[0, 0]], [-1]
        >>> curves = curves_between(C, BE, P, [0, 2], np.stack([[still], [turned]]))
        >>> curves.at([0.0, 1.0, 9.0])[:, 0, :2, 0].round(6) + 0.0  # half of half a turn is a quarter
        array([[ 1.,  0.],
               [ 0.,  1.],
               [-1.,  0.]])
        """
        (times,) = arrays(times=(times, "t"))
        B = np.empty((len(times), len(self.bones), 4, 4))
        step = max(1, _BLOCK // max(len(self.P), 1))
        with np.errstate(all="ignore"):
            for first in range(0, len(times), step):
                G = composed(self.P, self._local(times[first : first + step]))
                B[first : first + step] = G[:, self.bones] @ self.inverse
        bad = np.argwhere(~(np.abs(B) < LARGEST))
        if len(bad):
            raise ValueError(f"the transform of bone {bad[0][1]} at {times[bad[0][0]]:g} s is out of bounds")
        B[..., 3, :] = [0, 0, 0, 1]
        return B if self.d == 3 else transforms_in_plane(B)

    @property
    def key_times(self) -> np.ndarray:
        """The times (k,) at which a curve has a key, increasing."""
        return np.unique(np.concatenate([np.zeros(0), *(channels.times for channels in self.channels)]))

    def shifted(self, start: float, to: float) -> "Curves":
        """The same curves, with what was at the time `start` at the time `to`."""
        return replace(self, channels=tuple(replace(c, times=c.times - start + to) for c in self.channels))

    def of_bones(self, bones: np.ndarray) -> "Curves":
        """The curves of some of the bones."""
        return replace(self, bones=self.bones[bones], inverse=self.inverse[bones])

    def curves(self) -> dict[tuple[int, str], Curve]:
        """Each curve by its node and part."""
        return {(node, c.part): curve for c in self.channels for node, curve in c.curves().items()}

    @cached_property
    def _moved(self) -> np.ndarray:
        """Nodes that curves move."""
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(c.nodes for c in self.channels)]))

    @cached_property
    def _still(self) -> np.ndarray:
        return self.frame @ compose(self.translation, self.rotation, self.scale)

    def _local(self, times: np.ndarray) -> np.ndarray:
        """Transforms (t, n, 4, 4) of nodes relative to their parents."""
        moved = self._moved
        parts = {part: np.repeat(getattr(self, part)[None, moved], len(times), axis=0) for part in PARTS}
        for channels in self.channels:
            parts[channels.part][:, np.searchsorted(moved, channels.nodes)] = channels.at(times)
        local = np.repeat(self._still[None], len(times), axis=0)
        local[:, moved] = self.frame[moved] @ compose(**parts)
        return local


def channels_of(curves: Mapping[tuple[int, str], Curve]) -> tuple[Channels, ...]:
    """Curves by node and part, as channels."""
    kinds: dict[tuple[str, str], list[tuple[int, Curve]]] = {}
    for (node, part), curve in curves.items():
        kinds.setdefault((part, curve.interpolation), []).append((node, curve))
    return tuple(
        Channels(
            part,
            interpolation,
            np.array([node for node, _ in members]),
            np.cumsum([len(curve.times) for _, curve in members]),
            np.concatenate([curve.times for _, curve in members]),
            np.concatenate([curve.values for _, curve in members]),
        )
        for (part, interpolation), members in kinds.items()
    )


def curves_between(C: np.ndarray, BE: np.ndarray, P: np.ndarray, times: np.ndarray, B: np.ndarray) -> Curves:
    """Curves through rigid poses in space: local rotations are slerped between them, local translations are linear.

    Parameters
    ----------
    C, BE, P : (k, 3) float array, (b, 2) and (b,) int arrays
        Joints at rest, in mesh units; bones, indices into C; parent bones, -1 at a root.
    times : (t,) float array
        Seconds, increasing; at least one.
    B : (t, b, 4, 4) float array
        Rotations with translations, rest to posed.

    Returns
    -------
    curves : Curves
        Of bones as nodes; what leaves the rest pose by rounding only has no curve.
    """
    C, BE, P = arrays(C=(C, "k 3"), BE=(BE, "b 2", "C"), P=(P, "b", int))
    times, B = arrays(times=(times, "t"), B=(B, f"t {len(BE)} 4 4"))
    local, start = local_transforms(C, BE, P, B), C[BE[:, 0]]
    rest = {"translation": start - np.where((P < 0)[:, None], 0.0, start[P]), "rotation": np.eye(4)[[3] * len(P)]}
    values = {"translation": local[..., :3, 3], "rotation": without_jumps(quaternions(local[..., :3, :3]))}
    size = {"translation": np.abs(local[..., :3, 3]).max(initial=0) + np.abs(start).max(initial=0), "rotation": 1.0}
    curves = {
        (int(bone), part): Curve(times, value[:, bone], LINEAR)
        for part, value in values.items()
        for bone in np.flatnonzero(np.abs(value - rest[part]).max(axis=(0, 2)) > _ROUNDING * size[part])
    }
    inverse = np.tile(np.eye(4), (len(P), 1, 1))
    inverse[:, :3, 3] = -start
    return Curves(
        P,
        rest["translation"],
        rest["rotation"],
        np.ones((len(P), 3)),
        frame=np.tile(np.eye(4), (len(P), 1, 1)),
        bones=np.arange(len(P)),
        inverse=inverse,
        channels=channels_of(curves),
    )
