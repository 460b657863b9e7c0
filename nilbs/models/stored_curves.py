"""Curves of a motion as the arrays and the text of a model file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nilbs.characters.clips import FollowedCurves
from nilbs.geometry.curves import Channels, Curves, PosesOverTime
from nilbs.geometry.reference_pose import ReferencePose
from nilbs.geometry.skeleton import Skeleton

_TREE = ("P", "translation", "rotation", "scale", "frame", "bones", "inverse")
_CHANNELS = ("nodes", "ends", "times", "values")
_SKELETON = ("C", "BE", "P")


def stored_curves(curves: Sequence[PosesOverTime | None]) -> tuple[dict[str, np.ndarray], list[dict[str, Any] | None]]:
    """The curves of each clip as arrays by name, and as text: that of curves of another skeleton names its bones."""
    arrays: dict[str, np.ndarray] = {}
    texts: list[dict[str, Any] | None] = []
    for k, found in enumerate(curves):
        text: dict[str, Any] = {}
        if isinstance(found, FollowedCurves):
            text = {"names": list(found.source.names), "bone_map": dict(found.bone_map)}
            arrays |= {f"{k}.source.{name}": getattr(found.source, name) for name in _SKELETON}
            reference = found.reference
            text |= {"frame": reference.frame, "unlike": reference.unlike, "travels": reference.travels}
            arrays |= {f"{k}.start": found.start, f"{k}.pose": reference.pose, f"{k}.axes": reference.axes}
            found = found.curves
        if isinstance(found, Curves):
            arrays |= {f"{k}.{name}": getattr(found, name) for name in _TREE}
            for c in found.channels:
                arrays |= {f"{k}.{c.part}.{c.interpolation}.{name}": getattr(c, name) for name in _CHANNELS}
        texts.append(None if found is None else text)
    return {name: _in_few_bytes(array) for name, array in arrays.items()}, texts


def restored_curves(
    arrays: Mapping[str, np.ndarray], texts: Sequence[Mapping[str, Any] | None], target: Skeleton
) -> tuple[PosesOverTime | None, ...]:
    """The curves of each clip from what `stored_curves` returned, of the skeleton that they move."""
    return tuple(None if text is None else _restored(arrays, k, text, target) for k, text in enumerate(texts))


def _restored(arrays: Mapping[str, np.ndarray], k: int, text: Mapping[str, Any], target: Skeleton) -> PosesOverTime:
    tree: dict[str, Any] = {name: arrays[f"{k}.{name}"] for name in _TREE}
    kinds = [name.split(".")[1:3] for name in arrays if name.startswith(f"{k}.") and name.endswith(".times")]
    channels = [
        Channels(part, interpolation, *(arrays[f"{k}.{part}.{interpolation}.{name}"] for name in _CHANNELS))
        for part, interpolation in kinds
    ]
    curves, moved = Curves(**tree, channels=tuple(channels), d=target.d), target
    if text:
        named: dict[str, Any] = {name: arrays[f"{k}.source.{name}"] for name in _SKELETON}
        moved = Skeleton(**named, names=text["names"])
    if len(curves.bones) != len(moved.BE):
        raise ValueError(f"the curves of clip {k} are of {len(curves.bones)} bones, not {len(moved.BE)}")
    if not text:
        return curves
    pose, axes = arrays[f"{k}.pose"], arrays[f"{k}.axes"]
    reference = ReferencePose(text["frame"], pose, axes, text["unlike"], text.get("travels", -1))
    return FollowedCurves(moved, target, text["bone_map"], arrays[f"{k}.start"], reference, curves)


def _in_few_bytes(array: np.ndarray) -> np.ndarray:
    """An array in single precision, where that holds its numbers, as those of most files."""
    if array.dtype != np.float64:
        return array
    with np.errstate(over="ignore"):
        single = array.astype(np.float32)
    return single if (single == array).all() else array
