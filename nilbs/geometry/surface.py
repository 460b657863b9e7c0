"""A surface or outline as two arrays, and as a mesh of trimesh, Open3D or PyVista."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nilbs.geometry.plane import in_space

if TYPE_CHECKING:
    import open3d
    import pyvista
    import trimesh


class Surface(NamedTuple):
    """A surface, or an outline in the plane; `U, F = surface` unpacks it.

    Attributes
    ----------
    U, F : (n, d) float array and (m, k) int array
        Vertices, in mesh units, and facets: triangles, or edges if k is 2.

    Examples
    --------
    >>> Surface(np.eye(3), np.array([[0, 1, 2]])).to_trimesh().faces.tolist()
    [[0, 1, 2]]
    """

    U: np.ndarray
    F: np.ndarray

    def to_trimesh(self) -> "trimesh.Trimesh | trimesh.path.Path2D":
        """Mesh of trimesh over the same vertices in the same order, in space; edges become a path."""
        import trimesh

        if self.F.shape[1] == 2:
            lines = [trimesh.path.entities.Line(edge) for edge in self.F]
            return trimesh.path.Path2D(entities=lines, vertices=self.U, process=False)
        return trimesh.Trimesh(in_space(self.U), self.F, process=False)

    def to_open3d(self) -> "open3d.geometry.TriangleMesh | open3d.geometry.LineSet":
        """Mesh of Open3D over the same vertices in the same order, in space; edges become a set of lines.

        Raises
        ------
        ModuleNotFoundError
            If Open3D is not installed.
        """
        o3d = _installed("open3d")
        points = o3d.utility.Vector3dVector(np.ascontiguousarray(in_space(self.U), dtype=np.float64))
        F = np.ascontiguousarray(self.F, dtype=np.int32)
        if F.shape[1] == 2:
            return o3d.geometry.LineSet(points, o3d.utility.Vector2iVector(F))
        return o3d.geometry.TriangleMesh(points, o3d.utility.Vector3iVector(F))

    def to_pyvista(self) -> "pyvista.PolyData":
        """Mesh of PyVista over the same vertices in the same order, in space; edges become lines.

        Raises
        ------
        ModuleNotFoundError
            If PyVista is not installed.
        """
        pv = _installed("pyvista")
        points, cells = in_space(self.U), np.insert(self.F, 0, self.F.shape[1], axis=1).ravel()
        if not len(cells):  # without cells, PyVista would make one of each point
            mesh = pv.PolyData()
            mesh.points = points
            return mesh
        return pv.PolyData(points, **{"lines" if self.F.shape[1] == 2 else "faces": cells})


def _installed(name: str) -> Any:
    """A library that nothing else here needs; an error that names the package if it is not there."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise ModuleNotFoundError(f"the package {name} is not installed: pip install {name}", name=name) from None
