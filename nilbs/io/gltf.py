"""Characters in glTF 2.0 files: meshes, skins, weights and animations."""

import os

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.geometry.rotations import transform_points
from nilbs.io.bundle import Bundle, Mesh
from nilbs.io.gltf_animation import clips, read_animations
from nilbs.io.gltf_document import Document
from nilbs.io.gltf_mesh import read_meshes
from nilbs.io.gltf_nodes import Nodes, read_nodes
from nilbs.io.gltf_skin import Rig, read_rig

_CLOSE = 1e-4  # of the character's size: how well the nodes' pose must agree with the pose at binding


def read_gltf(path: str | os.PathLike) -> Bundle:
    """Read the mesh, skeleton, weights and motions of a `.glb` or `.gltf` file [1]_.

    Buffers are read from the file, or from files beside it or in folders below. The mesh is all triangles of the file's
    scene, one primitive after the other, grouped by the names of their nodes and meshes; seams stay split. Bone j is
    joint j of the first skin; other skins add those of their joints that are new. A clip keeps the curves of all nodes
    that move a joint; its frames stand at the union of their key times. Morph targets are left out.

    A skin poses a vertex v by the joints' transforms G_j(t) and inverse bind matrices IBM_j: sum_j w_j G_j(t) IBM_j v.
    The rest pose is the pose at binding, placed in the world by the skin's first root joint: with M = G_root(rest)
    IBM_root, rest vertices are M v, joint frames R_j = M IBM_j^-1, and bones move by B_j(t) = G_j(t) R_j^-1. B is the
    identity where the file's nodes stand in the pose at binding. A further skin is placed by the first joint that it
    shares with those before, else by the joint above its root. A mesh without a skin follows the joint that it hangs
    on; one that hangs on none follows the first root.

    References
    ----------
    .. [1] Khronos Group, glTF 2.0 specification, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, 3.7.3.
    """
    file = Document(path)
    nodes = read_nodes(file)
    rig = read_rig(file, nodes)
    animations, notes = read_animations(file, nodes, list(rig.bone))
    found = clips(file, nodes, rig, animations)
    mesh, influences, more = read_meshes(file, nodes, rig)
    if mesh is None and rig.skeleton is None:
        raise file.error("it holds neither a mesh of triangles nor a skin")
    notes = rig.notes + notes + more
    if _posed(nodes, rig, mesh):
        notes.append("its nodes do not stand in the pose at binding; that one is the rest pose")
    return Bundle(mesh, rig.skeleton, influences, found, tuple(dict.fromkeys(notes)))


def _posed(nodes: Nodes, rig: Rig, mesh: Mesh | None) -> bool:
    """Whether the pose in which the nodes stand differs from the rest pose."""
    if rig.skeleton is None:
        return False
    points = rig.rest[:, :3, 3] if mesh is None else in_space(mesh.V)
    box = np.stack([points.min(axis=0), points.max(axis=0)])
    B = nodes.world[list(rig.bone)] @ rig.inverse
    return bool(np.abs(transform_points(B[:, None], box) - box).max() > _CLOSE * np.ptp(box, axis=0).max())
