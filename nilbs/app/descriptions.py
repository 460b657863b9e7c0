"""What a file holds, in numbers, with a list of problems."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from nilbs.app.surfaces import describe_surface, verdict
from nilbs.characters.bundle import errors_of, whole_or_group
from nilbs.geometry.facets import components
from nilbs.geometry.kinematics import local_rotations, rms_rotation
from nilbs.geometry.plane import in_space, is_flat
from nilbs.geometry.rig_diagnosis import coincident_joints, tips
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.io.bundle import Bundle, Influences, Mesh
from nilbs.io.errors import FileFormatError
from nilbs.io.motion import LocalMotion

if TYPE_CHECKING:
    from nilbs.models.model import Model

# Weights that are further than this from rows on the simplex are a mistake and not rounding.
_TOLERANCE = 1e-6
_SHORT_BONE = 1e-3  # of the rig's extent


def describe(path: str, bundle: Bundle, rig: Skeleton | None, *, group: str | None = None) -> list[dict[str, Any]]:
    """A report on each thing that a file holds.

    Each has "file", "kind", numbers by name and "problems", a list of sentences; the first has "notes" of the reader,
    if there are any, and a mesh of triangles has a "verdict". The local rotations of a motion without a skeleton are
    those of `rig`, which is of any file. With `group` that group of the mesh is described.
    """
    reports: list[dict[str, Any]] = []

    def add(kind: str, values: Callable[[list[str]], dict[str, Any]]) -> None:
        problems: list[str] = []
        notes = {"notes": list(bundle.notes)} if bundle.notes and not reports else {}
        reports.append({"file": path, "kind": kind, **values(problems), **notes, "problems": problems})

    mesh, skeleton, weights = bundle.mesh, bundle.skeleton, bundle.influences
    if mesh is not None:
        V, E = mesh_of(path, mesh, group)
        groups = {"groups": list(mesh.groups)} if mesh.groups and not group else {}
        add("mesh", lambda problems: _mesh(V, E, problems) | groups)
    if skeleton is not None:
        add("rig", partial(_rig, skeleton))
    if weights is not None:
        bones = skeleton or rig
        shape = None if mesh is None else len(mesh.V), None if bones is None else len(bones.BE)
        add("weights", partial(_weights, weights, *(weights.shape or shape), bones))
    for clip in bundle.clips:
        seconds = float(np.ptp(clip.times)) if len(clip.B) else 0
        add("motion", partial(_transforms, clip.B, clip.skeleton, name=clip.name, seconds=seconds))
    if isinstance(bundle.motion, np.ndarray):
        add("motion", partial(_transforms, bundle.motion, rig))
    elif bundle.motion is not None:
        add("motion", partial(_local, bundle.motion, rig))
    if not reports:
        raise FileFormatError(path, "the file holds no mesh, rig or motion")
    return reports


def describe_points(path: str, x: np.ndarray) -> dict[str, Any]:
    """A report on an array of points."""
    problems = [] if x.ndim == 2 and x.shape[1] in (2, 3) else ["points are rows of 2 or 3 coordinates"]
    return {"file": path, "kind": "points", "shape": list(x.shape), "problems": problems}


def mesh_of(path: str, mesh: Mesh, group: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a mesh or of its group, in the plane where that is flat."""
    with errors_of(path):
        return whole_or_group(mesh, group)[:2]


def outline(V: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Edges around the triangles of a flat mesh that have an area.

    Examples
    --------
    >>> outline(np.array([[0.0, 0], [1, 0], [0, 1], [2, 0]]), np.array([[0, 1, 2], [0, 1, 3]])).shape
    (3, 2)
    """
    return boundary_facets(T[element_volumes(V, T) > 0])


def _mesh(V: np.ndarray, E: np.ndarray, problems: list[str]) -> dict[str, Any]:
    d = V.shape[1]
    if E.shape[1] == 2:
        return {"d": d, "vertices": len(V), **describe_surface(V, E, problems)}
    if d == 3:
        return {"d": d, "vertices": len(V), **describe_surface(V, E, problems), "verdict": verdict(V, E)}
    values = describe_surface(V, outline(V, E), problems, used=E)
    without = int((element_volumes(V, E) <= 0).sum())
    if without:
        problems.append(f"{without} of {len(E)} triangles have no area")
    return {
        "d": d,
        "vertices": len(V),
        "triangles": len(E),
        **values,
        "triangles_without_area": without,
        "verdict": verdict(V, E),
    }


def _rig(skeleton: Skeleton, problems: list[str]) -> dict[str, Any]:
    C, BE, names, points = skeleton.C, skeleton.BE, skeleton.names, skeleton.points
    extent = np.ptp(C, axis=0).max()
    long = np.flatnonzero(BE[:, 0] != BE[:, 1])  # rigs whose bones are joints end in joints without length
    length = np.linalg.norm(C[BE[long, 1]] - C[BE[long, 0]], axis=1)
    segments, _ = skeleton.segments()
    unused = np.setdiff1d(np.arange(len(C)), segments)
    if len(unused):
        problems.append(f"{len(unused)} joints belong to no bone, joint {unused[0]} first")
    joints = np.concatenate([segments, np.stack([BE[skeleton.P[skeleton.P >= 0], 0], BE[skeleton.P >= 0, 0]], axis=1)])
    pieces = components(joints, len(C)) - len(points)  # a point handle is a piece of its own
    if pieces > 1:
        problems.append(f"the rig is {pieces} separate skeletons")
    marks = tips(skeleton)
    own = np.where(np.isin(long, marks), np.inf, length)
    if own.min(initial=np.inf) < _SHORT_BONE * extent:
        bone = int(long[own.argmin()])
        named = "" if names[bone] == f"bone{bone}" else f" ({names[bone]})"
        problems.append(f"bone {bone}{named} is very short: {own.min():.3g}")
    joined = np.setdiff1d(coincident_joints(skeleton), BE[marks])
    if len(joined):
        problems.append(f"{len(joined)} joints lie on another joint, joint {joined[0]} first")
    return {
        "d": 2 if is_flat(C) else 3,
        "joints": len(C),
        "bones": len(BE) - len(points),
        **({"point_handles": len(points)} if len(points) else {}),
        "roots": int((skeleton.P < 0).sum()) - len(points),
        "bones_without_length": len(BE) - len(long) - len(points),
        "shortest_bone": length.min() if len(long) else None,
        "longest_bone": length.max() if len(long) else None,
        "lower": C.min(axis=0),
        "upper": C.max(axis=0),
        "names": list(names),
    }


def _weights(
    painted: Influences, n: int | None, b: int | None, rig: Skeleton | None, problems: list[str]
) -> dict[str, Any]:
    """Weights of n vertices and the b bones of a rig; None if nothing gives their number, or there is no rig."""
    weighted = np.flatnonzero(painted.weight)
    vertices, row = np.unique(painted.vertex, return_inverse=True)
    if not len(vertices):
        problems.append("no vertex has a weight")
        return {"shape": [n, b], "pairs": 0}
    sums = np.bincount(row, painted.weight)
    error = np.abs(sums - 1)
    low, high = painted.weight.min(), painted.weight.max()
    if n is not None and b is not None and len(weighted) < n * b:
        low = min(low, 0.0)
    if low < -_TOLERANCE or high > 1 + _TOLERANCE:
        problems.append(f"weights leave 0 to 1: they run from {low:.6g} to {high:.6g}")
    if error.max() > _TOLERANCE:
        off, worst = int((error > _TOLERANCE).sum()), int(error.argmax())
        rows = f"{off} of {len(sums)} vertices have weights that do not sum to one"
        problems.append(f"{rows}; those of vertex {vertices[worst]} sum to {sums[worst]:.6g}")
    if n is not None and len(vertices) < n:
        first = int(np.setdiff1d(np.arange(n), vertices)[0])
        problems.append(f"{n - len(vertices)} of {n} vertices have no weight, vertex {first} first")
    idle = np.setdiff1d(np.arange(b or 0), painted.bone[weighted])
    if rig is not None:
        idle = np.setdiff1d(idle, tips(rig))
    if len(idle):
        problems.append(f"{len(idle)} bones move no vertex, bone {idle[0]} first")
    values = {"min": low, "max": high, "row_sums": [sums.min(), sums.max()], "row_sum_error": error.max()}
    without = None if n is None else max(n - len(vertices), 0)
    return {"shape": [n, b], "pairs": len(painted.weight), "vertices": len(vertices), **values, "zero_rows": without}


def _local(motion: LocalMotion, rig: Skeleton | None, problems: list[str]) -> dict[str, Any]:
    names, d = motion.names, motion.root_translation.shape[1]
    rms = _rms_of_names(rig, names, motion.theta)
    values = {"frames": len(motion.theta), "bones": len(names), "names": list(names), "d": d}
    return values | {"rms_local_rotation": rms}


def _transforms(B: np.ndarray, rig: Skeleton | None, problems: list[str], **named: Any) -> dict[str, Any]:
    if not len(B):
        problems.append("the motion has no frame")
        return {**named, "frames": 0, "bones": B.shape[1]}
    rms = _rms_of_transforms(rig, B) if rig is not None and len(rig.BE) == B.shape[1] else None
    return {**named, "frames": len(B), "bones": B.shape[1], **_rigidity(B, problems), "rms_local_rotation": rms}


def _rigidity(B: np.ndarray, problems: list[str]) -> dict[str, Any]:
    d = B.shape[-1] - 1
    R = B[..., :d, :d]
    error = np.abs(R @ R.swapaxes(-1, -2) - np.eye(d)).max(axis=(-1, -2))
    frame, bone = np.unravel_index(int(error.argmax()), error.shape)
    if error.max() > 1e-3:
        problems.append(f"not a rotation: bone {bone} in frame {frame} scales or shears, by {error.max():.3g}")
    mirrored = np.argwhere(np.linalg.det(R) < 0)
    if len(mirrored):
        problems.append(f"bone {mirrored[0][1]} in frame {mirrored[0][0]} is mirrored")
    still = np.abs(B - np.eye(d + 1)).max(axis=(1, 2, 3)) < 1e-9
    return {"rotation_error": error.max(), "rest_frames": int(still.sum())}


def _rms_of_transforms(rig: Skeleton, B: np.ndarray) -> float | None:
    """Of the local rotations of all bones but the roots, in radians; None if the transforms have none."""
    try:
        theta, _ = local_rotations(in_space(rig.C), rig.BE, rig.P, B)
    except ValueError:
        return None
    return rms_rotation(theta, rig.P)


def _rms_of_names(rig: Skeleton | None, names: tuple[str, ...], theta: np.ndarray) -> float | None:
    """The same of rotations by bone name; None without a rig, because only that has the roots."""
    if rig is None:
        return None
    place = {name: bone for bone, name in enumerate(rig.names)}
    if not set(names) <= place.keys():
        return None
    every = np.zeros((len(theta), len(rig.P), theta.shape[2]))
    every[:, [place[name] for name in names]] = theta
    return rms_rotation(every, rig.P)


def describe_model(path: str, model: "Model") -> dict[str, Any]:
    """A report on a model."""
    problems: list[str] = []
    c = model.character
    rms = model.motion.rms_rotation(c)
    motion = {"source": model.motion.source, "frames": len(model.motion), "rms_local_rotation": rms}
    motion["original_frames"] = [int(model.motion.frames.min()), int(model.motion.frames.max())]
    used = np.arange(len(c.V)) if c.d == 2 else None  # vertices inside an outline are not isolated
    return {
        "file": path,
        "kind": "model",
        "name": c.name,
        "d": c.d,
        "mesh": {"vertices": len(c.V), **describe_surface(c.V, c.F, problems, used=used)},
        "rig": _rig(c.skeleton, problems),
        "weights": _weights(Influences.of_matrix(c.W), len(c.W), c.W.shape[1], c.skeleton, problems),
        "volume": {"vertices": len(c.V_volume), "elements": len(c.T)},
        "motion": {**motion, **_rigidity(model.motion.B, problems)},
        "training": {**model.config, "final_loss": model.history[-100:].mean() if len(model.history) else None},
        "problems": problems,
    }
