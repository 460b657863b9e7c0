"""Bounded biharmonic weights: every bone at once, every row on the simplex."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy import sparse
from tqdm import tqdm

from nilbs.geometry.acceleration import Anderson
from nilbs.geometry.dissection import Dissection
from nilbs.geometry.validation import arrays

# The penalties of the splitting: so many times the mass matrix plus so many times the diagonal of the energy matrix;
# lengths are in diagonals of the domain. On a few vertices they go from hard to soft and back: a soft penalty settles
# the smooth large part of the weights, a hard one the steep small part.
FEW_PENALTIES = ((1e7, 0), (3e5, 0), (1e4, 0), (3e5, 0), (1e7, 0), (0, 1e-1), (0, 1e-2), (0, 1e-3))
# On all, what is left is steep.
PENALTIES = ((1e7, 1e-2), (0, 3e-2))
# With that much of the diagonal, single precision is enough to solve for changes: a large mesh takes 0.6 to 0.8 of the
# time, and no weight moves by more than some 2e-4. Up to so many vertices precision is double.
DOUBLE = 5000
# Where an element has hardly any volume, rounding would hide a diagonal smaller than this.
SMALLEST = 1e-11
# Of the mass around each of the few vertices: about the stiffness between them.
STIFFNESS = 1e7
# No more vertices than this are few enough, else at least so many are chosen, and so many a bone.
SMALL, FEW, FEW_PER_BONE = 900, 300, 2
RELAXATION = 1.8
# So many steps are remembered to guess where they lead.
MEMORY = 6
# A penalty has done its work when a step changes no entry by more than this.
CHANGE = 1e-4


def bounded_biharmonic_weights(
    V: np.ndarray,
    T: np.ndarray,
    fixed: np.ndarray,
    W_fixed: np.ndarray,
    *,
    method: str = "joint",
    iterations: int = 28,
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
        The most iterations at each penalty of the joint solver; twice as many for few vertices, where they are cheap.
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
    simplex [3]_. The result is the projected iterate, so its bounds and sums do not depend on convergence.

    On a large mesh it runs twice. First only a few hundred vertices, spread evenly, keep the bounds; the energy of
    their weights, with the least energy between, is a small dense matrix, the Schur complement. From these weights a
    few tens of iterations on all vertices are enough: each starts from where the last ones lead [4]_.

    References
    ----------
    .. [1] Jacobson et al., Bounded biharmonic weights for real-time deformation, SIGGRAPH 2011,
       doi:10.1145/2010324.1964973.
    .. [2] Boyd et al., Distributed optimization and statistical learning via the alternating direction method of
       multipliers, 2011, doi:10.1561/2200000016.
    .. [3] Duchi et al., Efficient projections onto the l1-ball, ICML 2008, doi:10.1145/1390156.1390191.
    .. [4] Zhang et al., Accelerating ADMM for efficient simulation and optimization, SIGGRAPH Asia 2019,
       doi:10.1145/3355089.3356491.

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
    # The amount to subtract is the one for which the positive entries that are left sum to one. If these are the k
    # largest, it is a k-th of their sum less one, and the k-th is above it; so it is for every smaller k.
    largest = np.sort(W, axis=1)[:, ::-1]
    shift = (np.cumsum(largest, axis=1) - 1) / np.arange(1, W.shape[1] + 1, dtype=W.dtype)
    kept = np.maximum((largest > shift).sum(axis=1) - 1, 0)
    return np.clip(W - np.take_along_axis(shift, kept[:, None], axis=1), 0, 1)


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
    """Weights by the alternating direction method of multipliers, first of a few vertices, then of all."""
    from scipy.spatial import cKDTree
    from threadpoolctl import threadpool_limits

    from nilbs.geometry.progress import progress_bar

    n, b = K.shape[0], W_fixed.shape[1]
    W = np.ones((n, b))
    W[fixed] = W_fixed
    free = np.setdiff1d(np.arange(n), fixed)
    if not len(free) or b == 1:
        return W
    rows = K[free]
    K, pull, mass, steep = rows[:, free].tocsc(), rows[:, fixed] @ W_fixed, mass[free], K.diagonal()[free]
    # Numpy's products release the interpreter lock; more threads in BLAS would only compete.
    with (
        threadpool_limits(1, "blas"),
        ThreadPoolExecutor(os.cpu_count()) as pool,
        progress_bar(total=len(PENALTIES) * iterations, desc="weights", unit="it", shown=progress) as bar,
    ):
        if len(free) <= SMALL:
            dense = K.toarray()
            W[free], _ = _dense(dense, mass, pull, _simplex(np.linalg.solve(dense, -pull)), iterations)
            return W
        dissection = Dissection(K, V[free], pool)
        # Rounded, so that the same mesh in another unit has the same ties.
        x, x_fixed = np.round(V[free], 8), np.round(V[fixed], 8)
        few = _spread(x, x_fixed, max(FEW, FEW_PER_BONE * b))
        _, nearest = cKDTree(x[few]).query(x)
        share = np.bincount(nearest, mass, len(few))
        # A penalty on the few alone, taken off again below: without one, rounding would swamp the smooth weights.
        held = SMALLEST * steep
        held[few] = STIFFNESS * share
        solve = dissection.solver(held)
        X = solve(-pull)
        # Columns of the inverse; its block is the inverse of the Schur complement.
        pushed = np.zeros((len(free), len(few)))
        pushed[few, np.arange(len(few))] = 1
        response = solve(pushed)
        del solve, pushed
        S = np.linalg.inv(response[few])
        S = (S + S.T) / 2
        energy, pull_few = S - np.diag(held[few]), -S @ X[few]
        start = _simplex(np.linalg.solve(energy, -pull_few))
        Z, multipliers = _dense(energy, share, pull_few, start, iterations)
        Z = _simplex(X + response @ (S @ (Z - X[few])))
        multipliers = (mass / share[nearest])[:, None] * multipliers[nearest]
        dtype = np.float64 if len(free) <= DOUBLE else np.float32
        Z, multipliers = Z.astype(dtype), multipliers.astype(dtype)
        for stage, (of_mass, of_energy) in enumerate(PENALTIES, 1):
            penalty = of_mass * mass + of_energy * steep
            solve = dissection.solver(penalty, dtype)
            Z, multipliers = _split(K, solve, penalty, pull, Z, multipliers, _counted(iterations, bar), MEMORY)
            bar.update(stage * iterations - bar.n)
    W[free] = _simplex(Z.astype(np.float64))
    return W


def _dense(
    K: np.ndarray, mass: np.ndarray, pull: np.ndarray, Z: np.ndarray, iterations: int
) -> tuple[np.ndarray, np.ndarray]:
    """Weights and multipliers by all penalties for few vertices, one after the other."""
    multipliers = np.zeros_like(Z)
    for of_mass, of_energy in FEW_PENALTIES:
        penalty = of_mass * mass + of_energy * K.diagonal()
        inverse = np.linalg.inv(K + np.diag(penalty))
        # No guess here: it would enlarge what rounding does to a few vertices, and save little.
        Z, multipliers = _split(K, inverse.__matmul__, penalty, pull, Z, multipliers, range(2 * iterations), 0)
    return Z, multipliers


def _split(
    K: sparse.csc_matrix | np.ndarray,
    solve: Callable[[np.ndarray], np.ndarray],
    penalty: np.ndarray,
    pull: np.ndarray,
    Z: np.ndarray,
    multipliers: np.ndarray,
    steps: Iterable[object],
    memory: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Weights Z of little energy 1/2 Z' K Z + Z' pull, and their multipliers, from those given, at one penalty.

    There are as many steps as `steps` has items, or fewer. `solve` is the inverse of K + diag(penalty), which need not
    be accurate: it is used for what is left.
    """
    last = Z.shape[1] - 1
    X, left = Z.copy(), -(K @ Z.astype(np.float64) + multipliers + pull).astype(Z.dtype)
    column = penalty[:, None].astype(Z.dtype)
    Y = multipliers / column
    state, following = Z + Y, Anderson(np.sqrt(column / column.max()), memory)
    for _ in steps:
        # Multipliers of a row sum to zero, so weights do to one without a bound, too.
        X[:, :last] += solve(left[:, :last])
        X[:, last] = 1 - X[:, :last].sum(axis=1)
        state = following(state, Y + RELAXATION * X + (1 - RELAXATION) * Z)
        before = Z - Y
        Z = _simplex(state)
        Y = state - Z
        # Of the next right-hand side less the last one.
        left = column * (Z - Y - before)
        if following.largest < CHANGE:
            break
    return Z, Y * column


def _counted(iterations: int, bar: tqdm) -> Iterator[None]:
    for _ in range(iterations):
        yield
        bar.update()


def _spread(V: np.ndarray, V_fixed: np.ndarray, count: int) -> np.ndarray:
    """Vertices, at most `count`, each of which is farthest from the fixed ones and those before it."""
    from scipy.spatial import cKDTree

    distance = cKDTree(V_fixed).query(V)[0] ** 2
    chosen: list[int] = []
    while len(chosen) < count and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        away = V - V[chosen[-1]]
        distance = np.minimum(distance, np.einsum("ij,ij->i", away, away))
    return np.array(chosen)


def _nearest_rows(V: np.ndarray, used: np.ndarray, W_used: np.ndarray) -> np.ndarray:
    """Spread rows of the used vertices to all: every other vertex takes those of the nearest one."""
    from scipy.spatial import cKDTree

    W = np.zeros((len(V), W_used.shape[1]))
    W[used] = W_used
    rest = np.setdiff1d(np.arange(len(V)), used)
    if len(rest) and len(used):
        W[rest] = W_used[cKDTree(V[used]).query(V[rest])[1]]
    return W
