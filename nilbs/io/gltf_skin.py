"""The skins of a glTF file, united into one skeleton at rest."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from nilbs.geometry.curves import LARGEST
from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints
from nilbs.io.gltf_document import Document
from nilbs.io.gltf_nodes import Nodes
from nilbs.io.names import unique_names

_CLOSE = 1e-4  # relative: skins whose matrices agree so well were bound in the same pose


@dataclass(frozen=True)
class Skin:
    """The bones of a skin's joints, and the maps (k, 4, 4) from its vertices to the world at rest, by joint.

    Where these `agree` the skin was bound in the rest pose.
    """

    bones: np.ndarray
    place: np.ndarray
    agree: bool


@dataclass(frozen=True)
class Rig:
    """The joints of all skins: none where there is no skin.

    `bone` is the bone of each joint's node, in the order of the bones; `rest` and `inverse` (b, 4, 4) are the joints'
    frames at rest; `above` and `relative` are the joint that each node hangs on, or -1, and its place there or in the
    world.
    """

    skeleton: Skeleton | None
    bone: dict[int, int]
    rest: np.ndarray
    inverse: np.ndarray
    skins: list[Skin]
    above: np.ndarray
    relative: np.ndarray
    notes: list[str]


def read_rig(file: Document, nodes: Nodes) -> Rig:
    """Unite the skins of a file; FileFormatError if a matrix is missing, singular or no affine map."""
    entries = file.entries("skins")
    lists = [_joints(file, nodes, entry, f"skin {i}") for i, entry in enumerate(entries)]
    is_joint = np.zeros(len(nodes.order), dtype=bool)
    for joints in lists:
        is_joint[joints] = True
    above, relative = nodes.below(is_joint)
    bone: dict[int, int] = {}
    rest: list[np.ndarray] = []
    inverse: list[np.ndarray] = []
    skins, notes = [], []
    for i, (entry, joints) in enumerate(zip(entries, lists, strict=True)):
        bind, unbind = _binds(file, entry, len(joints), f"skin {i}")
        members = set(joints)
        anchor = next((k for k, joint in enumerate(joints) if joint in bone), None)
        if anchor is not None:
            frame = rest[bone[joints[anchor]]]
        else:
            anchor = next(k for k, joint in enumerate(joints) if int(above[joint]) not in members)
            root = joints[anchor]
            holder = bone.get(int(above[root]))
            frame = nodes.world[root] if holder is None else rest[holder] @ relative[root]
        M = frame @ bind[anchor]
        known = len(rest)
        M_inverse = _inverses(file, M[None], f"skin {i}: the place of its root joint")[0]
        for k, joint in enumerate(joints):
            if joint not in bone:
                bone[joint] = len(rest)
                rest.append(M @ unbind[k])
                inverse.append(bind[k] @ M_inverse)
        bones = np.array([bone[joint] for joint in joints])
        place = np.array([rest[b] for b in bones.tolist()]) @ bind
        agree = bool(np.abs(place - M).max() <= _CLOSE * np.abs(M).max())
        if not agree:
            notes.append(f"skin {i} was bound in another pose than the skins before; its vertices are posed to fit")
        if not max(np.abs(m).max() for m in (place, *rest[known:], *inverse[known:])) < LARGEST:
            raise file.error(f"skin {i}: the frame of a joint is out of bounds")
        skins.append(Skin(bones, place, agree))
    R, R_inverse = (np.array(frames).reshape(-1, 4, 4) for frames in (rest, inverse))
    skeleton, renamed = _skeleton(nodes, bone, R, above) if bone else (None, ())
    return Rig(skeleton, bone, R, R_inverse, skins, above, relative, [*notes, *renamed])


def _skeleton(
    nodes: Nodes, bone: dict[int, int], rest: np.ndarray, above: np.ndarray
) -> tuple[Skeleton, tuple[str, ...]]:
    """The skeleton, and notes on its names."""
    names, renamed = unique_names(nodes.names[joint] or f"bone{b}" for joint, b in bone.items())
    parents = np.array([bone.get(int(above[joint]), -1) for joint in bone])
    ends: dict[int, np.ndarray] = {}
    for node, parent in enumerate(nodes.parent.tolist()):
        if parent in bone and node not in bone and nodes.names[node] == f"{nodes.names[parent]}_end":
            ends.setdefault(bone[parent], transform_points(rest[bone[parent]], nodes.local[node, :3, 3]))
    return skeleton_of_joints(rest[:, :3, 3], parents, names, ends=ends), renamed


def _joints(file: Document, nodes: Nodes, entry: dict[str, Any], where: str) -> list[int]:
    joints = file.indices(entry, "joints", where, len(nodes.order))
    if not joints or len(set(joints)) < len(joints):
        raise file.error(f"{where}: 'joints' must be a list of nodes, each once")
    return joints


def _binds(file: Document, entry: dict[str, Any], k: int, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Inverse bind matrices (k, 4, 4) of a skin, and their inverses."""
    if "inverseBindMatrices" not in entry:
        file.spend(16 * k, where)
        return np.tile(np.eye(4), (k, 1, 1)), np.tile(np.eye(4), (k, 1, 1))
    index = file.whole(entry, "inverseBindMatrices", where)
    numbers = file.accessor(index, f"{where}, inverse bind matrices", "MAT4")
    if len(numbers) < k:
        raise file.error(f"{where} has {k} joints but {len(numbers)} inverse bind matrices")
    bind = numbers[:k].reshape(k, 4, 4).transpose(0, 2, 1).copy()
    if not np.allclose(bind[:, 3], [0, 0, 0, 1], rtol=0, atol=1e-4):
        raise file.error(f"{where}: the last row of an inverse bind matrix is not (0, 0, 0, 1)")
    bind[:, 3] = [0, 0, 0, 1]
    return bind, _inverses(file, bind, f"{where}, inverse bind matrix")


def _inverses(file: Document, matrices: np.ndarray, where: str) -> np.ndarray:
    """Inverses of affine maps (k, 4, 4)."""
    stretch = np.linalg.svd(matrices[:, :3, :3], compute_uv=False)
    flat = np.flatnonzero(stretch[:, 2] <= np.maximum(1e-10 * stretch[:, 0], 1e-100))
    if len(flat):
        raise file.error(f"{where}{f' {flat[0]}' if len(matrices) > 1 else ''}: it is singular, it has no inverse")
    return np.linalg.inv(matrices)
