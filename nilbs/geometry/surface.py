"""A surface or outline as two arrays, and as a mesh of trimesh."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import trimesh


class Surface(NamedTuple):
    """A surface, or an outline in the plane; `U, F = surface` takes it apart.

    Attributes
    ----------
    U : (n, d) float array
        Vertices, in mesh units.
    F : (m, k) int array
        Facets: triangles, or edges where k is 2.

    Examples
    --------
    >>> Surface(np.eye(3), np.array([[0, 1, 2]])).to_trimesh().faces.tolist()
    [[0, 1, 2]]
    """

    U: np.ndarray
    F: np.ndarray

    def to_trimesh(self) -> "trimesh.Trimesh | trimesh.path.Path2D":
        """Mesh of trimesh over the same vertices in the same order, with z = 0 where d is 2; a path where k is 2."""
        import trimesh

        if self.F.shape[1] == 2:
            lines = [trimesh.path.entities.Line(edge) for edge in self.F]
            return trimesh.path.Path2D(entities=lines, vertices=self.U, process=False)
        n, d = self.U.shape
        xyz = np.zeros((n, 3))
        xyz[:, :d] = self.U
        return trimesh.Trimesh(xyz, self.F, process=False)
