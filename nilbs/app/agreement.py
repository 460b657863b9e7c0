"""Whether files belong together: sizes, dimensions and places."""

from itertools import permutations

import numpy as np

from nilbs.app.contents import Content
from nilbs.character import in_dimension
from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.skeleton import Skeleton
from nilbs.weighting import check_rig_fits


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
    problems = []
    for one, other in permutations(contents, 2):
        check = _CHECKS.get((one.kind, other.kind))
        problem = check(one.arrays, other.arrays) if check else None
        if problem:
            problems.append(f"{one.path} and {other.path}: {problem}")
    return problems


def _weights_of_mesh(weights: dict, mesh: dict) -> str | None:
    n, rows = len(mesh["V"]), len(weights["W"])
    return None if n == rows else f"weights of {rows} vertices, but the mesh has {n}"


def _weights_of_rig(weights: dict, rig: dict) -> str | None:
    b, columns = len(rig["BE"]), weights["W"].shape[1]
    return None if b == columns else f"weights of {columns} bones, but the rig has {b}"


def _motion_of_rig(motion: dict, rig: dict) -> str | None:
    b = len(rig["BE"])
    if "B" in motion:
        moved = motion["B"].shape[1]
        return None if b == moved else f"a motion of {moved} bones, but the rig has {b}"
    unknown = [name for name in motion["names"] if name not in {f"bone{bone}" for bone in range(b)}]
    return f"the rig has no bone {unknown[0]!r}; its {b} bones are bone0, bone1, ..." if unknown else None


def _rig_of_mesh(rig: dict, mesh: dict) -> str | None:
    V = mesh["V"]
    try:
        BE = rig["BE"]
        names = tuple(f"bone{bone}" for bone in range(len(BE)))
        skeleton = in_dimension(Skeleton(rig["C"], BE, bone_parents(BE), names), V.shape[1])
        check_rig_fits(V, skeleton)
    except ValueError as error:
        return str(error)
    C = skeleton.C
    outside = ((V.min(axis=0) > C) | (V.max(axis=0) < C)).any(axis=1)
    if not outside.any():
        return None
    return f"{int(outside.sum())} joints lie outside the mesh's box, joint {int(np.flatnonzero(outside)[0])} first"


def _motion_of_mesh(motion: dict, mesh: dict) -> str | None:
    if "theta" not in motion:
        return None
    d = motion["root_translation"].shape[1]
    return None if d == mesh["V"].shape[1] else f"a motion in {d} dimensions, but the mesh has {mesh['V'].shape[1]}"


def _points_of_mesh(points: dict, mesh: dict) -> str | None:
    d = mesh["V"].shape[1]
    return None if points["x"].shape[-1] == d else f"points of shape {points['x'].shape}, but the mesh has d = {d}"


_CHECKS = {
    ("weights", "mesh"): _weights_of_mesh,
    ("weights", "rig"): _weights_of_rig,
    ("motion", "rig"): _motion_of_rig,
    ("rig", "mesh"): _rig_of_mesh,
    ("motion", "mesh"): _motion_of_mesh,
    ("points", "mesh"): _points_of_mesh,
}
