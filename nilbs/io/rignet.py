"""RigNet's text files of rigs: joints, their parents and painted weights."""

import os
import re

import numpy as np

from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays, listed
from nilbs.io.atomic import replacing
from nilbs.io.bounded import line_blocks
from nilbs.io.bundle import Bundle, Influences
from nilbs.io.errors import FileFormatError
from nilbs.io.joints import first_joints, joint_in_circle, skeleton_with_ends, written_ends
from nilbs.io.names import text_of, unique_names, written_names
from nilbs.io.words import finite_numbers

_INDEX = re.compile(rb"\d{1,18}")
_END = "_end"


def read_rignet(path: str | os.PathLike) -> Bundle:
    """Read a rig as RigNet [1]_ writes it: bones are joints.

    Lines may come in any order: `joints NAME x y z`, `root NAME`, `hier PARENT CHILD`, and for a vertex (from 0)
    `skin VERTEX NAME WEIGHT NAME WEIGHT ...`. A joint without children and without weights that is called as its
    parent with `_end` behind is where its parent ends, and no bone. Notes name joints that became roots.

    References
    ----------
    .. [1] Xu et al., RigNet: Neural Rigging for Articulated Characters, 2020, arXiv:2005.00559.
    """
    joints: dict[bytes, int] = {}
    positions: list[np.ndarray] = []
    named: dict[bytes, int] = {}  # every name that another line needs, numbered
    named_in: list[int] = []  # its line
    roots: set[bytes] = set()
    hier: dict[bytes, tuple[bytes, int]] = {}
    vertex: list[int] = []
    bone: list[int] = []
    weight = [np.zeros((0, 1))]

    def name_id(name: bytes, line: int) -> int:
        if name not in named:
            named_in.append(line)
        return named.setdefault(name, len(named))

    notes: list[str] = []
    for first, block in line_blocks(path, notes):
        weights: list[bytes] = []
        weights_in: list[int] = []  # their lines
        for number, line in enumerate(block, first):
            words = line.split()
            kind = words[0] if words else b""
            if kind == b"skin":
                pairs = len(words) // 2 - 1
                if len(words) % 2 or not _INDEX.fullmatch(words[1]):
                    message = "skin needs a vertex (from 0), then for each of its joints a name and a weight"
                    raise FileFormatError(path, message, number)
                vertex += [int(words[1])] * pairs
                bone += [name_id(name, number) for name in words[2::2]]
                weights += words[3::2]
                weights_in += [number] * pairs
            elif kind == b"joints":
                if len(words) != 5:
                    raise FileFormatError(path, "joints needs a name without spaces and three numbers", number)
                if words[1] in joints:
                    raise FileFormatError(path, f"a second joint {_quoted(words[1])}", number)
                joints[words[1]] = len(joints)
                positions.append(finite_numbers(path, words[2:], [number])[0])
            elif kind == b"hier":
                if len(words) != 3:
                    raise FileFormatError(path, "hier needs a parent and its child", number)
                _, parent, child = words
                name_id(parent, number)
                name_id(child, number)
                if child in hier:
                    message = f"joint {_quoted(child)} has two parents, here and in line {hier[child][1]}"
                    raise FileFormatError(path, message, number)
                hier[child] = parent, number
            elif kind == b"root":
                if len(words) != 2:
                    raise FileFormatError(path, "root needs the name of a joint", number)
                name_id(words[1], number)
                roots.add(words[1])
            elif words:
                message = f"a line of a rig starts with joints, root, hier or skin, not {_quoted(kind)}"
                raise FileFormatError(path, message, number)
        if weights:
            weight.append(finite_numbers(path, weights, weights_in))
    if not joints:
        raise FileFormatError(path, "the rig has no joint")
    for name, line_number in zip(named, named_in, strict=True):
        if name not in joints:
            meant = nearest_name(text_of(name), map(text_of, joints))
            raise FileFormatError(path, f"the file has no joint {_quoted(name)}{meant}", line_number)
    P = np.array([joints[hier[name][0]] if name in hier else -1 for name in joints])
    circle = joint_in_circle(P)
    if circle is not None:
        name = list(joints)[circle]
        raise FileFormatError(path, f"joint {_quoted(name)} is its own ancestor", hier[name][1])
    for name, (_, line_number) in hier.items():
        if name in roots:
            raise FileFormatError(path, f"the root {_quoted(name)} has a parent", line_number)
    joint_of_id = np.array([joints[name] for name in named], dtype=np.int64)
    skinned = joint_of_id[np.array(bone, dtype=np.int64)]
    skeleton, bone_of = _skeleton(list(joints), np.array(positions), P, set(skinned.tolist()))
    others = [_quoted(name) for name, parent in zip(joints, P, strict=True) if parent < 0 and name not in roots]
    if others:
        notes.append(f"joints without a parent, taken as roots: {listed(others)}")
    return Bundle(
        skeleton=skeleton,
        influences=Influences(np.array(vertex), bone_of[skinned], np.concatenate(weight)[:, 0]) if vertex else None,
        notes=tuple(notes),
    )


def write_rignet(path: str | os.PathLike, skeleton: Skeleton, W: np.ndarray | None = None) -> tuple[str, ...]:
    """Write a rig as RigNet does, with every digit and z = 0 in the plane; return notes on names that were changed.

    A bone that does not end where its children start gets a joint with `_end` behind its name: ValueError if another
    bone has that name. Weights W (n, b) that are zero are not written.
    """
    if W is not None:
        (W,) = arrays(W=(W, f"n {len(skeleton.BE)}"))
    names, notes = written_names(skeleton.names, r"\s")
    P = skeleton.P.tolist()
    taken, inner = set(names), set(P)
    start = first_joints(skeleton)
    end, needed = written_ends(skeleton)
    joints = list(zip(names, start.tolist(), strict=True))
    below = [(names[parent], name) for name, parent in zip(names, P, strict=True) if parent >= 0]
    for bone, name in enumerate(names):
        # A bone that looks like the end of its parent is a bone again where it has an end of its own.
        alike = P[bone] >= 0 and bone not in inner and name == names[P[bone]] + _END
        if needed[bone] or alike:
            if name + _END in taken:
                raise ValueError(
                    f"bone {name!r} needs a joint {name + _END!r} where it ends: rename the bone so called"
                )
            joints.append((name + _END, end[bone].tolist()))
            below.append((name, name + _END))
    with replacing(path, "w") as file:
        file.writelines(f"joints {name} {x} {y} {z}\n" for name, (x, y, z) in joints)
        file.writelines(f"root {name}\n" for name, parent in zip(names, P, strict=True) if parent < 0)
        file.writelines(f"hier {parent} {child}\n" for parent, child in below)
        for vertex, row in enumerate(() if W is None else W):
            moved = "".join(f" {names[bone]} {row[bone]}" for bone in np.flatnonzero(row))
            if moved:
                file.write(f"skin {vertex}{moved}\n")
    return notes


def _skeleton(
    names: list[bytes], positions: np.ndarray, P: np.ndarray, skinned: set[int]
) -> tuple[Skeleton, np.ndarray]:
    """The skeleton of the joints that are not ends, and the bone of every joint."""
    moving = set(P.tolist()) | skinned
    ends = {
        joint: parent
        for joint, parent in enumerate(P.tolist())
        if parent >= 0 and joint not in moving and names[joint] == names[parent] + _END.encode()
    }
    kept = np.array([joint not in ends for joint in range(len(names))])
    bone_of = np.cumsum(kept) - 1
    texts, _ = unique_names(text_of(name) for name, keep in zip(names, kept, strict=True) if keep)
    parents = np.where(P >= 0, bone_of[P], -1)[kept]
    given = {int(bone_of[parent]): positions[joint] for joint, parent in ends.items()}
    return skeleton_with_ends(positions[kept], parents, texts, given), bone_of


def _quoted(name: bytes) -> str:
    return repr(text_of(name)[:60])
