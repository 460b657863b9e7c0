"""Meshes with a colour for each vertex as one .glb file, through trimesh."""

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.io.atomic import replacing


class ColouredMesh(NamedTuple):
    """A mesh of a scene.

    Attributes
    ----------
    name : str
        Of its node.
    V, E : (n, d) float array and (m, 3) int array
        Vertices and triangles.
    colour : (n, 3) uint8 array
        Red, green and blue of each vertex.
    offset : (3,) float array
        Where its node stands.
    """

    name: str
    V: np.ndarray
    E: np.ndarray
    colour: np.ndarray
    offset: np.ndarray


def write_coloured_meshes(path: str | os.PathLike, meshes: Sequence[ColouredMesh]) -> None:
    """Write meshes as the nodes of one .glb file, which no animation moves; at least one mesh.

    Examples
    --------
    >>> import tempfile, trimesh
    >>> path = tempfile.mkdtemp() + "/triangle.glb"
    >>> colour = np.array([[255, 0, 0]] * 3, dtype=np.uint8)
    >>> write_coloured_meshes(path, [ColouredMesh("red", np.eye(3), np.array([[0, 1, 2]]), colour, np.zeros(3))])
    >>> trimesh.load(path).geometry["red"].visual.vertex_colors[0].tolist()
    [255, 0, 0, 255]
    """
    import trimesh

    scene = trimesh.Scene()
    for mesh in meshes:
        shape = trimesh.Trimesh(in_space(mesh.V), mesh.E, process=False, vertex_colors=mesh.colour)
        place = np.eye(4)
        place[:3, 3] = mesh.offset
        scene.add_geometry(shape, node_name=mesh.name, geom_name=mesh.name, transform=place)
    content = scene.export(file_type="glb")
    with replacing(path) as file:
        file.write(content)
