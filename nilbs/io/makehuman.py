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
    r"""Read a skeleton and place it in a mesh.

    Parameters
    ----------
    path : str or path
        A `.mhskel` file: JSON with `bones`, each with the names of its `head` and `tail` and of its `parent` or null,
        and `joints`, the lists of vertices (from 0) in whose mean each of them lies.
    V : (n, 3) float array
        Vertices of the whole mesh that the file was made for, with all its groups.

    Returns
    -------
    skeleton : Skeleton
        Bones in the file's order, from head to tail; one joint for every name of a joint that a bone uses.

    Raises
    ------
    FileFormatError
        Naming the bone or joint, if a part is missing, V has no such vertex, or bones run in a circle.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "arm.mhskel"
    >>> text = '{"bones": {"arm": {"head": "a", "tail": "b", "parent": null}}, "joints": {"a": [0], "b": [1, 2]}}'
    >>> _ = path.write_text(text)
    >>> read_mhskel(path, [[0, 0, 0], [1, 0, 0], [1, 2, 0]]).C
    array([[0., 0., 0.],
           [1., 1., 0.]])
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
    r"""Read weights.

    Parameters
    ----------
    path : str or path
        A `.mhw` file: JSON with `weights`, for every bone a list of pairs of a vertex (from 0) and its weight.
    names : sequence of str
        The rig's bones. Those that the file leaves out move nothing.

    Returns
    -------
    influences : Influences
        Rows are vertices of the whole mesh, columns the bones of `names`.

    Raises
    ------
    FileFormatError
        Naming the bone, if the rig does not have it or its list holds anything else than such pairs.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "arm.mhw"
    >>> _ = path.write_text('{"weights": {"hand": [[0, 0.5], [2, 1]]}}')
    >>> read_mhw(path, ["arm", "hand"]).dense(3, 2, path).tolist()
    [[0.0, 0.5], [0.0, 0.0], [0.0, 1.0]]
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
    r"""The weights that a `.mhskel` file names, where they lie beside it.

    Parameters
    ----------
    path : str or path
        The `.mhskel` file.

    Returns
    -------
    weights : str or None
        Path of the `.mhw` file; None where the file names none, or none that is in its own folder.

    Raises
    ------
    FileFormatError
        If the file is no JSON.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "arm.mhskel").write_text('{"weights_file": "arm.mhw"}')
    >>> weights_file(folder / "arm.mhskel") is None
    True
    >>> (folder / "arm.mhw").touch()
    >>> pathlib.Path(weights_file(folder / "arm.mhskel")).name
    'arm.mhw'
    """
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
