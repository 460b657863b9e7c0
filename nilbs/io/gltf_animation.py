"""The animations of a glTF file, as transforms of the bones of its skins."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.validation import listed
from nilbs.io.bundle import Clip
from nilbs.io.gltf_document import Document
from nilbs.io.gltf_nodes import LARGEST, Nodes, compose, unit_quaternions
from nilbs.io.gltf_skin import Rig
from nilbs.io.names import unique_names

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_MATRICES = 2**21  # of all frames and nodes of a file, beyond one for eight of its bytes
_BLOCK = 2**15  # of those held at a time


@dataclass(frozen=True)
class Channel:
    """How one part of a node's transform changes.

    `times` (k,) increase; `values` are (k, c), or for a cubic spline (k, 3, c) with the slopes before and after each
    key.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: str
    turns: bool

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values (t, c) at these times; before the first key and after the last those of that key."""
        cubic = self.interpolation == "CUBICSPLINE"
        keys = self.values[:, 1] if cubic else self.values
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 1)
        if self.interpolation == "STEP" or len(self.times) == 1:
            result = keys[i]
        else:
            i = np.minimum(i, len(self.times) - 2)
            h = (self.times[i + 1] - self.times[i])[:, None]
            s = np.clip((times - self.times[i])[:, None] / h, 0.0, 1.0)
            if cubic:
                out, into = self.values[i, 2] * h, self.values[i + 1, 0] * h
                value = (2 * s**3 - 3 * s**2 + 1) * keys[i] + (s**3 - 2 * s**2 + s) * out
                result = value + (3 * s**2 - 2 * s**3) * keys[i + 1] + (s**3 - s**2) * into
            else:
                result = _slerp(keys[i], keys[i + 1], s) if self.turns else (1 - s) * keys[i] + s * keys[i + 1]
        return unit_quaternions(result)[0] if self.turns else result


@dataclass(frozen=True)
class Animation:
    """The channels of an animation that move joints, by node and part."""

    name: str
    channels: dict[tuple[int, str], Channel]


def read_animations(file: Document, nodes: Nodes, joints: list[int]) -> tuple[list[Animation], list[str]]:
    """Animations that move one of these joints or a node above one, and notes."""
    moving = _moving(nodes, joints)
    found: list[Animation] = []
    entries = file.entries("animations")
    given = [file.text(entry, "name", f"animation {i}") or f"animation{i}" for i, entry in enumerate(entries)]
    names, renamed = unique_names(given)
    notes, uneven = [*renamed], []
    for name, entry in zip(names, entries, strict=True):
        where = f"animation {name[:80]!r}"
        samplers = file.objects(entry, "samplers", where)
        channels: dict[tuple[int, str], Channel] = {}
        for channel in file.objects(entry, "channels", where):
            target = file.section(channel, "target", where)
            part = file.text(target, "path", where)
            if part == "weights":
                notes.append("morph targets are animated, which is left out")
            if part not in _WIDTHS or "node" not in target:
                continue
            node = file.whole(target, "node", where, below=len(nodes.order))
            if not moving[node]:
                notes.append(f"{where} also moves nodes above no joint, which is left out")
                continue
            if (node, part) in channels or nodes.fixed[node]:
                fault = "has a matrix" if nodes.fixed[node] else "is animated twice"
                raise file.error(f"{where}: the {part} of {nodes.label(node)} {fault}")
            sampler = samplers[file.whole(channel, "sampler", where, below=len(samplers))]
            channels[node, part] = _channel(file, sampler, part, f"{where}, {part} of {nodes.label(node)}")
        if channels:
            found.append(Animation(name, channels))
            if any(channel.interpolation != "LINEAR" for channel in channels.values()):
                uneven.append(repr(name[:80]))
        else:
            notes.append(f"{where} moves no joint and is left out")
    if uneven:
        notes.append(f"steps and cubic splines are exact at their keys, and linear between them: {listed(uneven)}")
    return found, notes


def clips(file: Document, nodes: Nodes, rig: Rig, animations: list[Animation]) -> tuple[Clip, ...]:
    """Transforms of the bones at all key times of each animation; refused if they take too much memory."""
    if rig.skeleton is None:
        return ()
    moving = _moving(nodes, list(rig.bone))
    order = [node for node in nodes.order if moving[node]]
    all_times = [np.unique(np.concatenate([c.times for c in a.channels.values()])) for a in animations]
    frames = sum(map(len, all_times))
    if frames * len(order) > _MATRICES + file.size // 8:
        raise file.error(f"its animations have {frames} frames of {len(order)} nodes, too many for a file of its size")
    found = []
    for animation, times in zip(animations, all_times, strict=True):
        B = np.empty((len(times), len(rig.bone), 4, 4))
        step = max(1, _BLOCK // len(order))
        with np.errstate(all="ignore"):
            for first in range(0, len(times), step):
                G = _worlds(nodes, animation, order, times[first : first + step])
                for node, bone in rig.bone.items():
                    B[first : first + step, bone] = G[node] @ rig.inverse[bone]
        bad = np.argwhere(~(np.abs(B) < LARGEST))
        if len(bad):
            where = f"animation {animation.name[:80]!r} at {times[bad[0][0]]} s"
            raise file.error(f"{where}: the transform of {rig.skeleton.names[bad[0][1]][:80]!r} is out of bounds")
        B[..., 3, :] = [0, 0, 0, 1]
        found.append(Clip(animation.name, rig.skeleton, times, B))
    return tuple(found)


def _moving(nodes: Nodes, joints: list[int]) -> np.ndarray:
    """Which nodes are joints or above joints."""
    moving = np.zeros(len(nodes.order), dtype=bool)
    moving[joints] = True
    for node in reversed(nodes.order):
        if moving[node] and nodes.parent[node] >= 0:
            moving[nodes.parent[node]] = True
    return moving


def _worlds(nodes: Nodes, animation: Animation, order: list[int], times: np.ndarray) -> dict[int, np.ndarray]:
    """Transforms relative to the world, (t, 4, 4), or (4, 4) where nothing above moves."""
    G: dict[int, np.ndarray] = {}
    for node in order:
        local = nodes.local[node]
        given = {part: animation.channels[node, part] for part in _WIDTHS if (node, part) in animation.channels}
        if given:
            rest = {part: getattr(nodes, part)[node] for part in _WIDTHS}
            local = compose(**{part: given[part].at(times) if part in given else rest[part] for part in _WIDTHS})
        parent = int(nodes.parent[node])
        G[node] = G[parent] @ local if parent >= 0 else local
    return G


def _channel(file: Document, sampler: dict, part: str, where: str) -> Channel:
    interpolation = file.text(sampler, "interpolation", where) or "LINEAR"
    if interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
        raise file.error(f"{where}: unknown interpolation {interpolation[:40]!r}")
    times = file.accessor(file.whole(sampler, "input", where), where, "SCALAR")[:, 0]
    values = file.accessor(file.whole(sampler, "output", where), where, "VEC4" if part == "rotation" else "VEC3")
    if not len(times) or not (np.diff(times) > 0).all():
        raise file.error(f"{where}: its times must increase from key to key")
    each = 3 if interpolation == "CUBICSPLINE" else 1
    if len(values) != each * len(times):
        raise file.error(f"{where}: {len(times)} keys need {each * len(times)} values, not {len(values)}")
    if each == 3:
        values = values.reshape(len(times), 3, -1)
    if part == "rotation":
        unit, zero = unit_quaternions(values[:, 1] if each == 3 else values)
        if zero.any():
            raise file.error(f"{where}: key {np.flatnonzero(zero)[0]} is zero, which is no rotation")
        values = values if each == 3 else unit
    return Channel(times, values, interpolation, part == "rotation")


def _slerp(q0: np.ndarray, q1: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Unit quaternions between others, by the shorter way round."""
    cosine = (q0 * q1).sum(axis=-1, keepdims=True)
    q1 = np.where(cosine < 0, -q1, q1)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    # np.sinc(x) is sin(pi x) / (pi x): both quotients tend to 1 - s and s where the angle vanishes.
    total = np.sinc(angle / np.pi)
    return (1 - s) * np.sinc((1 - s) * angle / np.pi) / total * q0 + s * np.sinc(s * angle / np.pi) / total * q1
