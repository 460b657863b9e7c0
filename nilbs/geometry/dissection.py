"""Cholesky factors of the sparse matrices of a mesh, in dense blocks."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy import sparse

LEAF = 160  # unknowns of a part that is not cut further
# Right-hand sides that one thread solves for at once; there are two such parts at least.
COLUMNS = 96


class Front(NamedTuple):
    """Unknowns `start` to `stop`, which are eliminated together, and the later ones that this couples, `border`.

    `children` are the fronts before it whose update goes into this one.
    """

    start: int
    stop: int
    border: np.ndarray
    children: tuple[int, ...]


class Dissection:
    """Symmetric positive definite matrices that differ in their diagonals, solved in one order of elimination.

    Parameters
    ----------
    K : (n, n) sparse matrix
        Symmetric; its pattern is, too.
    V : (n, d) float array
        Where the unknowns are.
    pool : ThreadPoolExecutor
        Threads to work in; how many there are changes no digit, as long as BLAS itself uses one.

    Notes
    -----
    Nested dissection [1]_: a plane cuts the unknowns in two halves; those of one half that are coupled to the other
    are eliminated after both, and each half is cut in the same way. Cholesky's method then runs on one dense block a
    part [2]_.

    References
    ----------
    .. [1] George, Nested dissection of a regular finite element mesh, 1973, doi:10.1137/0710032.
    .. [2] Duff, Reid, The multifrontal solution of indefinite sparse symmetric linear equations, 1983,
       doi:10.1145/356044.356047.

    Examples
    --------
    >>> with ThreadPoolExecutor() as pool:
    ...     dissection = Dissection(sparse.csc_matrix([[2.0, -1], [-1, 2]]), np.eye(2), pool)
    ...     dissection.solver(np.array([1.0, 1]))(np.array([[2.0], [2]])).round(6).tolist()
    [[1.0], [1.0]]
    """

    def __init__(self, K: sparse.csc_matrix, V: np.ndarray, pool: ThreadPoolExecutor) -> None:
        self.pool = pool
        parts, below = zip(*_parts(K, V), strict=True)
        self.order = np.concatenate(parts)
        self.K = K[self.order][:, self.order].tocsc()
        self.diagonal = self.K.diagonal()
        self.on_diagonal = self.K.indices == np.repeat(np.arange(len(self.order)), np.diff(self.K.indptr))
        self.fronts: list[Front] = []
        # Fronts by height: those of one height do not touch each other.
        self.levels: list[list[int]] = []
        height: list[int] = []
        stops = np.cumsum([len(part) for part in parts])
        for part, children, stop in zip(parts, below, stops, strict=True):
            start = stop - len(part)
            near = [self.K.indices[self.K.indptr[start] : self.K.indptr[stop]]]
            border = np.unique(np.concatenate(near + [self.fronts[child].border for child in children]))
            height.append(max((height[child] + 1 for child in children), default=0))
            if height[-1] == len(self.levels):
                self.levels.append([])
            self.levels[height[-1]].append(len(self.fronts))
            self.fronts.append(Front(int(start), int(stop), border[border >= stop], children))

    def solver(self, penalty: np.ndarray, dtype: type = np.float64) -> Callable[[np.ndarray], np.ndarray]:
        """The solution X of (K + diag(penalty)) X = right as a function of right (n, b), factorised here.

        The factors are of a matrix whose diagonal is scaled to one, in float64 or float32.
        """
        n = len(self.order)
        scale = 1 / np.sqrt(self.diagonal + penalty[self.order])
        values = self.K.data * scale[self.K.indices] * np.repeat(scale, np.diff(self.K.indptr))
        values[self.on_diagonal] = 1
        scaled = sparse.csc_matrix((values.astype(dtype), self.K.indices, self.K.indptr), shape=(n, n))
        factors: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        updates: dict[int, np.ndarray] = {}

        def eliminate(index: int) -> None:
            factors[index], updates[index] = self._eliminated(index, scaled, updates)

        for level in self.levels:
            for _ in self.pool.map(eliminate, level):
                pass

        def solve(right: np.ndarray) -> np.ndarray:
            scaled_right = right[self.order].astype(dtype, copy=False) * scale[:, None].astype(dtype)
            parts = np.array_split(scaled_right, max(2, -(-right.shape[1] // COLUMNS)), axis=1)
            found = list(self.pool.map(lambda part: self._solution(factors, part), parts))
            solution = np.empty_like(right)
            solution[self.order] = np.concatenate(found, axis=1) * scale[:, None].astype(dtype)
            return solution

        return solve

    def _eliminated(
        self, index: int, K: sparse.csc_matrix, updates: dict[int, np.ndarray]
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """The factors of a front, and its update of the fronts after it; updates of its children are used up."""
        from scipy.linalg import get_lapack_funcs

        front = self.fronts[index]
        own = front.stop - front.start
        entries = slice(K.indptr[front.start], K.indptr[front.stop])
        row, column = K.indices[entries], np.repeat(np.arange(own), np.diff(K.indptr[front.start : front.stop + 1]))
        later = row >= front.start
        block = np.zeros((own + len(front.border), own), dtype=K.dtype)
        block[_place(front, row[later]), column[later]] = K.data[entries][later]
        rest = np.zeros((len(front.border),) * 2, dtype=K.dtype)
        for child in front.children:
            update, at = updates.pop(child), _place(front, self.fronts[child].border)
            first = int(np.searchsorted(at, own))
            _add(block, at, at[:first], update[:, :first])
            _add(rest, at[first:] - own, at[first:] - own, update[first:, first:])
        potrf, trtri = get_lapack_funcs(("potrf", "trtri"), (block,))
        lower, problem = potrf(block[:own], lower=1, clean=1)
        if problem:
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        # The inverse of the triangle, so that every solution is two products.
        inverse, _ = trtri(lower, lower=1)
        below = block[own:] @ inverse.T
        rest -= below @ below.T
        return (inverse, below), rest

    def _solution(self, factors: dict[int, tuple[np.ndarray, np.ndarray]], right: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(right)
        for index, front in enumerate(self.fronts):
            inverse, below = factors[index]
            own = x[front.start : front.stop]
            own[:] = inverse @ own
            x[front.border] -= below @ own
        for index, front in reversed([*enumerate(self.fronts)]):
            inverse, below = factors[index]
            own = x[front.start : front.stop]
            own[:] = inverse.T @ (own - below.T @ x[front.border])
        return x


def _place(front: Front, index: np.ndarray) -> np.ndarray:
    """Where unknowns stand in a front."""
    own = front.stop - front.start
    return np.where(index < front.stop, index - front.start, own + np.searchsorted(front.border, index))


def _add(matrix: np.ndarray, rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> None:
    """`matrix[rows[:, None], columns] += values`, for which numpy takes some four times as long."""
    matrix.reshape(-1)[rows[:, None] * matrix.shape[1] + columns] += values


def _parts(K: sparse.csc_matrix, V: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[int, ...]]]:
    """Parts in the order of their elimination, each with the places in it of those that it separates."""
    count = 0

    def cut(part: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[int, ...]]]:
        nonlocal count
        below = []
        if len(part) > LEAF:
            halves, part = _halves(K, V, part)
            for half in halves:
                if len(half):
                    yield from cut(half)
                    below.append(count - 1)
        yield part, tuple(below)
        count += 1

    yield from cut(np.arange(K.shape[0]))


def _halves(K: sparse.csc_matrix, V: np.ndarray, part: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Two halves without a coupling, and the unknowns between them: as few as a plane along an axis finds."""
    inner = K[part][:, part].tocsr()
    inner.data = np.ones_like(inner.data)
    cuts = []
    for x in V[part].T:
        first = np.zeros(len(part), dtype=bool)
        first[np.argsort(x, kind="stable")[: len(part) // 2]] = True
        cuts.append((first, first & (inner @ ~first > 0)))
    first, between = min(cuts, key=lambda cut: int(cut[1].sum()))
    return (part[first & ~between], part[~first]), part[between]
