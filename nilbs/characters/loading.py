"""Characters from files: a mesh and a rig in any format, or one file that holds both."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nilbs.characters.report import Report, silent
from nilbs.geometry.plane import flattened, in_space
from nilbs.geometry.simplex import weights_on_simplex
from nilbs.geometry.skeleton import Skeleton
from nilbs.io.bundle import Bundle, Clip, Mesh, select_group

if TYPE_CHECKING:
    from nilbs.characters.character import Character

_SAME_PLACE = 1e-4  # of the mesh's size: how far vertices of two files may lie apart and still be the same


@dataclass(frozen=True)
class RiggedMesh:
    """A mesh, its skeleton and its painted weights, read and fitted together; nothing is solved yet.

    Attributes
    ----------
    name : str
        The mesh file's, without suffix.
    files : str
        Where it came from, for error messages.
    V : (n, d) float array
        Rest vertices; d is 2 where all z are 0.
    E : (m, 3) int array
        Triangles.
    skeleton : Skeleton
        In as many dimensions as the mesh.
    W : (n, b) float array, optional
        Weights with rows on the simplex; None where they are to be solved.
    clips : tuple of Clip
        Motions of this very skeleton.
    """

    name: str
    files: str
    V: np.ndarray
    E: np.ndarray
    skeleton: Skeleton
    W: np.ndarray | None
    clips: tuple[Clip, ...] = ()

    def assemble(self, *, progress: bool = False, report: Report | None = None) -> "Character":
        """Fill the mesh, solve for weights that are missing, and make the character.

        Raises
        ------
        ValueError
            As `nilbs.characters.character.assemble`, with the names of the files.
        """
        from nilbs.characters.character import assemble

        try:
            return assemble(self.V, self.E, self.skeleton, self.W, name=self.name, progress=progress, report=report)
        except ValueError as error:
            raise ValueError(f"{self.files}: {error}") from error


def load_character(
    mesh: str | Path,
    rig: str | Path | None = None,
    weights: str | Path | None = None,
    *,
    group: str | None = None,
    solve: bool = False,
    progress: bool = False,
    report: Report | None = None,
) -> "Character":
    """Read a rigged character from files; solve for its weights where none are given.

    Parameters
    ----------
    mesh : path
        A mesh (`.obj`, `.ply`, `.off`, `.stl`, `.3mf`), or a file that holds the rig too (`.glb`, `.gltf`, `.fbx`,
        `.npz` of the SMPL family). A flat one (z = 0) is a character in the plane.
    rig : path, optional
        `.tgf`, `.txt` of RigNet, `.mhskel`, or any file that holds a skeleton; the mesh's own file by default.
    weights : path, optional
        Weights of the mesh's vertices, `.dmat`, `.npz` or `.mhw`. Those painted in the rig's file by default, and
        where there are none, bounded biharmonic weights are solved for.
    group : str, optional
        The group or object of the mesh that is the character; all of it by default. Vertices of other groups go.
    solve : bool
        Solve for weights even where some are painted.
    progress : bool
        Show progress on standard error.
    report : function of str, optional
        Receives a line on each decision that the files left open.

    Returns
    -------
    character : Character

    Raises
    ------
    FileFormatError
        If a file cannot be read as what it should be.
    ValueError
        If the files do not fit each other, or no weights can be solved for.
    OSError
        If a file cannot be opened.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.characters.gingerbread import write_gingerbread
    >>> load_character(*write_gingerbread(tempfile.mkdtemp(), 2)).W.shape[1]
    13
    """
    rigged = read_rigged_mesh(mesh, rig, weights, group=group, solve=solve, report=report)
    return rigged.assemble(progress=progress, report=report)


def read_rigged_mesh(
    mesh: str | Path,
    rig: str | Path | None = None,
    weights: str | Path | None = None,
    *,
    group: str | None = None,
    solve: bool = False,
    report: Report | None = None,
) -> RiggedMesh:
    r"""Read what `load_character` reads, and solve nothing.

    Parameters
    ----------
    mesh, rig, weights, group, solve, report
        As for `load_character`.

    Returns
    -------
    rigged : RiggedMesh

    Raises
    ------
    FileFormatError, ValueError, OSError
        As for `load_character`.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    >>> _ = (folder / "a.tgf").write_text("1 .1 .1 0\n2 .5 .1 0\n#\n1 2\n#\n")
    >>> rigged = read_rigged_mesh(folder / "a.obj", folder / "a.tgf")
    >>> rigged.V.shape, rigged.skeleton.d, rigged.W
    ((3, 2), 2, None)
    """
    from nilbs.io.registry import read_bundle

    from_mesh = read_bundle(mesh)
    V = None if from_mesh.mesh is None else in_space(from_mesh.mesh.V)
    from_rig = from_mesh if rig is None else read_bundle(rig, V=V)
    return fit_together(
        mesh, from_mesh, mesh if rig is None else rig, from_rig, weights, group=group, solve=solve, report=report
    )


def fit_together(
    mesh_path: str | Path,
    from_mesh: Bundle,
    rig_path: str | Path,
    from_rig: Bundle,
    weights_path: str | Path | None = None,
    *,
    group: str | None = None,
    solve: bool = False,
    report: Report | None = None,
) -> RiggedMesh:
    """Make one rigged mesh of the parts of two files, or of one file twice.

    Parameters
    ----------
    mesh_path, from_mesh : path, Bundle
        Whose mesh is taken.
    rig_path, from_rig : path, Bundle
        Whose skeleton, painted weights and motions are taken.
    weights_path, group, solve, report
        As for `load_character`.

    Returns
    -------
    rigged : RiggedMesh

    Raises
    ------
    FileFormatError, ValueError, OSError
        As for `load_character`.
    """
    from nilbs.characters.character import in_dimension
    from nilbs.io.errors import FileFormatError

    report = report or silent
    if solve and weights_path is not None:
        raise ValueError(f"weights are solved for or read from {weights_path}, not both")
    for path, parts in {str(mesh_path): from_mesh, str(rig_path): from_rig}.items():
        for note in parts.notes:
            report(f"{path}: {note}")
    mesh, skeleton = from_mesh.mesh, from_rig.skeleton
    if mesh is None:
        raise FileFormatError(mesh_path, "the file holds no mesh: give the mesh first, then the rig")
    if skeleton is None:
        what = "no rig: give its file after the mesh" if rig_path == mesh_path else "no rig"
        raise FileFormatError(rig_path, f"the file holds {what}")
    if mesh.E.shape[1] != 3:
        raise FileFormatError(mesh_path, "the file holds a curve of edges: a character's mesh is of triangles")
    files = " with ".join(dict.fromkeys([str(mesh_path), str(rig_path)]))
    files += "" if weights_path is None else f" and {weights_path}"
    try:
        V, E, kept = whole_or_group(mesh, group)
        skeleton = in_dimension(skeleton, V.shape[1])
        W = None
        if weights_path is not None:
            W = _weights_of_file(weights_path, len(mesh.V), kept, skeleton)
        elif not solve and from_rig.influences is not None:
            W = _painted_weights(rig_path, from_rig, mesh, skeleton, report)
            W = None if W is None else W[kept]
        if W is not None:
            W, notes = weights_on_simplex(W, V, numbers=kept)
            for note in notes:
                report(note)
    except FileFormatError:
        raise
    except ValueError as error:
        raise ValueError(f"{files}: {error}") from error
    return RiggedMesh(Path(mesh_path).stem, files, V, E, skeleton, W, from_rig.clips)


def whole_or_group(mesh: Mesh, group: str | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices and faces of a mesh or of one of its groups, in the plane where that is flat.

    Parameters
    ----------
    mesh : Mesh
    group : str, optional
        All by default.

    Returns
    -------
    V : (n', d) float array
        d is 2 where all z are 0.
    E : (m', 3) int array
        Indices into V.
    kept : (n',) int array
        Where the vertices stand in the whole mesh.

    Raises
    ------
    ValueError
        If there is no such group.

    Examples
    --------
    >>> mesh = Mesh(np.array([[0, 0, 9.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [1, 2, 3]]))
    >>> whole_or_group(mesh, None)[0].shape
    (4, 3)
    >>> V, _, kept = whole_or_group(Mesh(mesh.V, mesh.E, {"floor": np.array([1])}), "floor")
    >>> V.shape, kept.tolist()
    ((3, 2), [1, 2, 3])
    """
    V, E, kept = (mesh.V, mesh.E, np.arange(len(mesh.V))) if group is None else select_group(mesh, group)
    return flattened(V), E, kept


def _weights_of_file(path: str | Path, n: int, kept: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Rows of the vertices that stay, from a file of the whole mesh or of just these."""
    b = len(skeleton.BE)
    if Path(path).suffix.lower() == ".mhw":
        from nilbs.io.makehuman import read_mhw

        return read_mhw(path, skeleton.names).dense(n, b, path)[kept]
    from nilbs.characters.character import check_sizes
    from nilbs.io.weights import read_weights

    W = read_weights(path)
    check_sizes(W, n, b, group=len(kept))
    return W[kept] if len(W) == n else W


def _painted_weights(
    path: str | Path, rig: Bundle, mesh: Mesh, skeleton: Skeleton, report: Report
) -> np.ndarray | None:
    """Weights of the rig's file, where they are of this mesh."""
    assert rig.influences is not None
    if rig.mesh is not None and rig.mesh is not mesh and not _same_vertices(rig.mesh.V, mesh.V):
        report(f"{path}: its painted weights are of its own mesh, which is not the one given: they are left out")
        return None
    report(f"{path}: its painted weights are used")
    return rig.influences.dense(len(mesh.V), len(skeleton.BE), path)


def _same_vertices(one: np.ndarray, other: np.ndarray) -> bool:
    one, other = in_space(one), in_space(other)
    return one.shape == other.shape and bool(np.abs(one - other).max() <= _SAME_PLACE * np.ptp(other, axis=0).max())
