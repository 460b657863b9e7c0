"""A rigged character: its surface, its skeleton, its skinning weights and the volume that they are known in."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nilbs.geometry.handles import bone_conditions
from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.triangles import conforming_triangles
from nilbs.geometry.validation import arrays, check_indices
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.weights import biharmonic_energy, bounded_biharmonic_weights, extend_weights

Report = Callable[[str], None]


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
    C : (k, d) float array
        Joints at rest.
    BE : (b, 2) int array
        Bones, indices into C.
    P : (b,) int array
        Parent bones, -1 at a root.
    names : tuple of str
        Names of the bones.
    W : (n, b) float array
        Skinning weights of V; rows on the simplex.
    V_volume : (n', d) float array
        Vertices of the volume mesh; the first n are V.
    T : (t, d+1) int array
        Its positively oriented elements. Empty where the surface could not be filled.
    W_volume : (n', b) float array
        Weights of V_volume.
    """

    name: str
    V: np.ndarray
    F: np.ndarray
    C: np.ndarray
    BE: np.ndarray
    P: np.ndarray
    names: tuple[str, ...]
    W: np.ndarray
    V_volume: np.ndarray
    T: np.ndarray
    W_volume: np.ndarray

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.V.shape[1]

    @property
    def L(self) -> float:
        """Longest edge of the rest mesh's bounding box, the unit of every reported length."""
        return float(np.ptp(self.V, axis=0).max())


@dataclass(frozen=True)
class SolvedWeights:
    """Bounded biharmonic weights on a volume mesh, and how good they are.

    Attributes
    ----------
    V, T, W : arrays
        Volume mesh and weights, (n', d), (t, d+1) and (n', b); the surface's vertices come first.
    energy : float
        Half the sum over bones of w' L M^-1 L w.
    method : str
        "joint" or "igl".
    """

    V: np.ndarray
    T: np.ndarray
    W: np.ndarray
    energy: float
    method: str


def load_character(
    mesh: str | Path,
    rig: str | Path,
    weights: str | Path | None = None,
    *,
    progress: bool = False,
    report: Report | None = None,
) -> Character:
    """Read a rigged character from files; solve for its weights where none are given.

    Parameters
    ----------
    mesh : path
        OBJ or PLY; a flat one (z = 0) is a character in the plane.
    rig : path
        Joints and bones, `.tgf`.
    weights : path, optional
        Skinning weights of the mesh's vertices, `.dmat` or `.npz`. Bounded biharmonic weights by default.
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
        If the files do not fit each other, or the mesh cannot be filled with elements that hold the bones.
    OSError
        If a file cannot be opened.
    """
    from nilbs.io.mesh import read_mesh
    from nilbs.io.tgf import read_tgf
    from nilbs.io.weights import read_weights

    V, E = read_mesh(mesh)
    C, BE = read_tgf(rig)
    W = None if weights is None else read_weights(weights)
    try:
        return assemble(V, E, C, BE, W, name=Path(mesh).stem, progress=progress, report=report)
    except ValueError as error:
        files = f"{mesh} with {rig}" + ("" if weights is None else f" and {weights}")
        raise ValueError(f"{files}: {error}") from error


def assemble(
    V: np.ndarray,
    E: np.ndarray,
    C: np.ndarray,
    BE: np.ndarray,
    W: np.ndarray | None = None,
    *,
    name: str = "character",
    progress: bool = False,
    report: Report | None = None,
) -> Character:
    """Make a character of arrays; solve for its weights where none are given.

    Parameters
    ----------
    V : (n, d) float array
        Rest vertices.
    E : (t, 3) or (m, 3) int array
        Triangles: those that fill the shape in the plane, those of its surface in space.
    C : (k, 2) or (k, 3) float array
        Joints; a flat mesh takes their first two coordinates.
    BE : (b, 2) int array
        Bones, indices into C.
    W : (n, b) float array, optional
        Weights of V; rows that do not sum to one are normalised, and that is reported.
    name, progress, report
        As for `load_character`.

    Returns
    -------
    character : Character

    Raises
    ------
    ValueError
        As for `load_character`.
    """
    report = report or (lambda line: None)
    V, E, BE = arrays(V=(V, "n d"), E=(E, "m 3", int), BE=(BE, "b 2", int))
    C = rig_in_mesh_dimension(V, C)
    F = _boundary(V, E)
    if not len(BE):
        raise ValueError("the rig has no bone")
    check_joints_near(V, C)
    P = bone_parents(BE)
    if W is None:
        solved = solve_weights(V, E, C, BE, progress=progress)
        V_volume, T, W_volume = solved.V, solved.T, solved.W
    else:
        W = _normalized(W, len(V), len(BE), report)
        try:
            V_volume, T = volume_mesh(V, E, C, BE)
            W_volume = extend_weights(V_volume, T, W)
        except ValueError as error:
            report(f"no volume mesh ({error}); weights are supervised at the surface only")
            V_volume, T, W_volume = V, np.zeros((0, V.shape[1] + 1), dtype=np.int64), W
    names = tuple(f"bone{bone}" for bone in range(len(BE)))
    return Character(name, V, F, C, BE, P, names, W_volume[: len(V)].copy(), V_volume, T, W_volume)


def solve_weights(
    V: np.ndarray, E: np.ndarray, C: np.ndarray, BE: np.ndarray, *, method: str = "joint", progress: bool = False
) -> SolvedWeights:
    """Bounded biharmonic weights of a rigged mesh: fill it, find the bones' conditions, solve.

    Parameters
    ----------
    V, E, C, BE
        As for `assemble`.
    method : "joint" or "igl"
        Which solver; see `bounded_biharmonic_weights`.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    solved : SolvedWeights

    Raises
    ------
    ValueError
        If the mesh cannot be filled, or a bone lies outside.
    """
    V, E, BE = arrays(V=(V, "n d"), E=(E, "m 3", int), BE=(BE, "b 2", int))
    C = rig_in_mesh_dimension(V, C)
    V_volume, T = volume_mesh(V, E, C, BE)
    fixed, W_fixed = bone_conditions(V_volume, C, BE)
    W = bounded_biharmonic_weights(V_volume, T, fixed, W_fixed, method=method, progress=progress)
    return SolvedWeights(V_volume, T, W, biharmonic_energy(V_volume, T, W), method)


def volume_mesh(V: np.ndarray, E: np.ndarray, C: np.ndarray, BE: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elements that fill a rigged mesh and hold its bones: its own triangles refined, or TetGen's tetrahedra.

    Parameters
    ----------
    V, E, C, BE
        As for `assemble`.

    Returns
    -------
    V_volume : (n', d) float array
        The given vertices first.
    T : (t, d+1) int array
        Positively oriented elements.

    Raises
    ------
    ValueError
        If the surface is not closed or crosses itself.
    """
    if np.shape(V)[1] == 2:
        return conforming_triangles(V, E, C, BE)
    from nilbs.geometry.copyleft.tetrahedra import conforming_tetrahedra

    return conforming_tetrahedra(V, E, C, BE)


def rig_in_mesh_dimension(V: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Joints in as many dimensions as the mesh: a flat mesh takes the first two coordinates of a flat rig.

    Parameters
    ----------
    V : (n, d) float array
        Rest vertices.
    C : (k, 2) or (k, 3) float array
        Joints.

    Returns
    -------
    C : (k, d) float array

    Raises
    ------
    ValueError
        If the mesh is flat and the rig is not, or the other way round.
    """
    V, C = arrays(V=(V, "n d"), C=(C, "k c"))
    if V.shape[1] == 2 and C.shape[1] == 3:
        if np.abs(C[:, 2]).max(initial=0) > 1e-6 * np.linalg.norm(np.ptp(C, axis=0)):
            raise ValueError(f"the mesh is flat (z = 0) but joint {int(np.abs(C[:, 2]).argmax())} is not")
        return C[:, :2].copy()
    if V.shape[1] != C.shape[1]:
        raise ValueError(f"the mesh has {V.shape[1]} dimensions but the rig has {C.shape[1]}")
    return C


def check_joints_near(V: np.ndarray, C: np.ndarray) -> None:
    """Refuse a rig that does not belong to the mesh.

    Parameters
    ----------
    V : (n, d) float array
        Rest vertices.
    C : (k, d) float array
        Joints.

    Raises
    ------
    ValueError
        If a joint lies further outside the mesh's bounding box than half the box's diagonal.
    """
    lower, upper = V.min(axis=0), V.max(axis=0)
    outside = np.linalg.norm(np.maximum(np.maximum(lower - C, C - upper), 0), axis=1)
    far = int(outside.argmax())
    if outside[far] > 0.5 * np.linalg.norm(upper - lower):
        raise ValueError(
            f"joint {far} at {C[far].round(4).tolist()} lies far outside the mesh, whose box runs from "
            f"{lower.round(4).tolist()} to {upper.round(4).tolist()}: is the rig in the same unit and frame?"
        )


def _boundary(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    check_indices("E", E, len(V), "vertices")
    if not len(E):
        raise ValueError("the mesh has no triangle")
    if not np.ptp(V, axis=0).min() > 0:
        raise ValueError(f"the mesh has no extent along axis {int(np.ptp(V, axis=0).argmin())}")
    if V.shape[1] == 3:
        return E
    area = element_volumes(V, E)
    return boundary_facets(np.where((area < 0)[:, None], E[:, [0, 2, 1]], E)[area != 0])


def _normalized(W: np.ndarray, n: int, b: int, report: Report) -> np.ndarray:
    (W,) = arrays(W=(W, "n b"))
    if W.shape != (n, b):
        raise ValueError(
            f"the weights have {W.shape[0]} rows and {W.shape[1]} columns, but the mesh has {n} vertices and the rig "
            f"{b} bones: they belong to another mesh or rig"
        )
    clipped = np.maximum(W, 0)
    sums = clipped.sum(axis=1)
    if not (sums > 0).all():
        raise ValueError(f"vertex {int(np.argmin(sums))} has no positive weight")
    change = np.abs(clipped / sums[:, None] - W).max()
    if change > 1e-6:
        report(f"weights were clipped at zero and their rows normalised; the largest change is {change:.2g}")
    return clipped / sums[:, None]
