"""Body models of the SMPL family as `.npz` files: the mean body, its joints and their weights."""

import os

import numpy as np

from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io.bundle import Bundle, Influences, Mesh
from nilbs.io.errors import FileFormatError
from nilbs.io.joints import joint_in_circle
from nilbs.io.npz import NpzFile

_BODY = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
_FINGERS = [f"{finger}{number}" for finger in ("index", "middle", "pinky", "ring", "thumb") for number in (1, 2, 3)]
_HANDS = [f"{side}_{finger}" for side in ("left", "right") for finger in _FINGERS]
# Names of the joints, by their number, as the published models and data sets call them.
JOINTS = {
    22: _BODY,
    24: (*_BODY, "left_hand", "right_hand"),  # SMPL
    52: (*_BODY, *_HANDS),  # SMPL+H
    55: (*_BODY, "jaw", "left_eye_smplhf", "right_eye_smplhf", *_HANDS),  # SMPL-X
}
_BODY_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
_CORRECTIVES = ("posedirs", "shapedirs")
_UNSIGNED = 2**31  # a parent from here on is -1 that lost its sign


def read_smpl(path: str | os.PathLike) -> Bundle:
    """Read a body model [1]_: the mean body at rest, with bones called pelvis, left_hip, ... in the trees of `JOINTS`.

    In any other tree they are called joint0, joint1, ...

    A `.npz` file has `v_template` (n, 3), `f` (m, 3), `weights` (n, b), `kintree_table` (2, b), whose first row holds
    the joints' parents, and the joints: `J_regressor` (b, n), which takes them from the vertices, as one array or as
    scipy's `J_regressor_data`, `_indices`, `_indptr` and `_shape`, or else `J` (b, 3). No pickle is read, so nothing in
    the file is run. Notes list the correctives that are left out.

    References
    ----------
    .. [1] Loper et al., SMPL: A skinned multi-person linear model, SIGGRAPH Asia 2015, doi:10.1145/2816795.2818013.
    """
    file = NpzFile(path)
    V = _array(file, "v_template", (None, 3))
    n = len(V)
    weights = _array(file, "weights", (n, None))
    b = weights.shape[1]
    faces = _indices(file, "f", (None, 3), n, "vertices")
    vertex, bone = np.nonzero(weights)
    left_out = [name for name in _CORRECTIVES if name in file.names]
    P = _parents(file, b)
    known = b in JOINTS and P.tolist() == joint_parents(b)
    names = JOINTS[b] if known else [f"joint{joint}" for joint in range(b)]
    note = f"{' and '.join(left_out)} left out: the body bends by its weights alone, without correctives"
    return Bundle(
        mesh=Mesh(V, faces),
        skeleton=skeleton_of_joints(_joints(file, V, b), P, names),
        influences=Influences(vertex, bone, weights[vertex, bone]),
        notes=(note,) if left_out else (),
    )


def joint_parents(k: int) -> list[int]:
    """The parents of the first k joints of `JOINTS`, -1 at the root.

    Examples
    --------
    >>> [JOINTS[24][joint] for joint in joint_parents(24)[-2:]]
    ['left_wrist', 'right_wrist']
    """
    names = JOINTS[k]
    place = {name: joint for joint, name in enumerate(names)}
    parents = [*_BODY_PARENTS]
    for name in names[len(_BODY) :]:
        side, _, finger = name.partition("_")
        above = f"{side}_{finger[:-1]}{int(finger[-1]) - 1}" if finger in _FINGERS else ""
        parents.append(place.get(above, place["head" if "eye" in name or name == "jaw" else f"{side}_wrist"]))
    return parents


def _array(file: NpzFile, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    A = file.array(name)
    fits = A.ndim == len(shape) and all(size in (None, got) for size, got in zip(shape, A.shape, strict=True))
    if not fits or not A.size:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise FileFormatError(file.path, f"{name} must be ({wanted}), this file holds {A.shape}")
    return A


def _indices(file: NpzFile, name: str, shape: tuple[int | None, ...], size: int, of: str) -> np.ndarray:
    A = _array(file, name, shape)
    bad = (A < 0) | (size <= A) | (A % 1 != 0)
    if bad.any():
        raise FileFormatError(file.path, f"{name} holds {A[bad][0]:g}, which is none of the {size} {of}")
    return A.astype(np.int64)


def _parents(file: NpzFile, b: int) -> np.ndarray:
    parent, joint = _array(file, "kintree_table", (2, b))
    column = {number: at for at, number in enumerate(joint.tolist())}
    P = np.full(b, -1)
    for at, number in enumerate(parent.tolist()):
        if 0 <= number < _UNSIGNED and number != joint[at]:  # a root may be its own parent
            if number not in column:
                raise FileFormatError(file.path, f"kintree_table names the parent {number:g}, which is no joint")
            P[at] = column[number]
    circle = joint_in_circle(P)
    if circle is not None:
        raise FileFormatError(file.path, f"kintree_table makes joint {circle} its own ancestor")
    return P


def _joints(file: NpzFile, V: np.ndarray, b: int) -> np.ndarray:
    n = len(V)
    with np.errstate(over="ignore", invalid="ignore"):
        if "J_regressor" in file.names:
            J = _array(file, "J_regressor", (b, n)) @ V
        elif "J_regressor_data" in file.names:
            row, column, value = _sparse(file, b, n)
            J = np.zeros((b, 3))
            np.add.at(J, row, value[:, None] * V[column])
        else:
            J = _array(file, "J", (b, 3))
    if not np.isfinite(J).all():
        raise FileFormatError(file.path, "the joints are farther apart than numbers go")
    return J


def _sparse(file: NpzFile, b: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of J_regressor, stored by rows or by columns."""
    if _array(file, "J_regressor_shape", (2,)).tolist() != [b, n]:
        raise FileFormatError(file.path, f"J_regressor must be ({b}, {n})")
    value = _array(file, "J_regressor_data", (None,))
    ends = _indices(file, "J_regressor_indptr", (None,), len(value) + 1, "ends of a row")
    if len(ends) not in (b + 1, n + 1) or ends[0] != 0 or ends[-1] != len(value) or (np.diff(ends) < 0).any():
        raise FileFormatError(file.path, "J_regressor_indptr does not cut J_regressor_data into rows or columns")
    by_rows = len(ends) == b + 1
    index = _indices(file, "J_regressor_indices", (len(value),), n if by_rows else b, "vertices or joints")
    stored = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    return (stored, index, value) if by_rows else (index, stored, value)
