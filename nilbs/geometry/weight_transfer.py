"""Skinning weights of a mesh from those of a rigged one that it fits: clothes, a remesh, another level of detail."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from nilbs.geometry.distance import closest_points
from nilbs.geometry.domain import WELD
from nilbs.geometry.facets import facet_normals, seamless
from nilbs.geometry.interpolation import facet_shares
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.plane import in_space
from nilbs.geometry.topology import group_labels
from nilbs.geometry.validation import arrays, check_indices
from nilbs.geometry.weights import simplex_projection

DISTANCE, ANGLE = 0.05, 30.0  # as in the paper
# How far each triangle stays from collapsing, in mean edges: the sum of two edges less the third.
MOLLIFIED = 1e-5


@dataclass(frozen=True)
class TransferredWeights:
    """Weights W (n, b) of a mesh from another one, and where they come from.

    `accepted` (n,) marks vertices with the weights of a matching closest point, `filled` (n,) those that are
    interpolated over the mesh. All others have the weights of the closest point although it does not match. `notes`
    holds a sentence on these.
    """

    W: np.ndarray
    accepted: np.ndarray
    filled: np.ndarray
    notes: tuple[str, ...]


def transfer_weights(
    V: np.ndarray,
    E: np.ndarray,
    V_source: np.ndarray,
    E_source: np.ndarray,
    W_source: np.ndarray,
    *,
    distance: float = DISTANCE,
    angle: float = ANGLE,
    both_sides: bool = False,
) -> TransferredWeights:
    """Weights of a mesh from those of a rigged mesh that it fits, such as clothes, a remesh or a level of detail.

    Parameters
    ----------
    V, E : (n, d) float array and (m, 3) int array
        Vertices, in mesh units, and triangles of the mesh without weights; d is 2 or 3.
    V_source, E_source : (k, d) float array and (l, 3) int array
        Vertices, in the same units and place, and triangles of the rigged mesh.
    W_source : (k, b) float array
        Its weights; rows on the simplex.
    distance : float
        How far the closest point of a match may be, as a part of the diagonal of the mesh's box.
    angle : float
        The largest angle between the normals of a match, in degrees. In the plane, normals do not count.
    both_sides : bool
        Accept closest points that face the other way, too: for clothes with a lining, and for meshes that are inside
        out.

    Returns
    -------
    transferred : TransferredWeights
        `W` (n, b), rows on the simplex; `accepted` and `filled`, (n,) each, mark where they come from; `notes` holds a
        sentence on vertices that are neither.

    Raises
    ------
    ValueError
        If the sizes disagree, an index does not exist, the source has no triangle, W_source leaves the simplex, or
        `distance` or `angle` is out of range.

    Notes
    -----
    The method of [1]_. A vertex whose closest point on the source is near and faces its way takes the weights there.
    In space, the closest point has the normal of its triangle, or that interpolated between the triangle's corners,
    whichever agrees better: a smooth and a coarse source both match. The weights W of the other vertices minimise
    trace W' L M^-1 L W, with the cotangent Laplacian L and the mass matrix M. Edges are lengthened by a tiny amount, so
    that no triangle is degenerate [2]_. The result is projected on the simplex. Vertices at one place count as one. A
    piece without a match, and a vertex without a triangle, takes the weights of the closest points.

    Two parts of [1]_ are left out: the term L in the energy, which depends on the unit of length and changes little,
    and the final smoothing, which also blurs the matches about filled vertices and makes weights worse.

    References
    ----------
    .. [1] Abdrashitov et al., Robust skin weights transfer via weight inpainting, SIGGRAPH Asia 2023 Technical
       Communications, doi:10.1145/3610543.3626180.
    .. [2] Sharp, Crane, A Laplacian for nonmanifold triangle meshes, SGP 2020, doi:10.1111/cgf.14069.

    Examples
    --------
    >>> V_source, E_source = [[0, 0], [2, 0], [2, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> W_source = [[1, 0], [0, 1], [0, 1], [1, 0]]
    >>> transfer_weights([[0, 0], [1, 0], [0.5, 1]], [[0, 1, 2]], V_source, E_source, W_source).W
    array([[1.  , 0.  ],
           [0.5 , 0.5 ],
           [0.75, 0.25]])
    """
    V, E, V_source, E_source, W_source = arrays(
        V=(V, "n d"), E=(E, "m 3", "V"), V_source=(V_source, "k d"), E_source=(E_source, "l 3", int),
        W_source=(W_source, "k b"),
    )  # fmt: skip
    check_indices("E_source", E_source, len(V_source), "vertices of the source")
    if not len(E_source):
        raise ValueError("the source has no triangle")
    if W_source.min(initial=0) < -1e-9 or np.abs(W_source.sum(axis=1) - 1).max() > 1e-9:
        raise ValueError("rows of W_source must be non-negative and sum to one")
    if not distance >= 0:
        raise ValueError(f"distance must be a part of the mesh's diagonal, 0 or more, got {distance}")
    if not 0 <= angle <= 90:
        raise ValueError(f"angle must be 0 to 90 degrees, got {angle}")
    n = len(V)
    # Triangles of the plane are a surface in space, whose closest place is the point itself where it is in one.
    V, V_source, flat = in_space(V), in_space(V_source), V.shape[1] == 2
    far, facet, place = closest_points(V_source, E_source, V)
    W = np.minimum(facet_shares(V_source, E_source, place, facet) @ W_source, 1)  # rounding may exceed it
    used, first, triangles = _welded(V, E)
    if not len(triangles):
        return TransferredWeights(W, np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), _notes(n, n, 0, 0))
    x = V[used]
    size = _diagonal(x)
    accepted = far[used] <= distance * size
    if not flat:
        agreement = _agreement(x, triangles, V_source, E_source, place[used], facet[used], both_sides)
        accepted &= agreement >= np.cos(np.radians(angle))
    piece = group_labels(np.repeat(triangles[:, 0], 2), triangles[:, 1:].ravel(), len(x))
    filled = ~accepted & np.isin(piece, piece[accepted])
    W_used = W[used]
    W_used[filled] = _filled(x / (size or 1.0), triangles, accepted, filled, W_used)
    # Every vertex of a triangle takes what its place has; others keep the weights of the closest point.
    known = first >= 0
    first = first[known]
    W[known] = W_used[first]
    marks = np.zeros((2, n), dtype=bool)
    marks[:, known] = accepted[first], filled[first]
    left = int((~marks.any(axis=0)).sum())
    lost = len(np.unique(piece[~(accepted | filled)]))
    return TransferredWeights(W, marks[0], marks[1], _notes(n, left, lost, len(np.unique(piece))))


def _notes(n: int, left: int, lost: int, pieces: int) -> tuple[str, ...]:
    """A sentence on vertices whose closest point does not match, on `lost` of the mesh's pieces or on none."""
    if not left:
        return ()
    where = f"{left} of {n} vertices, with {lost} of {pieces} pieces," if lost else f"{left} of {n} vertices"
    return (
        f"{where} have no match on the source, near and facing the same way, to start from: they take the weights of "
        "the closest points",
    )


def _welded(V: np.ndarray, E: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mesh with one vertex at each place.

    Returns the vertices (u,) that stay, which of these stands for each vertex (n,), -1 where no triangle does, and
    triangles (t, 3), indices into (u,), without those that have two corners at one place.
    """
    joined = np.arange(len(V))
    joined[E] = _joined(V, E)
    E = joined[E]
    used, triangles = np.unique(E[(np.diff(np.sort(E, axis=1), axis=1) > 0).all(axis=1)], return_inverse=True)
    rank = np.full(len(V), -1)
    rank[used] = np.arange(len(used))
    return used, rank[joined], triangles.reshape(-1, 3)


def _joined(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Triangles that use one vertex at each place."""
    size = _diagonal(V[np.unique(E)]) or 1.0
    return seamless(np.round(V / (WELD * size)), E)


def _diagonal(x: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(x, axis=0))) if len(x) else 0.0


def _agreement(
    x: np.ndarray, E: np.ndarray, V_source: np.ndarray, E_source: np.ndarray, place: np.ndarray, facet: np.ndarray,
    both_sides: bool,
) -> np.ndarray:  # fmt: skip
    """Cosine of the angle between the normals of vertices (u,) and of their closest points."""
    E, _ = coherent_orientation(x, E)
    E_source, _ = coherent_orientation(V_source, _joined(V_source, E_source))
    smooth = _unit(facet_shares(V_source, E_source, place, facet) @ _vertex_normals(V_source, E_source))
    normal = _vertex_normals(x, E)
    cosine = np.stack([(normal * other).sum(axis=1) for other in (smooth, facet_normals(V_source, E_source)[facet])])
    return (np.abs(cosine) if both_sides else cosine).max(axis=0)


def _vertex_normals(V: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Mean normals of the triangles about each vertex, weighted by their angles; zero where they cancel."""
    normal = facet_normals(V, E)
    total = np.zeros_like(V)
    for k in range(3):
        a, b = (V[E[:, (k + step) % 3]] - V[E[:, k]] for step in (1, 2))
        corner = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        np.add.at(total, E[:, k], corner[:, None] * normal)
    return _unit(total)


def _unit(x: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(x, axis=1, keepdims=True)
    return np.divide(x, length, out=np.zeros_like(x), where=length > 1e-9)


def _filled(x: np.ndarray, E: np.ndarray, fixed: np.ndarray, free: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Rows of the vertices in `free` that minimise the energy, from those in `fixed`; on the simplex."""
    import igl
    from scipy.sparse.linalg import splu

    if not free.any():
        return W[free]
    edge = np.stack([np.linalg.norm(x[E[:, i]] - x[E[:, j]], axis=1) for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    slack = edge.sum(axis=1) - 2 * edge.max(axis=1)
    edge += max(0.0, MOLLIFIED * edge.mean() - slack.min())
    L, mass = -igl.cotmatrix_intrinsic(edge, E), igl.massmatrix_intrinsic(edge, E).diagonal()
    K = (L @ sparse.diags(1 / mass) @ L).tocsr()[free]
    bones = W[fixed].max(axis=0) > 0
    pull = K[:, fixed] @ W[np.ix_(fixed, bones)]
    # Without pivoting, which a positive definite matrix does not need, this is as sparse as a Cholesky factor.
    factors = splu(
        K[:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    rows = np.zeros((int(free.sum()), W.shape[1]))
    rows[:, bones] = simplex_projection(factors.solve(-pull))
    return rows
