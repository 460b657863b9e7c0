"""What files hold, whatever their suffixes are, thing by thing."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from nilbs.characters.loading import whole_or_group
from nilbs.geometry.plane import in_space
from nilbs.io import FileFormatError, check_suffix, read_bundle, read_npy, read_transforms, read_weights
from nilbs.io.bundle import Bundle
from nilbs.io.makehuman import read_mhw
from nilbs.io.motion import read_motion_json
from nilbs.io.registry import READABLE, kind_of

_AFTER_OTHERS = {".mhskel": 1, ".mhw": 2}  # files that take a mesh, or a rig, to be read


@dataclass(frozen=True)
class Content:
    """One thing that a file holds, the kind of thing, its arrays by letter, and what reading it left out or decided."""

    path: str
    kind: str
    arrays: dict[str, Any]
    notes: tuple[str, ...] = field(default=())


def read(paths: Sequence[str], *, group: str | None = None) -> list[Content]:
    """Read files as what their suffixes and their numbers say they are.

    Parameters
    ----------
    paths : sequence of str
    group : str, optional
        The group of every mesh that is taken; all of it by default.

    Returns
    -------
    contents : list of Content
        In the order of the files; a file may hold several.

    Raises
    ------
    FileFormatError, ValueError, OSError
        If one cannot be read, or a mesh has no such group.
    """
    suffixes = [check_suffix(path, *READABLE, ".npy", ".nilbs") for path in paths]
    found: dict[int, list[Content]] = {}
    for i in sorted(range(len(paths)), key=lambda i: _AFTER_OTHERS.get(suffixes[i], 0)):
        before = [content for contents in found.values() for content in contents]
        found[i] = _read(str(paths[i]), suffixes[i], before, group)
    return [content for i in range(len(paths)) for content in found[i]]


def _read(path: str, suffix: str, others: list[Content], group: str | None) -> list[Content]:
    if suffix == ".npy":
        return [Content(path, "points", {"x": read_npy(path)})]
    if suffix == ".nilbs":
        from nilbs.models.model_file import load_model

        return [Content(path, "model", {"model": load_model(path)})]
    kind = kind_of(path)
    if kind == "parts":
        V = next((other.arrays["whole"] for other in others if other.kind == "mesh"), None)
        return _parts(path, read_bundle(path, V=None if V is None else in_space(V)), group)
    if suffix == ".mhw":
        # The last one: a .mhskel, if there is one, was read after the skeletons of motions.
        rig = next((other.arrays["skeleton"] for other in reversed(others) if other.kind == "rig"), None)
        if rig is None:
            raise FileFormatError(path, "its weights are of bones by name: give the rig too")
        return [Content(path, "weights", {"influences": read_mhw(path, rig.names), "b": len(rig.BE), "n": None})]
    if kind == "weights":
        return [Content(path, "weights", {"W": read_weights(path)})]
    if suffix == ".json":
        motion = read_motion_json(path)
        values = {"names": motion.names, "theta": motion.theta, "root_translation": motion.root_translation}
        return [Content(path, "motion", values)]
    return [Content(path, "motion", {"B": read_transforms(path)})]


def _parts(path: str, parts: Bundle, group: str | None) -> list[Content]:
    contents: list[Content] = []
    if parts.mesh is not None:
        try:
            V, E, _ = whole_or_group(parts.mesh, group)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        groups = () if group else tuple(parts.mesh.groups)
        contents.append(Content(path, "mesh", {"V": V, "E": E, "whole": parts.mesh.V, "groups": groups}))
    if parts.skeleton is not None:
        contents.append(Content(path, "rig", {"skeleton": parts.skeleton}))
    if parts.influences is not None and parts.skeleton is not None:
        n = None if parts.mesh is None else len(parts.mesh.V)
        values = {"influences": parts.influences, "b": len(parts.skeleton.BE), "n": n}
        contents.append(Content(path, "weights", values))
    for clip in parts.clips:
        values = {"B": clip.B, "name": clip.name, "times": clip.times, "skeleton": clip.skeleton}
        contents.append(Content(path, "motion", values))
    if not contents:
        raise FileFormatError(path, "the file holds no mesh, rig or motion")
    first = contents[0]
    return [Content(first.path, first.kind, first.arrays, parts.notes), *contents[1:]]
