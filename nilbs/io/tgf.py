"""Skeletons: libigl's `.tgf` files, joints and the bones between them."""

import os
import re

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.geometry.skeleton import Skeleton, skeleton_of_bones
from nilbs.geometry.validation import arrays, check_indices, listed
from nilbs.io.atomic import replacing
from nilbs.io.bounded import line_blocks
from nilbs.io.bundle import Bundle
from nilbs.io.errors import FileFormatError
from nilbs.io.joints import joint_in_circle
from nilbs.io.words import finite_numbers

_INDEX = re.compile(rb"\d{1,9}")


def read_tgf(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    r"""Read the joints and bones of a skeleton.

    Parameters
    ----------
    path : str or path
        The file: a line a joint (an index, x, y, z, then columns that are left out), a line `#`, a line a bone (the
        indices of its two joints, parent first), and what may follow another `#`, left out. As libigl writes them,
        columns behind the joints state whether an edge is a bone, a pseudo-edge and a cage edge: 1 or 0. One column
        alone is a label.

    Returns
    -------
    C : (k, 3) float array
        Joints in the file's order and units; z is 0 in a flat rig.
    BE : (b, 2) int array
        Indices into C: point handles first, as in libigl, the joints of no bone, each twice; then bones in the file's
        order. The joints of a bone may be at one place.

    Raises
    ------
    FileFormatError
        With the line, if a joint has no three finite coordinates or an index used before; if there is no bone and no
        point handle, a bone has an unknown joint, a joint ends two bones, bones run in a circle, or there is a cage
        edge.
    OSError
        If the file cannot be read.

    References
    ----------
    .. [1] libigl, file formats, https://libigl.github.io/file-formats/tgf/.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "rig.tgf"
    >>> _ = path.write_text("1 0 0 0\n2 1 0 0\n3 1 1 0\n4 5 0 0\n#\n1 2\n2 3\n#\n")
    >>> read_tgf(path)[1]
    array([[3, 3],
           [0, 1],
           [1, 2]])
    """
    C, BE, _ = _read(path)
    return C, BE


def read_tgf_rig(path: str | os.PathLike) -> Bundle:
    """Read a skeleton as `read_tgf`, with notes on point handles and on edges that are no bones."""
    C, BE, notes = _read(path)
    return Bundle(skeleton=skeleton_of_bones(C, BE), notes=notes)


def _read(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    joints: dict[int, int] = {}
    C: list[np.ndarray] = []
    BE: list[list[int]] = []
    lines: list[int] = []
    others: dict[str, list[int]] = {"pseudo-edges": [], "edges that are no bones": []}  # the lines of each kind
    section = 0
    for first, block in line_blocks(path):
        for number, line in enumerate(block, first):
            words = line.split()
            if words and words[0].startswith(b"#"):
                section += 1
            elif words and section == 0:
                index, position = _joint(path, words, number)
                if index in joints:
                    raise FileFormatError(path, f"a second joint {index}", number)
                joints[index] = len(C)
                C.append(position)
            elif words and section == 1:
                ends, is_bone, kind = _edge(path, words, joints, number)
                if kind:
                    others[kind].append(number)
                if is_bone:
                    BE.append(ends)
                    lines.append(number)
    points = sorted(set(range(len(C))) - {end for ends in BE for end in ends})
    if not BE and not (points and section):
        raise FileFormatError(path, "the rig has no bone")
    bones = np.array(BE, np.int64).reshape(-1, 2)
    _check_tree(path, bones, list(joints), lines)
    notes = [f"{kind} are left out: {len(at)}, in line {at[0]} first" for kind, at in others.items() if at]
    if points:
        of = [f"point{k} (joint {list(joints)[point]})" for k, point in enumerate(points)]
        notes.append(f"joints of no bone are point handles, with weights of their own ({len(points)}): {listed(of)}")
    handles = np.repeat(np.array(points, np.int64)[:, None], 2, axis=1)
    return np.array(C), np.concatenate([handles, bones]), tuple(notes)


def write_tgf(path: str | os.PathLike, C: np.ndarray, BE: np.ndarray) -> None:
    """Write a skeleton, with every digit.

    Parameters
    ----------
    path : str or path
        The file.
    C : (k, d) float array
        Joints; written with z = 0 where d is 2. Those of no bone are read as point handles.
    BE : (b, 2) int array
        Indices into C: bones, and before them point handles, if any, each a joint twice.

    Raises
    ------
    ValueError
        If C and BE disagree, or the file could not hold point handles in this order.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/rig.tgf"
    >>> write_tgf(path, [[0, 0], [1, 0]], [[0, 1]])
    >>> with open(path) as file:
    ...     print(file.read().strip())
    1 0.0 0.0 0.0
    2 1.0 0.0 0.0
    #
    1 2
    #
    """
    C, BE = arrays(C=(C, "k d"), BE=(BE, "b 2", int))
    check_indices("BE", BE, len(C), "joints")
    points = np.flatnonzero(BE[:, 0] == BE[:, 1])
    bones = np.delete(BE, points, axis=0)
    if np.any(points >= len(points)) or np.any(np.diff(BE[points, 0]) <= 0) or np.isin(BE[points], bones).any():
        raise ValueError("BE: point handles, a joint twice, come before bones, ascending, and are joints of no bone")
    with replacing(path, "w") as file:
        for index, position in enumerate(in_space(C).tolist(), 1):
            file.write(" ".join([str(index), *map(str, position)]) + "\n")
        file.write("#\n")
        file.writelines(f"{parent} {child}\n" for parent, child in (bones + 1).tolist())
        file.write("#\n")


def write_tgf_skeleton(path: str | os.PathLike, skeleton: Skeleton) -> tuple[str, ...]:
    """Write a skeleton; return notes on the names and parents that the file does not hold.

    Where a bone does not start at the joint where its parent, and no other bone, ends, it gets a joint of its own.

    Examples
    --------
    >>> import tempfile
    >>> hat_apart = Skeleton([[0, 0], [0, 1], [0, 2], [0, 3]], [[0, 1], [2, 3]], [-1, 0], ["bone0", "bone1"])
    >>> write_tgf_skeleton(tempfile.mkdtemp() + "/rig.tgf", hat_apart)
    ("a .tgf file holds no parent that ends where its child does not start: read as roots: 'bone1'",)
    """
    C, BE = _shared_joints(skeleton)
    write_tgf(path, C, BE)
    notes, read = [], skeleton_of_bones(C, BE)
    if read.names != skeleton.names:
        notes.append("a .tgf file holds no names: bones are read as bone0, bone1, ...")
    lost = np.flatnonzero(read.P != skeleton.P)
    if len(lost):
        roots = listed([repr(skeleton.names[bone]) for bone in lost])
        notes.append(f"a .tgf file holds no parent that ends where its child does not start: read as roots: {roots}")
    return tuple(notes)


def _shared_joints(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Joints (k, d) and bones (b, 2) of which `bone_parents` gives the skeleton's parents, wherever places allow.

    Point handles that come first are one joint twice.
    """
    points = len(skeleton.points)
    if np.array_equal(skeleton.points, np.arange(points)) and points:
        if points == len(skeleton.P):
            return skeleton.C[skeleton.BE[:, 0]], np.repeat(np.arange(points)[:, None], 2, axis=1)
        P, names = skeleton.P[points:], skeleton.names[points:]
        C, BE = _shared_joints(Skeleton(skeleton.C, skeleton.BE[points:], np.maximum(P - points, -1), names))
        handles = np.repeat(np.arange(points)[:, None], 2, axis=1)
        return np.concatenate([skeleton.C[skeleton.BE[:points, 0]], C]), np.concatenate([handles, BE + points])
    C, BE, P = skeleton.C, skeleton.BE, skeleton.P
    ends_once = (BE[:, 0] != BE[:, 1]).all() and len(np.unique(BE[:, 1])) == len(BE)
    # Two bones that each start where the other ends are a circle of joints, not of parents.
    start_at = np.isin(BE[:, 0], BE[:, 1])
    if ends_once and (BE[start_at, 0] == BE[P[start_at], 1]).all() and (start_at == (P >= 0)).all():
        used, place = np.unique(BE, return_inverse=True)  # a joint of no bone would be a point handle
        return C[used], place.reshape(BE.shape)
    # Joint t is where bone t ends; behind them come the joints where bones start that their parents do not lead to.
    joined = (P >= 0) & (C[BE[:, 0]] == C[BE[P, 1]]).all(axis=1)
    starts, place = np.unique(BE[~joined, 0], return_inverse=True)
    bones = np.stack([P, np.arange(len(P))], axis=1)
    bones[~joined, 0] = len(P) + place
    return np.concatenate([C[BE[:, 1]], C[starts]]), bones


def _joint(path: str | os.PathLike, words: list[bytes], line: int) -> tuple[int, np.ndarray]:
    if len(words) < 4 or not _INDEX.fullmatch(words[0]):
        raise FileFormatError(path, "a joint needs an index and three coordinates", line)
    return int(words[0]), finite_numbers(path, words[1:4], [line])[0]


def _edge(
    path: str | os.PathLike, words: list[bytes], joints: dict[int, int], line: int
) -> tuple[list[int], bool, str | None]:
    """The joints of an edge, whether it is a bone, and what else it is."""
    if len(words) < 2 or not all(_INDEX.fullmatch(word) for word in words[:2]):
        raise FileFormatError(path, "a bone needs the indices of two joints", line)
    ends = [int(word) for word in words[:2]]
    for end in ends:
        if end not in joints:
            raise FileFormatError(path, f"the bone refers to joint {end}, which the file does not have", line)
    flags = [word == b"1" for word in words[2:5] if word in (b"0", b"1")]
    is_bone, pseudo, cage = [*flags, False][:3] if 2 <= len(flags) == len(words[2:5]) else (True, False, False)
    if cage:
        message = f"joints {ends[0]} and {ends[1]} are a cage edge, along which weights are not solved for"
        raise FileFormatError(path, f"{message}: leave it out, and its joints are point handles", line)
    kind = "pseudo-edges" if pseudo else None if is_bone else "edges that are no bones"
    return [joints[end] for end in ends], is_bone, kind


def _check_tree(path: str | os.PathLike, BE: np.ndarray, names: list[int], lines: list[int]) -> None:
    """Check that every joint ends one bone at most and that no bone is its own ancestor."""
    into: dict[int, int] = {}
    for bone, (_, tip) in enumerate(BE.tolist()):
        if tip in into:
            message = f"joint {names[tip]} is the end of two bones, here and in line {lines[into[tip]]}"
            raise FileFormatError(path, message, lines[bone])
        into[tip] = bone
    circle = joint_in_circle(np.array([into.get(base, -1) for base in BE[:, 0].tolist()]))
    if circle is not None:
        raise FileFormatError(path, "bones run in a circle", lines[circle])
