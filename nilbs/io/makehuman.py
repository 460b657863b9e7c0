"""MakeHuman's rigs: `.mhskel` skeletons, whose joints are means of a mesh's vertices, and `.mhw` weights."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays
from nilbs.io.bundle import Influences
from nilbs.io.errors import FileFormatError
from nilbs.io.joints import joint_in_circle
from nilbs.io.strict_json import finite_vector, read_json

_LARGEST_VERTEX = 2**53


def read_mhskel(path: str | os.PathLike, V: np.ndarray) -> Skeleton:
    """Read a `.mhskel` skeleton and place it in V (n, 3), the vertices of the whole mesh that it was made for.

    The file is JSON with `bones`, each with the names of its `head` and `tail` and of its `parent` or null, and
    `joints`, the lists of vertices (from 0) in whose mean each of them lies. Bones are in the file's order, from head
    to tail.
    """
    (V,) = arrays(V=(V, "n 3"))
    content = _object(path, read_json(path), "the file")
    bones = {name: _object(path, bone, f"bone {name[:60]!r}") for name, bone in _member(path, content, "bones").items()}
    joints = _member(path, content, "joints")
    if not bones:
        raise FileFormatError(path, "the rig has no bone")
    index = {name: bone for bone, name in enumerate(bones)}
    used: dict[str, int] = {}
    BE, P = np.zeros((len(bones), 2), dtype=np.int64), np.full(len(bones), -1)
    for bone, (name, parts) in enumerate(bones.items()):
        # Line ends and control characters would break the files and the tables that names are written to.
        if not name.isprintable():
            raise FileFormatError(path, f"the name {name[:60]!r} holds characters that cannot be shown")
        for side, key in enumerate(("head", "tail")):
            joint = parts.get(key)
            if not isinstance(joint, str) or joint not in joints:
                raise FileFormatError(path, f"bone {name[:60]!r} needs a {key} that is one of the joints")
            BE[bone, side] = used.setdefault(joint, len(used))
        parent = parts.get("parent")
        if parent is not None:
            if not isinstance(parent, str) or parent not in index:
                raise FileFormatError(path, f"bone {name[:60]!r} needs a parent that is one of the bones, or null")
            P[bone] = index[parent]
    circle = joint_in_circle(P)
    if circle is not None:
        raise FileFormatError(path, f"bone {list(bones)[circle][:60]!r} is its own ancestor")
    C = [V[_vertices(path, joints[joint], joint, len(V))].mean(axis=0) for joint in used]
    return Skeleton(np.array(C), BE, P, tuple(bones))


def read_mhw(path: str | os.PathLike, names: Sequence[str]) -> Influences:
    """Read a `.mhw` file: JSON with `weights`, for every bone a list of pairs of a vertex (from 0) and its weight.

    Columns are the bones of `names`; those that the file leaves out move nothing.
    """
    index = {name: bone for bone, name in enumerate(names)}
    pairs: list[list[float]] = []
    bone: list[int] = []
    for name, found in _member(path, _object(path, read_json(path), "the file"), "weights").items():
        if name not in index:
            raise FileFormatError(path, f"weights of bone {name[:60]!r}, which the rig does not have")
        for pair in found if isinstance(found, list) else [found]:
            numbers = finite_vector(pair, 2)
            if numbers is None or not 0 <= numbers[0] <= _LARGEST_VERTEX or numbers[0] % 1:
                message = f"bone {name[:60]!r} needs a list of pairs, each of a vertex (from 0) and its weight"
                raise FileFormatError(path, message)
            pairs.append(numbers)
            bone.append(index[name])
    values = np.array(pairs).reshape(-1, 2)
    return Influences(values[:, 0].astype(np.int64), np.array(bone, dtype=np.int64), values[:, 1])


def weights_file(path: str | os.PathLike) -> str | None:
    """The path of the `.mhw` file that a `.mhskel` file names, if it lies in the same folder."""
    name = _object(path, read_json(path), "the file").get("weights_file")
    folder = Path(path).parent
    # Looked up among the files there, so that no name leads elsewhere.
    return os.fspath(folder / name) if isinstance(name, str) and name in os.listdir(folder) else None


def _object(path: str | os.PathLike, value: object, what: str) -> dict:
    if not isinstance(value, dict):
        raise FileFormatError(path, f"{what} must be an object")
    return value


def _member(path: str | os.PathLike, content: dict, name: str) -> dict:
    return _object(path, content.get(name), f'"{name}"')


def _vertices(path: str | os.PathLike, value: object, joint: str, n: int) -> list[int]:
    indices = value if isinstance(value, list) else []
    if not indices or not all(isinstance(i, int) and not isinstance(i, bool) for i in indices):
        raise FileFormatError(path, f"joint {joint[:60]!r} needs a list of vertices")
    bad = next((i for i in indices if not 0 <= i < n), None)
    if bad is not None:
        message = f"joint {joint[:60]!r} needs vertex {str(bad)[:20]}, but the mesh has {n}: it must be the whole mesh"
        raise FileFormatError(path, f"{message} that the rig was made for")
    return indices
