"""The smallest smooth change of a motion that moves points as far as is demanded, linearised."""

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

# Frames over which a change acts on others, in units of the smoothing; and how soft a demand is, per squared unit.
ACTS, SOFT = 8.0, 1e-4
ITERATIONS = 400


def smoothing_inverse(n: int, smooth: float, *, held_before: bool, held_after: bool) -> np.ndarray:
    """Inverse (n, n) of I + smooth^4 D^T D, where D takes second differences of n frames.

    Where the frames before or after are held at zero (`held_before`, `held_after`), their differences count too.

    Examples
    --------
    >>> smoothing_inverse(2, 0.0, held_before=True, held_after=True).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    D = np.zeros((n + 2, n + 4))
    k = np.arange(n + 2)
    D[k, k], D[k, k + 1], D[k, k + 2] = 1.0, -2.0, 1.0
    D = D[0 if held_before else 2 : None if held_after else n][:, 2 : n + 2]
    return np.linalg.inv(np.eye(n) + smooth**4 * D.T @ D)


def least_change(
    frame: np.ndarray, slope: np.ndarray, demand: np.ndarray, inverse: np.ndarray, *, smooth: float
) -> np.ndarray:
    """The change (n, v) that minimises its square, its roughness and how far it misses the demands.

    Parameters
    ----------
    frame : (k,) int array
        Of n frames.
    slope : (k, v) float array
        How each demand's value grows with the change of its frame.
    demand : (k,) float array
        The least value of slope[k] . change[frame[k]].
    inverse : (n, n) float array
        As of `smoothing_inverse`.
    smooth : float
        The same as there.

    Returns
    -------
    change : (n, v) float array

    Notes
    -----
    The dual problem, min y^T K y / 2 - demand^T y with y >= 0, has a number y for each demand, whatever v is; K is the
    product, element by element, of the inverse between their frames and of slope slope^T.

    Examples
    --------
    >>> least_change(np.array([0]), np.array([[2.0, 0.0]]), np.array([1.0]), np.eye(1), smooth=0.0).round(3)
    array([[0.5, 0. ]])
    """
    n, v = len(inverse), slope.shape[1]
    if not len(frame):
        return np.zeros((n, v))
    order = np.argsort(frame, kind="stable")
    frame, slope, demand = frame[order], slope[order], demand[order]
    reach = int(np.ceil(ACTS * smooth)) + 1
    begin, end = np.searchsorted(frame, frame - reach), np.searchsorted(frame, frame + reach, side="right")
    rows, columns, values = [], [], []
    for f in np.unique(frame).tolist():
        mine = slice(*np.searchsorted(frame, [f, f + 1]))
        near = slice(begin[mine][0], end[mine][0])
        block = (slope[mine] @ slope[near].T) * inverse[f, frame[near]]
        rows.append(np.repeat(np.arange(mine.start, mine.stop), near.stop - near.start))
        columns.append(np.tile(np.arange(near.start, near.stop), mine.stop - mine.start))
        values.append(block.ravel())
    k = len(frame)
    K = csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(k, k))
    # Scaled to a unit diagonal, which is what makes few iterations enough.
    scale = 1 / np.sqrt(K.diagonal() + SOFT)

    def energy(z: np.ndarray) -> tuple[float, np.ndarray]:
        y = scale * z
        moved = K @ y + SOFT * y
        return float(y @ (moved / 2 - demand)), scale * (moved - demand)

    bounds = [(0.0, None)] * k
    z = minimize(energy, np.zeros(k), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS}).x
    force = np.zeros((n, v))
    np.add.at(force, frame, (scale * z)[:, None] * slope)
    return inverse @ force
