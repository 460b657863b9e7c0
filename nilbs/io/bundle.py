"""What files hold of a character: a mesh, a skeleton, weights, motions; any of them may be missing."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nilbs.geometry.curves import PosesOverTime
from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.skeleton import Skeleton
from nilbs.io.errors import FileFormatError
from nilbs.io.motion import LocalMotion


@dataclass(frozen=True)
class Mesh:
    """A mesh as its file holds it.

    Attributes
    ----------
    V : (n, d) float array
        Vertices, as many and in the order of the file; d is 2 where all z are 0.
    E : (m, 3) int array
        Triangles (or (m, 2) edges of a flat curve).
    groups : mapping of str to (g,) int array
        Faces (rows of E) by the name of their group or object. A face may be in several, or in none.
    notes : tuple of str
        A sentence on everything in the file that could not be kept as it is.
    """

    V: np.ndarray
    E: np.ndarray
    groups: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def select_group(mesh: Mesh, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of a mesh that is one group or object: V (n', d), E (m', 3), and where these vertices stand in the mesh.

    Examples
    --------
    >>> mesh = Mesh(np.eye(4)[:, :3], np.array([[0, 1, 2], [1, 2, 3]]), {"body": np.array([1])})
    >>> V, E, kept = select_group(mesh, "body")
    >>> E.tolist(), kept.tolist()
    ([[0, 1, 2]], [1, 2, 3])
    """
    if name not in mesh.groups:
        known = ", ".join(map(repr, mesh.groups)) or "none"
        meant = nearest_name(name, mesh.groups)
        raise ValueError(f"the mesh has no group {name!r}{meant}; its groups are: {known}")
    kept, E = np.unique(mesh.E[mesh.groups[name]], return_inverse=True)
    return mesh.V[kept], E.reshape(-1, mesh.E.shape[1]).astype(np.int64), kept


@dataclass(frozen=True)
class Influences:
    """Skinning weights, as sparse as the file has them: bone `bone[i]` moves vertex `vertex[i]` by `weight[i]`.

    Attributes
    ----------
    vertex, bone : (i,) int arrays
    weight : (i,) float array
        Finite, as in the file: rows may not sum to one. A pair that is named twice counts with its sum.
    shape : (int, int), optional
        How many vertices and bones there are, in a file that holds the whole matrix.
    """

    vertex: np.ndarray
    bone: np.ndarray
    weight: np.ndarray
    shape: tuple[int, int] | None = None

    @classmethod
    def of_matrix(cls, W: np.ndarray) -> "Influences":
        """The weights of a matrix (n, b) that are not zero."""
        vertex, bone = np.nonzero(W)
        return cls(vertex, bone, W[vertex, bone], (len(W), W.shape[1]))

    def dense(self, n: int, b: int, path: str | os.PathLike) -> np.ndarray:
        """Weights (n, b) of n vertices, zero where the file names none; FileFormatError for another vertex or bone."""
        for name, index, size in (("vertex", self.vertex, n), ("bone", self.bone, b)):
            bad = np.flatnonzero((index < 0) | (index >= size))
            if len(bad):
                other = ": it is of another mesh" if name == "vertex" else ""
                raise FileFormatError(path, f"a weight of {name} {index[bad[0]]}, but there are only {size}{other}")
        W = np.zeros((n, b))
        np.add.at(W, (self.vertex, self.bone), self.weight)
        return W


@dataclass(frozen=True)
class Clip:
    """A motion of a skeleton.

    Attributes
    ----------
    name : str
    skeleton : Skeleton
        Whose rest pose the transforms start from.
    times : (t,) float array
        Seconds, not decreasing.
    B : (t, b, 4, 4) float array
        Transforms of the skeleton's bones, rest to posed, in world coordinates.
    file : str
        Where it was read from.
    curves : PosesOverTime, optional
        The poses at any time, which are B at `times`; those of a flat character may be of the plane. Without them a
        pose between two frames is interpolated.
    """

    name: str
    skeleton: Skeleton
    times: np.ndarray
    B: np.ndarray
    file: str = ""
    curves: PosesOverTime | None = None


@dataclass(frozen=True)
class Bundle:
    """What was found of a character, in one file or in several that were fitted together.

    Attributes
    ----------
    mesh : Mesh, optional
    skeleton : Skeleton, optional
    influences : Influences, optional
        Columns are the skeleton's bones, rows the mesh's vertices.
    clips : tuple of Clip
    notes : tuple of str
        A sentence on everything that was left out or decided for the user.
    motion : LocalMotion or (t, b, 4, 4) float array, optional
        A motion of bones that the file does not describe, by their names or in their order.
    taken : mapping of str to list of str
        What each of several files brought: of "mesh", "rig", "weights" and "motion".
    """

    mesh: Mesh | None = None
    skeleton: Skeleton | None = None
    influences: Influences | None = None
    clips: tuple[Clip, ...] = ()
    notes: tuple[str, ...] = ()
    motion: LocalMotion | np.ndarray | None = None
    taken: Mapping[str, list[str]] = field(default_factory=dict)

    @property
    def is_motion(self) -> bool:
        """Whether its skeleton is only that of a motion: there are clips, and neither a mesh nor weights."""
        return bool(self.clips) and self.mesh is None and self.influences is None
