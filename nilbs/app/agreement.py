"""Whether files belong together: sizes, dimensions and places."""

from collections.abc import Mapping

import numpy as np

from nilbs.app.descriptions import mesh_of, outline
from nilbs.characters.character import in_dimension
from nilbs.geometry.bone_names import matching_bones
from nilbs.geometry.facets import seamless
from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.rig_diagnosis import rig_report, tips
from nilbs.geometry.rig_weights import check_rig_fits
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import listed
from nilbs.io.bundle import Bundle, Influences
from nilbs.io.motion import LocalMotion


def disagreements(files: Mapping[str, Bundle], points: Mapping[str, np.ndarray], group: str | None = None) -> list[str]:
    """A sentence, with the names of the files, on everything in them that does not fit together."""
    rigs = {path: bundle.skeleton for path, bundle in files.items() if bundle.skeleton is not None}
    if not all(files[path].is_motion for path in rigs):
        # The skeleton of a motion is mapped onto the rig: it need not fit the rest.
        rigs = {path: skeleton for path, skeleton in rigs.items() if not files[path].is_motion}
    meshes = {path: bundle.mesh for path, bundle in files.items() if bundle.mesh is not None}
    problems: list[str] = []

    def found(one: str, other: str, lines: list[str]) -> None:
        problems.extend(f"{one if one == other else f'{one} and {other}'}: {line}" for line in lines)

    for path, mesh in meshes.items():
        V, E = mesh_of(path, mesh, group)
        for other, bundle in files.items():
            if bundle.influences is not None:
                found(other, path, _weights_of_mesh(bundle.influences, bundle, len(mesh.V), len(V)))
            d = bundle.motion.root_translation.shape[1] if isinstance(bundle.motion, LocalMotion) else V.shape[1]
            if d != V.shape[1]:
                found(other, path, [f"a motion in {d} dimensions, but the mesh has {V.shape[1]}"])
        for other, skeleton in rigs.items():
            found(other, path, _rig_of_mesh(skeleton, V, E))
        for other, x in points.items():
            if x.shape[-1] != V.shape[1]:
                found(other, path, [f"points of shape {x.shape}, but the mesh has d = {V.shape[1]}"])
    for path, skeleton in rigs.items():
        for other, bundle in files.items():
            b, shape = len(skeleton.BE), bundle.influences and bundle.influences.shape
            columns = shape[1] if shape else len(bundle.skeleton.BE) if bundle.influences and bundle.skeleton else b
            if columns != b:
                found(other, path, [f"weights of {columns} bones, but the rig has {b}"])
            if any(
                not set(skeleton.names) & set(clip.skeleton.names) and not matching_bones(clip.skeleton, skeleton)
                for clip in bundle.clips
            ):
                found(other, path, ["no bone of the motion has the name of one of the rig: it will take a map"])
            found(other, path, _motion_of_rig(bundle.motion, skeleton))
    return list(dict.fromkeys(problems))


def _weights_of_mesh(weights: Influences, bundle: Bundle, n: int, chosen: int) -> list[str]:
    """Of a mesh of n vertices, of which some are chosen."""
    rows = weights.shape[0] if weights.shape else bundle.mesh and len(bundle.mesh.V)
    if rows is None:  # sparse weights name vertices one by one
        last = int(weights.vertex.max(initial=-1))
        return [f"weights of vertex {last}, but the mesh has {n}"] if last >= n else []
    group = f" ({chosen} in the group)" if chosen < n else ""
    return [] if rows in (n, chosen) else [f"weights of {rows} vertices, but the mesh has {n}{group}"]


def _motion_of_rig(motion: LocalMotion | np.ndarray | None, rig: Skeleton) -> list[str]:
    b = len(rig.BE)
    if isinstance(motion, LocalMotion):
        unknown = [name for name in motion.names if name not in rig.names]
        if not unknown:
            return []
        meant = nearest_name(unknown[0], rig.names)
        return [f"the rig has no bone {unknown[0]!r}{meant}; its {b} bones are {listed(rig.names)}"]
    if motion is None or motion.shape[1] == b:
        return []
    return [f"a motion of {motion.shape[1]} bones, but the rig has {b}"]


def _rig_of_mesh(skeleton: Skeleton, V: np.ndarray, E: np.ndarray) -> list[str]:
    try:
        skeleton = in_dimension(skeleton, V.shape[1])
    except ValueError as error:
        return [str(error)]
    F = E if E.shape[1] == V.shape[1] else outline(V, E)
    F, _ = coherent_orientation(V, seamless(V, F))
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
    marks = tips(skeleton)
    outside = np.setdiff1d(report.outside, skeleton.BE[marks])
    without_volume = np.setdiff1d(report.without_volume, marks)
    if len(outside):
        problems.append(f"{len(outside)} of {k} joints lie outside the mesh, joint {outside[0]} first")
    if len(without_volume):
        bones = listed([skeleton.names[bone] for bone in without_volume])
        problems.append(f"{len(without_volume)} of {b} bones have no part inside the mesh: {bones}")
    return problems
