"""A rigged character: its surface, its skeleton, its skinning weights and the volume that they are known in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from nilbs.characters.report import Report, silent
from nilbs.geometry.domain import volume_domain
from nilbs.geometry.facets import seamless
from nilbs.geometry.interpolation import surface_interpolation, volume_interpolation
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.plane import flattened
from nilbs.geometry.rig_weights import solve_weights
from nilbs.geometry.simplex import weights_on_simplex
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface
from nilbs.geometry.validation import arrays as checked
from nilbs.geometry.validation import check_indices
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.weights import extend_weights

if TYPE_CHECKING:
    import open3d
    import pyvista
    import trimesh

# The arrays that make a character, and those of its skeleton.
_OWN, _BONES = ("V", "F", "W", "V_volume", "T", "W_volume"), ("C", "BE", "P", "forks")


@dataclass(frozen=True)
class Character:
    """A rest shape with bones and weights.

    Attributes
    ----------
    name : str
        What pictures and tables call it.
    V : (n, d) float array
        Rest vertices, in mesh units.
    F : (m, d) int array
        Boundary facets: outline edges in the plane, triangles in space.
    skeleton : Skeleton
        Its bones, in as many dimensions.
    W : (n, b) float array
        Skinning weights of V; rows on the simplex.
    V_volume : (n', d) float array
        Vertices of the volume mesh, which may be a wrap around V.
    T : (t, d+1) int array
        Its positively oriented elements.
    W_volume : (n', b) float array
        Weights of V_volume.
    """

    name: str
    V: np.ndarray
    F: np.ndarray
    skeleton: Skeleton
    W: np.ndarray
    V_volume: np.ndarray
    T: np.ndarray
    W_volume: np.ndarray

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.V.shape[1]

    @cached_property
    def L(self) -> float:
        """Longest edge of the rest mesh's bounding box, the unit of every reported length."""
        return float(np.ptp(self.V, axis=0).max())

    @cached_property
    def center(self) -> np.ndarray:
        """Centre (d,) of the rest mesh's bounding box."""
        return (self.V.min(axis=0) + self.V.max(axis=0)) / 2

    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their letters, with those of the skeleton: what files keep."""
        own = {name: getattr(self, name) for name in _OWN}
        return own | {name: getattr(self.skeleton, name) for name in _BONES}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray], *, name: str, bones: Sequence[str]) -> Self:
        """A character from `arrays`; KeyError or ValueError if one is missing or they do not fit each other."""
        if unknown := set(arrays) - {*_OWN, *_BONES}:
            raise ValueError(f"a character has no array {', '.join(sorted(unknown))}")
        if any(arrays[key].dtype.kind != "i" for key in ("F", "BE", "P", "T")):
            raise ValueError("F, BE, P and T must be stored as integers")
        skeleton = Skeleton(
            names=tuple(bones), **{key: arrays[key] for key in _BONES if key != "forks" or key in arrays}
        )
        c = cls(name=name, skeleton=skeleton, **{key: arrays[key] for key in _OWN})
        checked(
            V=(c.V, f"n {skeleton.d}"), F=(c.F, "m d", int), W=(c.W, f"n {len(skeleton.BE)}"),
            V_volume=(c.V_volume, f"v {skeleton.d}"), T=(c.T, "t d+1", int),
            W_volume=(c.W_volume, f"v {len(skeleton.BE)}"),
        )  # fmt: skip
        check_indices("F", c.F, len(c.V), "vertices")
        check_indices("T", c.T, len(c.V_volume), "vertices of the volume")
        if not c.L > 0:
            raise ValueError("all vertices lie in one place")
        return c

    def skin(self, pose: np.ndarray) -> np.ndarray:
        """Posed vertices (eq. 1).

        Parameters
        ----------
        pose : (b, d+1, d+1) float array
            Bone transforms, rest to posed.

        Returns
        -------
        U : (n, d) float array
        """
        return linear_blend_skinning(self.V, self.W, pose)

    def to_trimesh(self, pose: np.ndarray | None = None) -> "trimesh.Trimesh":
        """The mesh at rest or in a pose, as trimesh has it.

        Parameters
        ----------
        pose : (b, d+1, d+1) float array, optional
            Bone transforms, rest to posed.

        Returns
        -------
        mesh : trimesh.Trimesh
            Its vertices are `V`, or `skin(pose)`, in this order; nothing is merged. In the plane: the triangles `T` of
            the volume, with z = 0.
        """
        return self._surface(pose).to_trimesh()  # type: ignore[return-value]

    def to_open3d(self, pose: np.ndarray | None = None) -> "open3d.geometry.TriangleMesh":
        """The mesh at rest or in a pose, as Open3D has it: the vertices and triangles of `to_trimesh`.

        Raises
        ------
        ModuleNotFoundError
            If Open3D is not installed.
        """
        return self._surface(pose).to_open3d()

    def to_pyvista(self, pose: np.ndarray | None = None) -> "pyvista.PolyData":
        """The mesh at rest or in a pose, as PyVista has it: the vertices and triangles of `to_trimesh`.

        Raises
        ------
        ModuleNotFoundError
            If PyVista is not installed.
        """
        return self._surface(pose).to_pyvista()

    def _surface(self, pose: np.ndarray | None) -> Surface:
        V, W, F = (self.V, self.W, self.F) if self.d == 3 else (self.V_volume, self.W_volume, self.T)
        return Surface(V if pose is None else linear_blend_skinning(V, W, pose), F)


@overload
def assemble(
    mesh: "trimesh.Trimesh", skeleton: Skeleton, /, *, W: np.ndarray | None = None,
    name: str = ..., progress: bool = ..., report: Report | None = ...,
) -> Character: ...  # fmt: skip


@overload
def assemble(
    V: np.ndarray, E: np.ndarray, skeleton: Skeleton, W: np.ndarray | None = None, *,
    name: str = ..., progress: bool = ..., report: Report | None = ...,
) -> Character: ...  # fmt: skip


def assemble(
    V: Any,
    E: Any,
    skeleton: Any = None,
    W: np.ndarray | None = None,
    *,
    name: str = "character",
    progress: bool = False,
    report: Report | None = None,
) -> Character:
    """Make a character of arrays, `assemble(V, E, skeleton)`, or of a mesh of trimesh, `assemble(mesh, skeleton)`.

    Weights are solved for where none are given. A mesh whose z are all 0 is a character in the plane.

    Parameters
    ----------
    V : (n, d) float array
        Rest vertices.
    E : (t, 3) or (m, 3) int array
        Triangles: those that fill the shape in the plane, those of its surface in space.
    skeleton : Skeleton
        In space, or in the plane for a flat mesh, which also takes the flat skeleton of a file (z = 0).
    W : (n, b) float array, optional
        Weights of V, put on the simplex by `nilbs.geometry.simplex.weights_on_simplex`; what changes is reported.
    name : str
        What pictures and tables call it.
    progress : bool
        Show progress on standard error.
    report : function of str, optional
        Receives a line on every decision that depends on the mesh or the rig.

    Returns
    -------
    character : Character

    Raises
    ------
    ValueError
        If the arrays do not fit each other, or no bone is near the mesh.

    Notes
    -----
    The surface F is joined across seams: of vertices at one place it uses the first, and V and W keep them all. Facets
    that face against their neighbours are turned, so that the winding number is above one half inside. Otherwise the
    surface stays as it is: skinning and occupancy are always those of the given mesh.

    Examples
    --------
    >>> from nilbs.geometry.skeleton import skeleton_of_bones
    >>> V, E = [[0, 0], [2, 0], [2, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> skeleton = skeleton_of_bones([[0.5, 0.5], [1, 0.5], [1.5, 0.5]], [[0, 1], [1, 2]])
    >>> character = assemble(V, E, skeleton)
    >>> character.L, character.W.shape, len(character.F)
    (2.0, (4, 2), 4)
    >>> assemble(character.to_trimesh(), skeleton).L
    2.0
    """
    report = report or silent
    if hasattr(V, "vertices"):
        V, E, skeleton, W = flattened(V.vertices), V.faces, E, W if skeleton is None else skeleton
    V, E = checked(V=(V, "n d"), E=(E, "m 3", int))
    skeleton = in_dimension(skeleton, V.shape[1])
    F = _boundary(V, E)
    F, turned = coherent_orientation(V, F)
    if turned.any():
        report(f"{int(turned.sum())} of {len(F)} facets faced against their neighbours and were turned")
    if W is None:
        solved = solve_weights(V, F if V.shape[1] == 3 else E, skeleton, progress=progress)
        for note in solved.notes:
            report(note)
        W, V_volume, T, W_volume = solved.W, solved.V_volume, solved.T, solved.W_volume
    else:
        (W,) = checked(W=(W, "n b"))
        check_sizes(W.shape, len(V), len(skeleton.BE))
        W, notes = weights_on_simplex(W, V)
        for note in notes:
            report(note)
        domain = volume_domain(V, F if V.shape[1] == 3 else E, np.zeros((0, V.shape[1])))
        V_volume, T = domain.V, domain.T
        if V.shape[1] == 2:
            W_volume = volume_interpolation(V, E, W, V_volume)
        else:
            W_volume = extend_weights(V_volume, T, surface_interpolation(V, F, W, V_volume[: domain.surface]))
    return Character(name, V, F, skeleton, W, V_volume, T, W_volume)


def in_dimension(skeleton: Skeleton, d: int) -> Skeleton:
    """The skeleton in the d dimensions of a mesh; ValueError if only one of the two is flat."""
    if skeleton.d == d:
        return skeleton
    if d == 3:
        raise ValueError("the mesh has 3 dimensions but the rig has 2")
    return skeleton.in_plane()


def check_sizes(shape: tuple[int, ...], n: int, b: int, *, group: int | None = None) -> None:
    """Refuse weights of a shape that is neither (n, b) nor, of the vertices in a group that is taken, (group, b)."""
    if shape not in ((n, b), (group, b)):
        chosen = "" if group in (None, n) else f" ({group} in the group)"
        raise ValueError(
            f"the weights have {shape[0]} rows and {shape[1]} columns, but the mesh has {n} vertices{chosen} and "
            f"the rig {b} bones: they belong to another mesh or rig"
        )


def _boundary(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    check_indices("E", E, len(V), "vertices")
    if not len(E):
        raise ValueError("the mesh has no triangle")
    E = seamless(V, E)
    distinct = (np.diff(np.sort(E, axis=1), axis=1) > 0).all(axis=1)
    if V.shape[1] == 3:
        return E[distinct] if distinct.any() else E
    # Of triangles over the same vertices one counts.
    E = E[np.sort(np.unique(np.sort(E, axis=1), axis=0, return_index=True)[1])]
    area = element_volumes(V, E)
    return boundary_facets(np.where((area < 0)[:, None], E[:, [0, 2, 1]], E)[area != 0])
