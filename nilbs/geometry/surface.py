"""A surface or outline as two arrays, and as a mesh of trimesh."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nilbs.geometry.plane import in_space

if TYPE_CHECKING:
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
