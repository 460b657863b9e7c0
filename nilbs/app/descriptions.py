"""What a file holds, described in numbers, with a list of what is wrong."""

from typing import Any

import numpy as np

from nilbs.app.contents import Content
from nilbs.app.surfaces import describe_surface, verdict
from nilbs.geometry.facets import components
from nilbs.geometry.kinematics import local_rotations, rms_rotation
from nilbs.geometry.plane import in_space, is_flat
from nilbs.geometry.rig_diagnosis import coincident_joints
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.io.bundle import Influences

# Weights that are further than this from rows on the simplex are a mistake and not rounding.
_TOLERANCE = 1e-6
_SHORT_BONE = 1e-3  # of the rig's extent


def describe(content: Content, others: list[Content]) -> dict[str, Any]:
    """What the content is, in numbers.

    Parameters
    ----------
    content : Content
        What to describe.
    others : list of Content
        Read beside it: a rig among them tells the local rotations of a motion.

    Returns
    -------
    report : dict
        "file", "kind", numbers, and "problems", a list of sentences; "notes", another, where there are any; of a mesh
        that weights could be solved for, "verdict".
    """
    arrays = content.arrays
    problems: list[str] = []
    if content.kind == "mesh":
        values = _mesh(arrays["V"], arrays["E"], problems)
        values |= {"groups": list(arrays["groups"])} if arrays["groups"] else {}
        values |= {"verdict": verdict(arrays["V"], arrays["E"])} if arrays["E"].shape[1] == 3 else {}
    elif content.kind == "rig":
        values = _rig(arrays["skeleton"], problems)
    elif content.kind == "weights" and "W" in arrays:
        values = _weights(arrays["W"], problems)
    elif content.kind == "weights":
        values = _influences(arrays["influences"], arrays["n"], arrays["b"], problems)
    elif content.kind == "motion":
        values = _motion(arrays, others, problems)
    elif content.kind == "points":
        values = {"shape": list(arrays["x"].shape)}
        if arrays["x"].ndim != 2 or arrays["x"].shape[1] not in (2, 3):
            problems.append("points are rows of 2 or 3 coordinates")
    else:
        values = _model(arrays["model"], problems)
    notes = {"notes": list(content.notes)} if content.notes else {}
    return {"file": content.path, "kind": content.kind, **values, **notes, "problems": problems}


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
    if d == 3 or E.shape[1] == 2:
        return {"d": d, "vertices": len(V), **describe_surface(V, E, problems)}
    values = describe_surface(V, outline(V, E), problems, used=E)
    without = int((element_volumes(V, E) <= 0).sum())
    if without:
        problems.append(f"{without} of {len(E)} triangles have no area")
    return {"d": d, "vertices": len(V), "triangles": len(E), **values, "triangles_without_area": without}


def _rig(skeleton: Skeleton, problems: list[str]) -> dict[str, Any]:
    C, BE, names = skeleton.C, skeleton.BE, skeleton.names
    extent = np.ptp(C, axis=0).max()
    long = np.flatnonzero(BE[:, 0] != BE[:, 1])  # rigs whose bones are joints end in joints without length
    length = np.linalg.norm(C[BE[long, 1]] - C[BE[long, 0]], axis=1)
    segments, _ = skeleton.segments()
    unused = np.setdiff1d(np.arange(len(C)), segments)
    if len(unused):
        problems.append(f"{len(unused)} joints belong to no bone, joint {unused[0]} first")
    joints = np.concatenate([segments, np.stack([BE[skeleton.P[skeleton.P >= 0], 0], BE[skeleton.P >= 0, 0]], axis=1)])
    pieces = components(joints, len(C))
    if pieces > 1:
        problems.append(f"the rig is {pieces} separate skeletons")
    if len(long) and length.min() < _SHORT_BONE * extent:
        bone = int(long[length.argmin()])
        named = "" if names[bone] == f"bone{bone}" else f" ({names[bone]})"
        problems.append(f"bone {bone}{named} is very short: {length.min():.3g}")
    joined = coincident_joints(skeleton)
    if len(joined):
        problems.append(f"{len(joined)} joints lie on another joint, joint {joined[0]} first")
    return {
        "d": 2 if is_flat(C) else 3,
        "joints": len(C),
        "bones": len(BE),
        "roots": int((skeleton.P < 0).sum()),
        "bones_without_length": len(BE) - len(long),
        "shortest_bone": length.min() if len(long) else None,
        "longest_bone": length.max() if len(long) else None,
        "lower": C.min(axis=0),
        "upper": C.max(axis=0),
        "names": list(names),
    }


def _weights(W: np.ndarray, problems: list[str]) -> dict[str, Any]:
    sums = W.sum(axis=1)
    error = np.abs(sums - 1)
    empty = int((W == 0).all(axis=1).sum())
    if W.min() < -_TOLERANCE or W.max() > 1 + _TOLERANCE:
        problems.append(f"weights leave 0 to 1: they run from {W.min():.6g} to {W.max():.6g}")
    if error.max() > _TOLERANCE:
        off, worst = int((error > _TOLERANCE).sum()), int(error.argmax())
        problems.append(f"{off} of {len(W)} rows do not sum to one; row {worst} sums to {sums[worst]:.6g}")
    if empty:
        problems.append(f"{empty} rows are all zero, row {int((W == 0).all(axis=1).argmax())} first")
    idle = np.flatnonzero((W == 0).all(axis=0))
    if len(idle):
        problems.append(f"{len(idle)} bones move no vertex, bone {idle[0]} first")
    return {
        "shape": list(W.shape),
        "min": W.min(),
        "max": W.max(),
        "row_sums": [sums.min(), sums.max()],
        "row_sum_error": error.max(),
        "zero_rows": empty,
    }


def _influences(painted: Influences, n: int | None, b: int, problems: list[str]) -> dict[str, Any]:
    """The same of weights as sparse as a file has them; n is None where the file does not tell how many vertices."""
    if not len(painted.weight):
        problems.append("no vertex has a weight")
        return {"shape": [n, b], "pairs": 0}
    vertices, row = np.unique(painted.vertex, return_inverse=True)
    sums = np.bincount(row, painted.weight)
    error = np.abs(sums - 1)
    low, high = painted.weight.min(), painted.weight.max()
    if low < -_TOLERANCE or high > 1 + _TOLERANCE:
        problems.append(f"weights leave 0 to 1: they run from {low:.6g} to {high:.6g}")
    if error.max() > _TOLERANCE:
        off, worst = int((error > _TOLERANCE).sum()), int(error.argmax())
        rows = f"{off} of {len(sums)} vertices have weights that do not sum to one"
        problems.append(f"{rows}; those of vertex {vertices[worst]} sum to {sums[worst]:.6g}")
    if n is not None and len(vertices) < n:
        problems.append(f"{n - len(vertices)} of {n} vertices have no weight")
    idle = np.setdiff1d(np.arange(b), painted.bone[painted.weight != 0])
    if len(idle):
        problems.append(f"{len(idle)} bones move no vertex, bone {idle[0]} first")
    values = {"min": low, "max": high, "row_sums": [sums.min(), sums.max()], "row_sum_error": error.max()}
    return {"shape": [n, b], "pairs": len(painted.weight), "vertices": len(vertices), **values}


def _motion(arrays: dict[str, Any], others: list[Content], problems: list[str]) -> dict[str, Any]:
    rig = arrays.get("skeleton") or next((other.arrays["skeleton"] for other in others if other.kind == "rig"), None)
    if "theta" in arrays:
        theta, names = arrays["theta"], arrays["names"]
        turned = {"bones": len(names), "names": list(names), "d": arrays["root_translation"].shape[1]}
        return {"frames": len(theta), **turned, "rms_local_rotation": _rms_of_names(rig, names, theta)}
    B = arrays["B"]
    clip = (
        {"name": arrays["name"], "seconds": float(np.ptp(arrays["times"])) if len(B) else 0} if "name" in arrays else {}
    )
    if not len(B):
        problems.append("the motion has no frame")
        return {**clip, "frames": 0, "bones": B.shape[1]}
    rms = _rms_of_transforms(rig, B) if rig is not None and len(rig.BE) == B.shape[1] else None
    return {**clip, "frames": len(B), "bones": B.shape[1], **_rigidity(B, problems), "rms_local_rotation": rms}


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
    """Of the local rotations of all bones but the roots, in radians; None where the transforms have none."""
    try:
        theta, _ = local_rotations(in_space(rig.C), rig.BE, rig.P, B)
    except ValueError:
        return None
    return rms_rotation(theta, rig.P)


def _rms_of_names(rig: Skeleton | None, names: tuple[str, ...], theta: np.ndarray) -> float | None:
    """The same of rotations by bone name; None where the rig is not known, and so neither are its roots."""
    if rig is None:
        return None
    place = {name: bone for bone, name in enumerate(rig.names)}
    if not set(names) <= place.keys():
        return None
    every = np.zeros((len(theta), len(rig.P), theta.shape[2]))
    every[:, [place[name] for name in names]] = theta
    return rms_rotation(every, rig.P)


def _model(model: Any, problems: list[str]) -> dict[str, Any]:
    c = model.character
    rms = model.motion.rms_rotation(c)
    motion = {"source": model.motion.source, "frames": len(model.motion), "rms_local_rotation": rms}
    motion["original_frames"] = [int(model.motion.frames.min()), int(model.motion.frames.max())]
    used = np.arange(len(c.V)) if c.d == 2 else None  # vertices inside an outline are not isolated
    return {
        "name": c.name,
        "d": c.d,
        "mesh": {"vertices": len(c.V), **describe_surface(c.V, c.F, problems, used=used)},
        "rig": _rig(c.skeleton, problems),
        "weights": _weights(c.W, problems),
        "volume": {"vertices": len(c.V_volume), "elements": len(c.T)},
        "motion": {**motion, **_rigidity(model.motion.B, problems)},
        "training": {**model.config, "final_loss": model.history[-100:].mean() if len(model.history) else None},
    }
