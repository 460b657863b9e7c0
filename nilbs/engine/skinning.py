"""Linear blend skinning of many points, in compiled code."""

import numpy as np

from nilbs.engine.compiled import PROBLEM, compiled, in_pieces
from nilbs.geometry.validation import arrays

if PROBLEM is None:
    from nilbs.engine.lanes import lane, load, spread

# Points that a thread moves at a time.
PIECE = 4096


class SparseSkinning:
    """Moves the same points by many poses; `nilbs.geometry.skinning.linear_blend_skinning` is its twin.

    Parameters
    ----------
    V : (n, d) float array
        Rest positions, in mesh units; d is 2 or 3.
    W : (n, b) float array
        Skinning weights; every row sums to one. Only those other than zero are kept.

    Raises
    ------
    ValueError
        If V and W disagree on n, or a number is not finite.
    """

    def __init__(self, V: np.ndarray, W: np.ndarray) -> None:
        V, W = arrays(V=(V, "n d"), W=(W, "n b"))
        self._V, self._bones = np.ascontiguousarray(V), W.shape[1]
        row, bone = np.nonzero(W)
        self._first = np.searchsorted(row, np.arange(len(W) + 1))
        self._bone, self._weight = bone.astype(np.int32), W[row, bone]

    def posed(self, B: np.ndarray) -> np.ndarray:
        """Posed positions, on all threads.

        Parameters
        ----------
        B : (b, d+1, d+1) float array
            Bone transforms, rest to posed, acting on column vectors (x, 1).

        Returns
        -------
        U : (n, d) float array
            In mesh units.

        Raises
        ------
        ValueError
            If B does not fit the weights, or a number is not finite.
        """
        d = self._V.shape[1]
        (B,) = arrays(B=(B, f"{self._bones} {d + 1} {d + 1}"))
        # Four lanes hold a column: of the linear part at 0 .. d-1, of the translation at 3.
        columns = np.zeros((len(B), 4, 4))
        columns[:, :d, :d] = B[:, :d, :d].transpose(0, 2, 1)
        columns[:, 3, :d] = B[:, :d, d]
        U = np.empty_like(self._V)

        def pose(begin: int, end: int) -> None:
            _pose(self._V, self._first, self._bone, self._weight, columns, U, begin, end)

        in_pieces(pose, len(U), piece=PIECE)
        return U


@compiled
def _pose(
    V: np.ndarray, first: np.ndarray, bone: np.ndarray, weight: np.ndarray, columns: np.ndarray,
    U: np.ndarray, begin: int, end: int,
) -> None:  # fmt: skip
    d = V.shape[1]
    for i in range(begin, end):
        X = Y = Z = shift = spread(0.0)
        for k in range(first[i], first[i + 1]):
            w, b = spread(weight[k]), bone[k]
            X += w * load(columns, b, 0)
            Y += w * load(columns, b, 1)
            Z += w * load(columns, b, 2)
            shift += w * load(columns, b, 3)
        u = X * spread(V[i, 0]) + Y * spread(V[i, 1]) + Z * spread(V[i, 2] if d == 3 else 0.0) + shift
        for r in range(d):
            U[i, r] = lane(u, r)
