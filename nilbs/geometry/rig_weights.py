"""Bounded biharmonic weights of any rigged mesh: a volume to solve in, what the bones hold of it, and the solution."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from nilbs.geometry.distance import closest_points
from nilbs.geometry.domain import MARGIN, volume_domain
from nilbs.geometry.handles import BoneConditions, bone_conditions, bone_points, distinct_points
from nilbs.geometry.interpolation import volume_interpolation
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.topology import group_labels
from nilbs.geometry.validation import arrays, listed
from nilbs.geometry.volume import boundary_facets
from nilbs.geometry.weights import biharmonic_energy, bounded_biharmonic_weights
from nilbs.geometry.winding import occupancy

# Of the diagonal of the mesh.
SPACING = 0.03  # of the points that hold a bone; short bones have one between their joints all the same
SNAP = 0.02  # how far the vertex may be that such a point holds
REACH = 0.1  # how far outside a bone may lie and still hold the nearest place
# Every bone is one more column to solve for: with more than this the volume has fewer elements.
MANY_BONES = 64
# A rig whose joints span less of the mesh than this seems to be in another unit.
FARTHEST = 1e100  # of a coordinate: volumes of what lies farther overflow
SMALLEST_RIG = 0.03


@dataclass(frozen=True)
class SolvedWeights:
    """Bounded biharmonic weights W (n, b) of a mesh, and those of the volume that they were solved in.

    `energy` is the one that they minimise, `method` the solver. `notes` holds a sentence on every repair that mesh and
    rig needed.
    """

    W: np.ndarray
    V_volume: np.ndarray
    T: np.ndarray
    W_volume: np.ndarray
    energy: float
    method: str
    notes: tuple[str, ...]


def solve_weights(
    V: np.ndarray,
    E: np.ndarray,
    skeleton: Skeleton,
    *,
    method: str = "joint",
    reach: float = REACH,
    progress: bool = False,
) -> SolvedWeights:
    """Bounded biharmonic weights of a rigged mesh, whatever state mesh and rig are in.

    Parameters
    ----------
    V : (n, d) float array
        Vertices.
    E : (m, 3) int array
        Triangles: those that fill the shape in the plane, those of its surface in space.
    skeleton : Skeleton
        In the mesh's dimension.
    method : "joint" or "igl"
        Which solver; see `bounded_biharmonic_weights`.
    reach : float
        How far from the volume, in diagonals of the mesh, a bone may lie and still hold the nearest place of it.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    solved : SolvedWeights

    Raises
    ------
    ValueError
        If the sizes disagree, the mesh is empty, or the rig does not belong to it.

    Notes
    -----
    Bones that lie on one place share it. A bone outside holds the nearest place of the volume, within `reach`; one
    further away holds nothing and has no weight. A separate part of the volume that no bone enters follows the bone
    nearest to it.

    Examples
    --------
    >>> from nilbs.geometry.skeleton import skeleton_of_bones
    >>> V, E = [[0, 0], [2, 0], [2, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> skeleton = skeleton_of_bones([[0.5, 0.5], [1, 0.5], [1.5, 0.5]], [[0, 1], [1, 2]])
    >>> solve_weights(V, E, skeleton).W.sum(axis=1).round(6)
    array([1., 1., 1., 1.])
    """
    V, E = arrays(V=(V, "n d"), E=(E, "m 3", "V"))
    check_rig_fits(V[np.unique(E)], skeleton)
    size = float(np.linalg.norm(np.ptp(V[np.unique(E)], axis=0)))
    x, bone = bone_points(skeleton, spacing=SPACING * size)
    coarseness = max(1.0, float(np.cbrt(len(skeleton.BE) / MANY_BONES)))
    domain = volume_domain(V, E, x[distinct_points(x, MARGIN * size)], coarseness=coarseness)
    F = boundary_facets(domain.T)
    inside = occupancy(domain.V, F, x) | (closest_points(domain.V, F, x)[0] <= MARGIN * size)
    known = bone_conditions(
        domain.V, np.unique(domain.T), x, bone, inside, bones=len(skeleton.BE), snap=SNAP * size, reach=reach * size
    )
    notes = [*domain.notes, *_notes(known, skeleton)]
    if not len(known.fixed):
        raise ValueError(f"no bone lies within {reach:g} diagonals of the mesh: is the rig in the same unit and frame?")
    W_volume, lonely = _solved_by_parts(domain.V, domain.T, known, x, bone, method, progress)
    if len(lonely):
        notes.append(f"parts of the mesh that no bone enters ({len(lonely)}) follow {_named(lonely, skeleton.names)}")
    W = np.clip(volume_interpolation(domain.V, domain.T, W_volume, V), 0, 1)  # rounding leaves one by its last digit
    energy = biharmonic_energy(domain.V, domain.T, W_volume)
    return SolvedWeights(W, domain.V, domain.T, W_volume, energy, method, tuple(notes))


def check_rig_fits(V: np.ndarray, skeleton: Skeleton) -> None:
    """Refuse a rig of another dimension than the mesh, one that lies elsewhere, or one of another size."""
    C = skeleton.C[np.unique(skeleton.BE)]
    if V.shape[1] != C.shape[1]:
        raise ValueError(f"the mesh has {V.shape[1]} dimensions but the rig has {C.shape[1]}")
    if not len(V):
        raise ValueError("the mesh has no triangle")
    farthest = max(np.abs(V).max(), np.abs(C).max(initial=0))
    if farthest > FARTHEST:
        raise ValueError(f"a coordinate of the mesh or the rig is {farthest:.3g}: bring both to another unit")
    lower, upper = V.min(axis=0), V.max(axis=0)
    size, extent = float(np.linalg.norm(upper - lower)), float(np.linalg.norm(np.ptp(C, axis=0)))
    boxes = (
        f"the mesh's box runs from {_written(lower, size)} to {_written(upper, size)}, "
        f"the joints' from {_written(C.min(axis=0), size)} to {_written(C.max(axis=0), size)}"
    )
    gap = np.linalg.norm(np.maximum(np.maximum(lower - C.max(axis=0), C.min(axis=0) - upper), 0))
    if gap > REACH * size:
        raise ValueError(f"the rig lies outside the mesh: {boxes}; bring both to the same unit and frame")
    small = 0 < extent < SMALLEST_RIG * size and len(C) > 2
    if small or 0 < size < SMALLEST_RIG * extent:
        times, how = (size / extent, "smaller") if small else (extent / size, "larger")
        raise ValueError(f"the rig is {times:.3g} times {how} than the mesh: {boxes}; bring both to the same unit")


def _named(bones: Sequence[int] | np.ndarray, names: Sequence[str]) -> str:
    return listed([names[bone] for bone in bones])


def _written(x: np.ndarray, size: float) -> str:
    """A place in as many digits as matter on something of this size."""
    digits = max(0, int(np.ceil(3 - np.log10(max(size, 1e-300)))))
    return str(np.round(x, digits).tolist())


def _notes(known: BoneConditions, skeleton: Skeleton) -> list[str]:
    names, notes = skeleton.names, []
    if len(known.outside):
        notes.append(
            f"bones without a place inside hold the nearest one ({len(known.outside)}): {_named(known.outside, names)}"
        )
    if len(known.away):
        notes.append(f"bones far from the mesh move nothing ({len(known.away)}): {_named(known.away, names)}")
    # Bones that hold the same vertices.
    holds = known.W_fixed > 0
    pattern, index = np.unique(holds.T, axis=0, return_inverse=True)
    index, count = index.ravel(), np.bincount(index.ravel(), minlength=len(pattern))
    together = [bone for bone in range(len(names)) if count[index[bone]] > 1 and pattern[index[bone]].any()]
    if together:
        notes.append(f"bones on top of each other share their weights ({len(together)}): {_named(together, names)}")
    return notes


def _solved_by_parts(
    V: np.ndarray, T: np.ndarray, known: BoneConditions, x: np.ndarray, bone: np.ndarray, method: str, progress: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a volume, and the bones that parts without a bone of their own follow."""
    part = group_labels(np.repeat(T[:, 0], T.shape[1] - 1), T[:, 1:].ravel(), len(V))
    loose = ~np.isin(part, part[known.fixed])
    # A bone that holds nothing has no weight, exactly.
    holds = np.any(known.W_fixed > 0, axis=0)
    W = np.zeros((len(V), known.W_fixed.shape[1]))
    W[:, holds] = bounded_biharmonic_weights(
        V, T[~loose[T[:, 0]]], known.fixed, known.W_fixed[:, holds], method=method, progress=progress
    )
    near = ~np.isin(bone, known.away)
    distance, nearest = cKDTree(x[near]).query(V[loose])
    followed = []
    for lonely in np.unique(part[loose & np.isin(np.arange(len(V)), T)]):
        member = part[loose] == lonely
        leader = int(bone[near][nearest[member][distance[member].argmin()]])
        W[part == lonely] = np.eye(W.shape[1])[leader]
        followed.append(leader)
    return W, np.array(followed, dtype=np.int64)
