"""Whether files belong together: sizes, dimensions and places."""

from itertools import permutations

import numpy as np

from nilbs.app.contents import Content
from nilbs.app.descriptions import outline
from nilbs.characters.character import in_dimension
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.rig_diagnosis import rig_report
from nilbs.geometry.rig_weights import check_rig_fits
from nilbs.geometry.validation import listed


def disagreements(contents: list[Content]) -> list[str]:
    """Check every pair of files against each other.

    Parameters
    ----------
    contents : list of Content
        What was read.

    Returns
    -------
    problems : list of str
        A sentence for each disagreement, naming both files.
    """
    if any(content.kind == "rig" and not _is_motion_file(content) for content in contents):
        # The skeleton of a motion is mapped onto the rig: it need not fit the rest.
        contents = [content for content in contents if content.kind != "rig" or not _is_motion_file(content)]
    problems = []
    for one, other in permutations(contents, 2):
        check = _CHECKS.get((one.kind, other.kind))
        where = one.path if one.path == other.path else f"{one.path} and {other.path}"
        problems += [f"{where}: {problem}" for problem in (check(one.arrays, other.arrays) if check else [])]
    return problems


def _is_motion_file(content: Content) -> bool:
    return content.path.lower().endswith(".bvh")


def _weights_of_mesh(weights: dict, mesh: dict) -> list[str]:
    n, m = len(mesh["whole"]), len(mesh["V"])
    rows = len(weights["W"]) if "W" in weights else weights["n"]
    if rows is None:  # sparse weights name vertices one by one
        last = int(weights["influences"].vertex.max(initial=-1))
        return [f"weights of vertex {last}, but the mesh has {n}"] if last >= n else []
    chosen = f" ({m} in the group)" if m < n else ""
    return [] if rows in (n, m) else [f"weights of {rows} vertices, but the mesh has {n}{chosen}"]


def _weights_of_rig(weights: dict, rig: dict) -> list[str]:
    b, columns = len(rig["skeleton"].BE), weights["W"].shape[1] if "W" in weights else weights["b"]
    return [] if b == columns else [f"weights of {columns} bones, but the rig has {b}"]


def _motion_of_rig(motion: dict, rig: dict) -> list[str]:
    names = rig["skeleton"].names
    if "skeleton" in motion:  # a motion of bones of its own, which are mapped onto the rig's
        common = len(set(names) & set(motion["skeleton"].names))
        return [] if common else ["no bone of the motion has the name of one of the rig: it will take a map"]
    if "B" in motion:
        moved = motion["B"].shape[1]
        return [] if len(names) == moved else [f"a motion of {moved} bones, but the rig has {len(names)}"]
    unknown = [name for name in motion["names"] if name not in names]
    return [f"the rig has no bone {unknown[0]!r}; its {len(names)} bones are {listed(names)}"] if unknown else []


def _rig_of_mesh(rig: dict, mesh: dict) -> list[str]:
    V, E = mesh["V"], mesh["E"]
    try:
        skeleton = in_dimension(rig["skeleton"], V.shape[1])
    except ValueError as error:
        return [str(error)]
    F = E if E.shape[1] == V.shape[1] else outline(V, E)
    F, _ = coherent_orientation(V, F)
    report = rig_report(V, F, skeleton)
    problems = []
    try:
        check_rig_fits(V[np.unique(F)], skeleton)
    except ValueError as error:
        problems.append(str(error))
    if report.suggestion:
        problems.append(report.suggestion)
    if problems:
        return problems
    k, b = len(np.unique(skeleton.BE)), len(skeleton.BE)
    if len(report.outside):
        problems.append(f"{len(report.outside)} of {k} joints lie outside the mesh, joint {report.outside[0]} first")
    if len(report.without_volume):
        bones = listed([skeleton.names[bone] for bone in report.without_volume])
        problems.append(f"{len(report.without_volume)} of {b} bones have no part inside the mesh: {bones}")
    return problems


def _motion_of_mesh(motion: dict, mesh: dict) -> list[str]:
    if "theta" not in motion:
        return []
    d = motion["root_translation"].shape[1]
    return [] if d == mesh["V"].shape[1] else [f"a motion in {d} dimensions, but the mesh has {mesh['V'].shape[1]}"]


def _points_of_mesh(points: dict, mesh: dict) -> list[str]:
    d = mesh["V"].shape[1]
    return [] if points["x"].shape[-1] == d else [f"points of shape {points['x'].shape}, but the mesh has d = {d}"]


_CHECKS = {
    ("weights", "mesh"): _weights_of_mesh,
    ("weights", "rig"): _weights_of_rig,
    ("motion", "rig"): _motion_of_rig,
    ("rig", "mesh"): _rig_of_mesh,
    ("motion", "mesh"): _motion_of_mesh,
    ("points", "mesh"): _points_of_mesh,
}
