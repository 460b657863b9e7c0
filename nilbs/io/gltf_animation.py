"""The animations of a glTF file, as curves of its nodes and transforms of the bones of its skins."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nilbs.geometry.curves import LINEAR, PARTS, SPLINE, STEP, Curve, Curves, channels_of
from nilbs.geometry.quaternions import unit_quaternions
from nilbs.io.bundle import Clip
from nilbs.io.gltf_document import Document
from nilbs.io.gltf_nodes import AT_REST, Nodes
from nilbs.io.gltf_skin import Rig
from nilbs.io.names import unique_names

_MATRICES = 2**21  # of all frames and nodes of a file, beyond one for eight of its bytes


@dataclass(frozen=True)
class Animation:
    """The curves of an animation that move joints, by node and part."""

    name: str
    curves: dict[tuple[int, str], Curve]


def read_animations(file: Document, nodes: Nodes, joints: list[int]) -> tuple[list[Animation], list[str]]:
    """Animations that move one of these joints or a node above one, and notes."""
    moving = _moving(nodes, joints)
    found: list[Animation] = []
    entries = file.entries("animations")
    given = [file.text(entry, "name", f"animation {i}") or f"animation{i}" for i, entry in enumerate(entries)]
    names, renamed = unique_names(given)
    notes = [*renamed]
    for name, entry in zip(names, entries, strict=True):
        where = f"animation {name[:80]!r}"
        samplers = file.objects(entry, "samplers", where)
        curves: dict[tuple[int, str], Curve] = {}
        for channel in file.objects(entry, "channels", where):
            target = file.section(channel, "target", where)
            part = file.text(target, "path", where)
            if part == "weights":
                notes.append("morph targets are animated, which is left out")
            if part not in PARTS or "node" not in target:
                continue
            node = file.whole(target, "node", where, below=len(nodes.order))
            if not moving[node]:
                notes.append(f"{where} also moves nodes above no joint, which is left out")
                continue
            if (node, part) in curves or nodes.fixed[node]:
                fault = "has a matrix" if nodes.fixed[node] else "is animated twice"
                raise file.error(f"{where}: the {part} of {nodes.label(node)} {fault}")
            sampler = samplers[file.whole(channel, "sampler", where, below=len(samplers))]
            curves[node, part] = _curve(file, sampler, part, f"{where}, {part} of {nodes.label(node)}")
        if curves:
            found.append(Animation(name, curves))
        else:
            notes.append(f"{where} moves no joint and is left out")
    return found, notes


def clips(file: Document, nodes: Nodes, rig: Rig, animations: list[Animation]) -> tuple[Clip, ...]:
    """Curves of the bones, and their transforms at all key times; refused if those take too much memory."""
    if rig.skeleton is None:
        return ()
    moving = _moving(nodes, list(rig.bone))
    order = [node for node in nodes.order if moving[node]]
    number = {node: i for i, node in enumerate(order)} | {-1: -1}
    fixed = nodes.fixed[order]
    rest: dict[str, Any] = {
        part: np.where(fixed[:, None], AT_REST[part], getattr(nodes, part)[order]) for part in PARTS
    }
    tree = Curves(
        np.array([number[int(nodes.parent[node])] for node in order]),
        **rest,
        frame=np.where(fixed[:, None, None], nodes.local[order], np.eye(4)),
        bones=np.array([number[node] for node in rig.bone]),
        inverse=rig.inverse,
    )
    all_curves = [
        replace(tree, channels=channels_of({(number[node], part): c for (node, part), c in a.curves.items()}))
        for a in animations
    ]
    frames = sum(len(curves.key_times) for curves in all_curves)
    if frames * len(order) > _MATRICES + file.size // 8:
        raise file.error(f"its animations have {frames} frames of {len(order)} nodes, too many for a file of its size")
    found = []
    for animation, curves in zip(animations, all_curves, strict=True):
        times = curves.key_times
        try:
            found.append(Clip(animation.name, rig.skeleton, times, curves.at(times), curves=curves))
        except ValueError as error:
            raise file.error(f"animation {animation.name[:80]!r}: {error}") from None
    return tuple(found)


def _moving(nodes: Nodes, joints: list[int]) -> np.ndarray:
    """Which nodes are joints or above joints."""
    moving = np.zeros(len(nodes.order), dtype=bool)
    moving[joints] = True
    for node in reversed(nodes.order):
        if moving[node] and nodes.parent[node] >= 0:
            moving[nodes.parent[node]] = True
    return moving


def _curve(file: Document, sampler: dict, part: str, where: str) -> Curve:
    written = file.text(sampler, "interpolation", where) or "LINEAR"
    interpolation = {name.upper(): name for name in (STEP, LINEAR, SPLINE)}.get(written)
    if interpolation is None:
        raise file.error(f"{where}: unknown interpolation {written[:40]!r}")
    times = file.accessor(file.whole(sampler, "input", where), where, "SCALAR")[:, 0]
    values = file.accessor(file.whole(sampler, "output", where), where, "VEC4" if part == "rotation" else "VEC3")
    if not len(times) or not (np.diff(times) > 0).all():
        raise file.error(f"{where}: its times must increase from key to key")
    each = 3 if interpolation == SPLINE else 1
    if len(values) != each * len(times):
        raise file.error(f"{where}: {len(times)} keys need {each * len(times)} values, not {len(values)}")
    if each == 3:
        values = values.reshape(len(times), 3, -1)
    if part == "rotation":
        _, zero = unit_quaternions(values[:, 1] if each == 3 else values)
        if zero.any():
            raise file.error(f"{where}: key {np.flatnonzero(zero)[0]} is zero, which is no rotation")
    return Curve(times, values, interpolation)
