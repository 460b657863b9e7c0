"""Bounded biharmonic weights: every bone at once, every row on the simplex."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy import sparse

from nilbs.geometry.dissection import Dissection
from nilbs.geometry.validation import arrays

# The penalties of the splitting, in two norms one after the other; lengths are in diagonals of the domain. With the
# mass matrix, a soft penalty settles the smooth large part of the weights and a hard one the steep small part, so it
# goes from hard to soft and back. The diagonal of the energy, which depends on how fine the elements are, settles what
# is left around the bones. On eighteen small shapes the result is within 1.4e-4 of the least energy, and within 0.009
# of the exact weights; but 0.012 to 0.022 on three in the plane whose bones cross.
MASS_PENALTIES = (1e7, 3e5, 1e4, 3e5, 1e7)
ENERGY_PENALTIES = (1e-1, 1e-2)
# Of that diagonal, in every penalty: where an element has hardly any volume, rounding would hide a smaller one.
STEEPEST = 1e-11
# A penalty has done its work when no weight changed by more than this in a few iterations, one after the other.
CHANGE, CALM = 2e-4, 3


def bounded_biharmonic_weights(
    V: np.ndarray,
    T: np.ndarray,
    fixed: np.ndarray,
    W_fixed: np.ndarray,
    *,
    method: str = "joint",
    iterations: int = 20,
    progress: bool = False,
) -> np.ndarray:
    """Smooth weights that are one on their own bone, zero on the others, and convex everywhere.

    Parameters
    ----------
    V, T : (n, d) float array and (t, d+1) int array
        Vertices and elements of a volume mesh: triangles or tetrahedra.
    fixed : (f,) int array
        Vertices whose weights are known, without repetition.
    W_fixed : (f, b) float array
        Their weights; rows on the simplex.
    method : "joint" or "igl"
        "joint" solves for all bones together. "igl" is the reference, `igl.bbw` at 50 iterations, bone by bone, then
        clipped and normalised.
    iterations : int
        The most iterations at each penalty of the joint solver.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    W : (n, b) float array
        Rows on the simplex to rounding: 0 <= W <= 1 and row sums of one. A vertex that no element uses has the weights
        of the nearest one that is used, unless it is fixed itself.

    Raises
    ------
    ValueError
        If the sizes disagree, W_fixed leaves the simplex, an index does not exist or is repeated, a bone is fixed only
        at vertices that no element uses, or a part of the mesh that no fixed vertex touches leaves the weights
        undetermined.

    Notes
    -----
    Minimises 1/2 sum_b w_b' L M^-1 L w_b, eq. 1 of [1]_, with libigl's cotangent Laplacian L and mass matrix M, over
    all bones at once, so that the partition of unity is part of the problem. The alternating direction method of
    multipliers [2]_ repeats a linear solve, one factorisation for all bones, and a projection of every row on the
    simplex [3]_. The result is the projected iterate, so its bounds and sums do not depend on convergence. The penalty
    changes in stages, each of which starts from the weights and multipliers of the one before.

    References
    ----------
    .. [1] Jacobson et al., Bounded biharmonic weights for real-time deformation, SIGGRAPH 2011,
       doi:10.1145/2010324.1964973.
    .. [2] Boyd et al., Distributed optimization and statistical learning via the alternating direction method of
       multipliers, 2011, doi:10.1561/2200000016.
    .. [3] Duchi et al., Efficient projections onto the l1-ball, ICML 2008, doi:10.1145/1390156.1390191.

    Examples
    --------
    >>> V, T = [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]], [[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4]]
    >>> W = bounded_biharmonic_weights(V, T, [0, 3, 2, 5], [[1, 0], [1, 0], [0, 1], [0, 1]])
    >>> W[[1, 4]].round(3)
    array([[0.5, 0.5],
           [0.5, 0.5]])
    """
    V, T, fixed, W_fixed = arrays(V=(V, "n d"), T=(T, "t d+1", "V"), fixed=(fixed, "f", "V"), W_fixed=(W_fixed, "f b"))
    if len(np.unique(fixed)) < len(fixed):
        raise ValueError("fixed names a vertex twice")
    if len(W_fixed) and (W_fixed.min() < -1e-9 or np.abs(W_fixed.sum(axis=1) - 1).max() > 1e-9):
        raise ValueError("rows of W_fixed must be non-negative and sum to one")
    used, T = _compact(T)
    # A vertex without an element (a surface vertex twice in the file) has its weights but holds nothing.
    holds = np.isin(fixed, used)
    lost = np.flatnonzero((W_fixed.max(axis=0, initial=0) > 0) & (W_fixed[holds].max(axis=0, initial=0) <= 0))
    if len(lost):
        raise ValueError(f"bone {lost[0]} is held only by vertices that belong to no element")
    x, _ = _unit(V[used])
    K, mass = _energy_matrix(x, T)
    held = np.searchsorted(used, fixed[holds])
    _check_every_part_is_held(K, held, used)
    if method == "igl":
        import igl

        W_used = np.clip(igl.bbw(x, T, held, W_fixed[holds], max_iter=50), 0, 1)
        W_used /= W_used.sum(axis=1, keepdims=True)
    elif method == "joint":
        W_used = _joint(x, K, mass, held, W_fixed[holds], iterations, progress)
    else:
        raise ValueError(f"method must be 'joint' or 'igl', got {method!r}")
    W = _nearest_rows(V, used, W_used)
    W[fixed] = W_fixed
    return W


def biharmonic_energy(V: np.ndarray, T: np.ndarray, W: np.ndarray) -> float:
    """Half the sum over bones of w' L M^-1 L w, which bounded biharmonic weights minimise.

    In mesh units to the power d - 4.
    """
    V, T, W = arrays(V=(V, "n d"), T=(T, "t d+1", "V"), W=(W, "n b"))
    used, T = _compact(T)
    x, size = _unit(V[used])
    K, _ = _energy_matrix(x, T)
    # For constant weights rounding may give less than zero.
    return max(0.0, 0.5 * float(np.einsum("ij,ij->", W[used], K @ W[used]))) * size ** (V.shape[1] - 4)


def extend_weights(V: np.ndarray, T: np.ndarray, W_known: np.ndarray) -> np.ndarray:
    """Weights of a volume mesh from those of its first vertices (n, b): the harmonic extension, on the simplex.

    A harmonic function takes its largest and smallest values on the boundary, so the extension keeps bounds and sums;
    the projection repairs what obtuse elements break.
    """
    import igl

    V, T, W_known = arrays(V=(V, "n d"), T=(T, "t d+1", "V"), W_known=(W_known, "k b"))
    if len(W_known) > len(V):
        raise ValueError(f"W_known has {len(W_known)} rows, more than the {len(V)} vertices")
    used, T = _compact(T)
    known = np.flatnonzero(used < len(W_known))
    solved = np.zeros((len(used), W_known.shape[1]))
    if len(known):
        solved = igl.harmonic(_unit(V[used])[0], T, known, W_known[used[known]], 1)
    W = _nearest_rows(V, used, simplex_projection(solved))
    W[: len(W_known)] = W_known
    return W


def simplex_projection(W: np.ndarray) -> np.ndarray:
    """Nearest rows that are non-negative and sum to one.

    Parameters
    ----------
    W : (n, b) float array
        Any rows.

    Returns
    -------
    W_simplex : (n, b) float array
        Rows on the simplex, to rounding.

    Raises
    ------
    ValueError
        If W is not a matrix of finite numbers.

    Examples
    --------
    >>> simplex_projection([[0.6, 0.6, -0.5]])
    array([[0.5, 0.5, 0. ]])
    """
    (W,) = arrays(W=(W, "n b"))
    return _simplex(W)


def _simplex(W: np.ndarray) -> np.ndarray:
    # The amount to subtract is the one for which the positive entries that are left sum to one. It starts too small and
    # grows with every entry that it leaves behind, until none is.
    shift = np.maximum(W.max(axis=1) - 1, (W.sum(axis=1) - 1) / W.shape[1])
    rows, kept = np.arange(len(W)), np.full(len(W), -1)
    while len(rows):
        part = W[rows]
        above = part >= shift[rows, None]
        count = above.sum(axis=1)
        shift[rows] = (np.where(above, part, 0).sum(axis=1) - 1) / np.maximum(count, 1)
        rows, kept = rows[count != kept], count[count != kept]
    return np.clip(W - shift[:, None], 0, 1)


def _compact(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices that elements use, ascending, and the elements as indices into those."""
    used, place = np.unique(T, return_inverse=True)
    return used, place.reshape(T.shape)


def _unit(V: np.ndarray) -> tuple[np.ndarray, float]:
    """Vertices around the origin with a diagonal of one, and the diagonal: no answer depends on the mesh's unit."""
    size = float(np.linalg.norm(np.ptp(V, axis=0))) if len(V) else 0.0
    return ((V - (V.min(axis=0) + V.max(axis=0)) / 2) / size, size) if size > 0 else (V, 1.0)


def _energy_matrix(V: np.ndarray, T: np.ndarray) -> tuple[sparse.csc_matrix, np.ndarray]:
    import igl

    L = igl.cotmatrix(V, T)
    mass = igl.massmatrix(V, T, igl.MASSMATRIX_TYPE_DEFAULT).diagonal()
    if len(mass) and not mass.min() > 0:
        raise ValueError(f"vertex {int(mass.argmin())} of the volume mesh touches only elements without volume")
    K = L @ sparse.diags(1 / mass) @ L
    return ((K + K.T) / 2).tocsc(), mass


def _check_every_part_is_held(K: sparse.csc_matrix, fixed: np.ndarray, used: np.ndarray) -> None:
    count, part = sparse.csgraph.connected_components(K, directed=False)
    loose = np.setdiff1d(np.arange(count), part[fixed])
    if len(loose):
        vertex = used[np.flatnonzero(part == loose[0])[0]]
        raise ValueError(
            f"{len(loose)} of the mesh's {count} separate parts (one holds vertex {vertex}) touch no bone, "
            "so their weights are undetermined; connect the parts or give each a bone"
        )


def _joint(
    V: np.ndarray,
    K: sparse.csc_matrix,
    mass: np.ndarray,
    fixed: np.ndarray,
    W_fixed: np.ndarray,
    iterations: int,
    progress: bool,
) -> np.ndarray:
    """Weights by the alternating direction method of multipliers."""
    from threadpoolctl import threadpool_limits
    from tqdm import tqdm

    n, b = K.shape[0], W_fixed.shape[1]
    W = np.ones((n, b))
    W[fixed] = W_fixed
    free = np.setdiff1d(np.arange(n), fixed)
    if not len(free) or b == 1:
        return W
    rows = K[free]
    K, pull, mass = rows[:, free].tocsc(), rows[:, fixed] @ W_fixed, mass[free]
    steep = K.diagonal()
    stages = [rho * mass + STEEPEST * steep for rho in MASS_PENALTIES] + [rho * steep for rho in ENERGY_PENALTIES]
    # Two stages with one penalty share its factors.
    last = {penalty.tobytes(): stage for stage, penalty in enumerate(stages)}
    # Numpy's products release the interpreter lock; more threads in BLAS would only compete.
    with (
        threadpool_limits(1, "blas"),
        ThreadPoolExecutor(os.cpu_count()) as pool,
        tqdm(total=len(stages) * iterations, desc="weights", unit="it", disable=not progress, delay=2) as bar,
    ):
        dissection = Dissection(K, V[free], pool)
        softest = stages[int(np.argmin(MASS_PENALTIES))]
        solvers = {softest.tobytes(): dissection.solver(softest)}
        Z = _simplex(solvers[softest.tobytes()](-pull))
        multipliers = np.zeros_like(Z)
        for stage, penalty in enumerate(stages):
            key = penalty.tobytes()
            solve = solvers.pop(key, None) or dissection.solver(penalty)
            if last[key] > stage:
                solvers[key] = solve
            column = penalty[:, None]
            Y = multipliers / column
            calm = 0
            for done in range(iterations):
                # Over-relaxation by 1.6, Boyd et al., section 3.4.3.
                relaxed = 1.6 * solve(-(column * (Y - Z) + pull)) - 0.6 * Z
                Z, before = _simplex(relaxed + Y), Z
                Y += relaxed - Z
                bar.update()
                calm = calm + 1 if np.abs(Z - before).max() < CHANGE else 0
                if calm == CALM:
                    bar.total -= iterations - done - 1
                    break
            multipliers = Y * column
    W[free] = Z
    return W


def _nearest_rows(V: np.ndarray, used: np.ndarray, W_used: np.ndarray) -> np.ndarray:
    """Spread rows of the used vertices to all: every other vertex takes those of the nearest one."""
    from scipy.spatial import cKDTree

    W = np.zeros((len(V), W_used.shape[1]))
    W[used] = W_used
    rest = np.setdiff1d(np.arange(len(V)), used)
    if len(rest) and len(used):
        W[rest] = W_used[cKDTree(V[used]).query(V[rest])[1]]
    return W
