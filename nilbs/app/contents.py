"""What one file holds: read by its suffix, described in numbers, with a list of what is wrong."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from nilbs.app.surfaces import describe_surface
from nilbs.geometry.facets import components
from nilbs.geometry.kinematics import bone_parents, local_rotations
from nilbs.geometry.volume import boundary_facets
from nilbs.io import (
    check_suffix,
    read_dmat,
    read_mesh,
    read_npy,
    read_tgf,
    read_transforms,
    read_weights,
)
from nilbs.io.motion import read_motion_json
from nilbs.io.registry import looks_like_weights

# Weights that are further than this from rows on the simplex are a mistake and not rounding.
_TOLERANCE = 1e-6
_SHORT_BONE = 1e-3  # of the rig's extent


@dataclass(frozen=True)
class Content:
    """A file, the kind of thing in it, and the arrays that were read, by letter."""

    path: str
    kind: str
    arrays: dict[str, Any]


def read(path: str) -> Content:
    """Read a file as what its suffix and its numbers say it is.

    Raises
    ------
    FileFormatError, OSError
        If it cannot be read.
    """
    suffix = check_suffix(path, ".obj", ".ply", ".tgf", ".dmat", ".npz", ".json", ".npy", ".nilbs")
    if suffix in (".obj", ".ply"):
        V, E = read_mesh(path)
        return Content(path, "mesh", {"V": V, "E": E})
    if suffix == ".tgf":
        C, BE = read_tgf(path)
        return Content(path, "rig", {"C": C, "BE": BE})
    if suffix == ".json":
        motion = read_motion_json(path)
        values = {"names": motion.names, "theta": motion.theta, "root_translation": motion.root_translation}
        return Content(path, "motion", values)
    if suffix == ".npy":
        return Content(path, "points", {"x": read_npy(path)})
    if suffix == ".nilbs":
        from nilbs.model import load_model

        return Content(path, "model", {"model": load_model(path)})
    if suffix == ".npz" or looks_like_weights(read_dmat(path)):
        return Content(path, "weights", {"W": read_weights(path)})
    return Content(path, "motion", {"B": read_transforms(path)})


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
        "file", "kind", numbers, and "problems", a list of sentences.
    """
    arrays = content.arrays
    problems: list[str] = []
    if content.kind == "mesh":
        values = _mesh(arrays["V"], arrays["E"], problems)
    elif content.kind == "rig":
        values = _rig(arrays["C"], arrays["BE"], problems)
    elif content.kind == "weights":
        values = _weights(arrays["W"], problems)
    elif content.kind == "motion":
        values = _motion(arrays, others, problems)
    elif content.kind == "points":
        values = {"shape": list(arrays["x"].shape)}
        if arrays["x"].ndim != 2 or arrays["x"].shape[1] not in (2, 3):
            problems.append("points are rows of 2 or 3 coordinates")
    else:
        values = _model(arrays["model"], problems)
    return {"file": content.path, "kind": content.kind, **values, "problems": problems}


def _mesh(V: np.ndarray, E: np.ndarray, problems: list[str]) -> dict[str, Any]:
    d = V.shape[1]
    if d == 3 or E.shape[1] == 2:
        return {"d": d, "vertices": len(V), **describe_surface(V, E, problems)}
    a, b = V[E[:, 1]] - V[E[:, 0]], V[E[:, 2]] - V[E[:, 0]]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    F = boundary_facets(E[area > 0])
    values = describe_surface(V, F, problems, used=E)
    without = int((area <= 0).sum())
    if without:
        problems.append(f"{without} of {len(E)} triangles have no area")
    return {"d": d, "vertices": len(V), "triangles": len(E), **values, "triangles_without_area": without}


def _rig(C: np.ndarray, BE: np.ndarray, problems: list[str]) -> dict[str, Any]:
    flat = not C[:, 2].any()
    P = bone_parents(BE)
    length = np.linalg.norm(C[BE[:, 1]] - C[BE[:, 0]], axis=1)
    roots = int((P < 0).sum())
    shortest = int(length.argmin())
    unused = np.setdiff1d(np.arange(len(C)), BE)
    if len(unused):
        problems.append(f"{len(unused)} joints belong to no bone, joint {unused[0]} first")
    pieces = components(BE, len(C))
    if pieces > 1:
        problems.append(f"the rig is {pieces} separate skeletons")
    if length[shortest] < _SHORT_BONE * np.ptp(C, axis=0).max():
        problems.append(f"bone {shortest} is very short: {length[shortest]:.3g}")
    joined = len(C) - len(np.unique(C, axis=0))
    if joined:
        problems.append(f"{joined} joints lie exactly on another joint")
    return {
        "d": 2 if flat else 3,
        "joints": len(C),
        "bones": len(BE),
        "roots": roots,
        "shortest_bone": length[shortest],
        "longest_bone": length.max(),
        "lower": C.min(axis=0),
        "upper": C.max(axis=0),
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


def _motion(arrays: dict[str, Any], others: list[Content], problems: list[str]) -> dict[str, Any]:
    rig = next((other.arrays for other in others if other.kind == "rig"), None)
    if "theta" in arrays:
        theta, names = arrays["theta"], arrays["names"]
        turned = {"bones": len(names), "names": list(names), "d": arrays["root_translation"].shape[1]}
        return {"frames": len(theta), **turned, "rms_local_rotation": _rms_of_names(rig, names, theta)}
    B = arrays["B"]
    known = rig is not None and len(rig["BE"]) == B.shape[1]
    rms = _rms_of_transforms(rig["C"], rig["BE"], B) if rig is not None and known else None
    return {"frames": len(B), "bones": B.shape[1], **_rigidity(B, problems), "rms_local_rotation": rms}


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


def _rms_of_transforms(C: np.ndarray, BE: np.ndarray, B: np.ndarray) -> float | None:
    """Of the local rotations of all bones but the roots, in radians; None where the transforms have none."""
    P = bone_parents(BE)
    try:
        theta, _ = local_rotations(C, BE, P, B)
    except ValueError:
        return None
    return _rms(theta[:, P >= 0])


def _rms_of_names(rig: dict[str, Any] | None, names: tuple[str, ...], theta: np.ndarray) -> float | None:
    """The same of rotations by bone name; None where the rig is not known, and so neither are its roots."""
    if rig is None:
        return None
    P = bone_parents(rig["BE"])
    place = {f"bone{bone}": bone for bone in range(len(P))}
    if not set(names) <= place.keys():
        return None
    every = np.zeros((len(theta), len(P), theta.shape[2]))
    every[:, [place[name] for name in names]] = theta
    return _rms(every[:, P >= 0])


def _rms(theta: np.ndarray) -> float | None:
    return float(np.sqrt((theta**2).sum(axis=-1).mean())) if theta.size else None


def _model(model: Any, problems: list[str]) -> dict[str, Any]:
    c = model.character
    C = np.zeros((len(c.C), 3))
    C[:, : c.d] = c.C
    rms = model.motion.rms_rotation(c)
    motion = {"source": model.motion.source, "frames": len(model.motion), "rms_local_rotation": rms}
    motion["original_frames"] = [int(model.motion.frames.min()), int(model.motion.frames.max())]
    return {
        "name": c.name,
        "d": c.d,
        "mesh": {"vertices": len(c.V), **describe_surface(c.V, c.F, problems, used=c.T if c.d == 2 else None)},
        "rig": _rig(C, c.BE, problems),
        "weights": _weights(c.W, problems),
        "volume": {"vertices": len(c.V_volume), "elements": len(c.T)},
        "motion": {**motion, **_rigidity(model.motion.B, problems)},
        "training": {**model.config, "final_loss": model.history[-100:].mean() if len(model.history) else None},
    }
