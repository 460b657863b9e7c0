"""Meshes: OBJ and PLY files, flat or not."""

import os

import numpy as np

from nilbs.geometry.validation import arrays, check_indices
from nilbs.io.atomic import replacing
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.obj import read_obj
from nilbs.io.ply import read_ply
from nilbs.io.polygons import check_corners, triangle_fans


def read_mesh(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    r"""Read a mesh, keeping the number and order of its vertices.

    Parameters
    ----------
    path : str or path
        An `.obj` or `.ply` file. Polygons are cut into fans of triangles.

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
    file = read_obj(path) if check_suffix(path, ".obj", ".ply") == ".obj" else read_ply(path)
    if len(file.V) == 0:
        raise FileFormatError(path, "the file holds no vertex")
    check_corners(file, "face")
    check_corners(file, "edge")
    flat = not file.V[:, 2].any()
    if len(file.faces.counts) == 0:
        if flat and len(file.edges.counts):
            return file.V[:, :2].copy(), file.edges.corners.reshape(-1, 2)
        raise FileFormatError(path, "the file holds no face")
    F, face = triangle_fans(file.faces)
    if not flat:
        return file.V, F
    V = file.V[:, :2].copy()
    turn = _turns(V, F)
    # A fan of a polygon that is not convex covers some places twice and some outside.
    lowest, highest = np.zeros(len(file.faces.counts)), np.zeros(len(file.faces.counts))
    np.minimum.at(lowest, face, turn)
    np.maximum.at(highest, face, turn)
    mixed = np.flatnonzero((lowest < 0) & (highest > 0))
    if len(mixed):
        raise FileFormatError(path, "this polygon is not convex: cut it into triangles", file.faces.line(mixed[0]))
    F[turn < 0] = F[turn < 0][:, [0, 2, 1]]
    return V, F


def write_mesh(path: str | os.PathLike, V: np.ndarray, F: np.ndarray) -> None:
    """Write a mesh as OBJ (text) or PLY (binary), by the suffix, with every digit.

    Parameters
    ----------
    path : str or path
        The file, ending in `.obj` or `.ply`.
    V : (n, d) float array
        Vertices, in the file's units; written with z = 0 where d is 2.
    F : (m, 2) or (m, 3) int array
        Triangles; or, where d is 2, edges. There may be none.

    Raises
    ------
    ValueError
        If V and F are no such mesh, or the suffix is another.
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
    suffix = check_suffix(path, ".obj", ".ply")
    V, F = arrays(V=(V, "n d"), F=(F, "m k", int))
    n, d = V.shape
    if F.shape[1] not in (2, 3) or (d == 3 and F.shape[1] == 2):
        raise ValueError(f"F must be (m, 3){' or (m, 2)' * (d == 2)}, got {F.shape}")
    check_indices("F", F, n, "vertices")
    xyz = np.zeros((n, 3))
    xyz[:, :d] = V
    with replacing(path, "w" if suffix == ".obj" else "wb") as file:
        if suffix == ".obj":
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


def _turns(V: np.ndarray, T: np.ndarray) -> np.ndarray:
    """The signed areas of flat triangles, scaled: positive where they run counter-clockwise."""
    V = V / (np.abs(V).max() or 1.0)  # so that no product overflows
    a, b = V[T[:, 1]] - V[T[:, 0]], V[T[:, 2]] - V[T[:, 0]]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _ply_header(n: int, F: np.ndarray) -> str:
    rows = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    rows += [f"property double {name}" for name in "xyz"]
    if F.shape[1] == 3:
        rows += [f"element face {len(F)}", "property list uchar int vertex_indices"]
    else:
        rows += [f"element edge {len(F)}", "property int vertex1", "property int vertex2"]
    return "\n".join([*rows, "end_header", ""])
