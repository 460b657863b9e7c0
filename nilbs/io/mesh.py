"""Meshes: OBJ, PLY, OFF, STL and 3MF files, flat or not."""

import os
from collections.abc import Callable

import numpy as np

from nilbs.geometry.plane import counter_clockwise, flattened, in_space
from nilbs.geometry.polygons import cut_polygons
from nilbs.geometry.validation import arrays, check_indices
from nilbs.io.atomic import replacing
from nilbs.io.bundle import Mesh
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.obj import read_obj
from nilbs.io.ply import read_ply
from nilbs.io.polygons import MeshFile, check_corners, without_repeats
from nilbs.io.trimesh_meshes import SUFFIXES, read_trimesh, trimesh_bytes

_READERS: dict[str, Callable[[str | os.PathLike], MeshFile]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    **dict.fromkeys(SUFFIXES, read_trimesh),
}


def read_mesh(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    r"""Read a mesh, keeping the number and order of its vertices.

    Parameters
    ----------
    path : str or path
        An `.obj`, `.ply`, `.off`, `.stl` or `.3mf` file, see `read_mesh_parts`.

    Returns
    -------
    V : (n, d) float array
        Vertices, in the file's units; d is 2 where all z are 0.
    E : (m, 3) or (m, 2) int array
        Triangles: a surface F where d is 3, the elements T of a flat mesh, turned counter-clockwise, where d is 2. A
        flat file without faces may hold a curve: then E is its edges F, (m, 2).

    Raises
    ------
    FileFormatError
        If the file is not such a mesh, with the line at fault where there is one.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "square.obj"
    >>> _ = path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    >>> V, T = read_mesh(path)
    >>> V.shape, T.tolist()
    ((4, 2), [[0, 1, 2], [0, 2, 3]])
    """
    mesh = read_mesh_parts(path)
    return mesh.V, mesh.E


def read_mesh_parts(path: str | os.PathLike) -> Mesh:
    r"""Read a mesh with its groups, keeping the number and order of its vertices.

    Polygons are cut into triangles, in the order of the file, by `cut_polygons`. Corners that repeat the one before
    them are left out, and so are faces with fewer than three different corners. `groups` are what OBJ, STL and 3MF
    name; `notes` report what was left out, and which polygons cross themselves. Corners of an STL file that are equal
    are one vertex. Errors are those of `read_mesh`; a flat polygon that crosses itself is one too.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "two.obj"
    >>> _ = path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\ng lower\nf 1 2 3\ng upper\nf 1 3 4\n")
    >>> {name: faces.tolist() for name, faces in read_mesh_parts(path).groups.items()}
    {'lower': [0], 'upper': [1]}
    """
    file = _READERS[check_suffix(path, *_READERS)](path)
    if len(file.V) == 0:
        raise FileFormatError(path, "the file holds no vertex")
    check_corners(file, "face")
    check_corners(file, "edge")
    V = flattened(file.V)
    flat = V.shape[1] == 2
    if len(file.faces.counts) == 0 and flat:
        edges = file.edges.corners.reshape(-1, 2)
        edges = edges[edges[:, 0] != edges[:, 1]]
        if len(edges):
            return Mesh(V, edges)
    faces = without_repeats(file.faces)
    F, face, crossed = cut_polygons(V, faces.corners, faces.counts)
    if flat and crossed.any():
        message = "this polygon crosses itself, or has too many corners: cut it into triangles"
        raise FileFormatError(path, message, faces.line(int(crossed.argmax())))
    solid = (F[:, [1, 2, 0]] != F).all(axis=1)  # a polygon may come back to a corner
    F, face = F[solid], face[solid]
    if not len(F):
        raise FileFormatError(
            path, "the file holds no face" + " with three different corners" * bool(len(faces.counts))
        )
    if flat:
        F = counter_clockwise(V, F)
    notes = [*file.notes]
    few = len(faces.counts) - len(np.unique(face))
    if few:
        notes.append(f"{few} of {len(faces.counts)} faces have fewer than three different corners and are left out")
    if crossed.any():
        line = faces.line(int(crossed.argmax()))
        where = "" if line is None else f", in line {line} first"
        notes.append(f"{crossed.sum()} polygons cross themselves or have too many corners to be cut well{where}")
    return Mesh(V, F, _groups_of_triangles(file, face), tuple(notes))


def write_mesh(path: str | os.PathLike, V: np.ndarray, F: np.ndarray) -> None:
    """Write a mesh in the format that the suffix names.

    Parameters
    ----------
    path : str or path
        The file: `.obj` (text), `.ply` (binary) and `.3mf` (in millimetres) hold every digit, `.off` 17 digits of the
        largest coordinate, `.stl` 32-bit numbers of every triangle's corners, without the vertices' order.
    V : (n, d) float array
        Vertices, in the file's units; written with z = 0 where d is 2.
    F : (m, 2) or (m, 3) int array
        Triangles; or, where d is 2, edges, which `.obj` and `.ply` hold. There may be none.

    Raises
    ------
    ValueError
        If V and F are no such mesh, or the format cannot hold them, or the suffix is another.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/edge.ply"
    >>> write_mesh(path, [[0, 0], [1, 0.5]], [[0, 1]])
    >>> read_mesh(path)[1]
    array([[0, 1]])
    """
    suffix = check_suffix(path, *_READERS)
    V, F = arrays(V=(V, "n d"), F=(F, "m k", int))
    n, d = V.shape
    if F.shape[1] not in (2, 3) or (d == 3 and F.shape[1] == 2):
        raise ValueError(f"F must be (m, 3){' or (m, 2)' * (d == 2)}, got {F.shape}")
    check_indices("F", F, n, "vertices")
    xyz = in_space(V)
    if suffix in SUFFIXES and F.shape[1] == 2:
        raise ValueError(f"{suffix} holds triangles, not the edges of an outline: write .obj or .ply")
    content = trimesh_bytes(path, xyz, F) if suffix in SUFFIXES else b""
    with replacing(path, "w" if suffix == ".obj" else "wb") as file:
        if suffix in SUFFIXES:
            file.write(content)
        elif suffix == ".obj":
            file.writelines(f"v {x} {y} {z}\n" for x, y, z in xyz.tolist())
            kind = "f" if F.shape[1] == 3 else "l"
            file.writelines(f"{kind} {' '.join(map(str, row))}\n" for row in (F + 1).tolist())
        else:
            file.write(_ply_header(n, F).encode("ascii"))
            file.write(xyz.astype("<f8").tobytes())
            if F.shape[1] == 3:
                faces = np.empty(len(F), [("count", "u1"), ("corners", "<i4", (3,))])
                faces["count"], faces["corners"] = 3, F
                file.write(faces.tobytes())
            else:
                file.write(F.astype("<i4").tobytes())


def _groups_of_triangles(file: MeshFile, face: np.ndarray) -> dict[str, np.ndarray]:
    """Triangles by group, from the polygon that each triangle comes from, ascending."""
    found = {}
    for name, faces in file.groups.items():
        start, stop = np.searchsorted(face, faces), np.searchsorted(face, faces, side="right")
        size = stop - start
        triangles = np.repeat(start - np.cumsum(size) + size, size) + np.arange(size.sum())
        if len(triangles):
            found[name] = triangles
    return found


def _ply_header(n: int, F: np.ndarray) -> str:
    rows = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    rows += [f"property double {name}" for name in "xyz"]
    if F.shape[1] == 3:
        rows += [f"element face {len(F)}", "property list uchar int vertex_indices"]
    else:
        rows += [f"element edge {len(F)}", "property int vertex1", "property int vertex2"]
    return "\n".join([*rows, "end_header", ""])
