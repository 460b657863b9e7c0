"""Weights on a grid, fitted so that interpolation gives the surface its own."""

import numpy as np
from scipy.sparse import csr_array

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_values
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.validation import arrays, check_indices

# Samples of the surface on the area of a cell's face, and the most of all.
SAMPLES, MOST = 12, 2**21
ROUNDS = 3
# In samples that lie about a node on average: a node with fewer changes little.
DAMPING = 0.05
BONES = 32  # fitted at once; bounds the memory


def fit_to_skin(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray,
    grid: Grid,
    node: np.ndarray,
    W_node: np.ndarray,
    *,
    rng: np.random.Generator,
) -> np.ndarray:
    """Weights of grid nodes (s,), changed where multilinear interpolation misses those of the surface.

    The surface V, F has weights W, the nodes have W_node. Cells with a corner without weights are left out. Row sums
    stay.

    Notes
    -----
    Weights change within a cell, most of all where the surface is folded or thin. A few rounds of the simultaneous
    iterative reconstruction technique [1]_ take the mean of what samples about a node miss onto the node. More would
    fit two sheets that share a cell with weights of their own by values far outside 0 to 1.

    References
    ----------
    .. [1] Gilbert, Iterative methods for the three-dimensional reconstruction of an object from projections, 1972,
       doi:10.1016/0022-5193(72)90180-4.
    """
    V, F, W = arrays(V=(V, "n d"), F=(F, "m d", int), W=(W, "n b"))
    node, W_node = arrays(node=(node, "s", int), W_node=(W_node, f"s {W.shape[1]}"))
    check_indices("node", node[:, None], grid.size, "nodes of the grid")
    area = facet_areas(V, F).sum() / grid.spacing ** (V.shape[1] - 1)
    x, facet = facet_samples(V, F, int(min(np.ceil(SAMPLES * area), MOST)), rng=rng)
    at, A = _interpolation(grid, node, x)
    near = np.flatnonzero(np.bincount(A.indices, minlength=len(node)))
    fitted = W_node.copy()
    if not len(near):  # no node is at the surface
        return fitted
    A = A[:, near]
    back = A.T.tocsr()
    share = np.asarray(A.sum(axis=0))[:, None]
    share = 1 / (share + DAMPING * share.mean())
    for start in range(0, W.shape[1], BONES):
        bones = slice(start, start + BONES)
        W_surface, W_near = facet_values(V, F, W[:, bones], x[at], facet[at]), W_node[near, bones]
        for _ in range(ROUNDS):
            W_near = W_near + share * (back @ (W_surface - A @ W_near))
        fitted[near, bones] = W_near
    return fitted


def _interpolation(grid: Grid, node: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Points (p,) that lie among the nodes, and how much each of these counts for them, (p, s)."""
    position = (x - grid.origin) / grid.spacing
    cells = np.array(grid.shape) - 1
    cell = np.clip(position.astype(int), 0, cells - 1)
    place = np.full(grid.size, -1, dtype=np.int32)
    place[node] = np.arange(len(node))
    corners = np.argwhere(np.ones((2,) * len(cells), dtype=bool))
    index = place[np.ravel_multi_index(tuple(np.moveaxis(cell[:, None] + corners, -1, 0)), grid.shape)]
    share = np.where(corners, (position - cell)[:, None], 1 - (position - cell)[:, None]).prod(axis=2)
    at = np.flatnonzero((index >= 0).all(axis=1) & (share >= 0).all(axis=1))
    first = np.arange(len(at) + 1) * len(corners)
    return at, csr_array((share[at].ravel(), index[at].ravel(), first), shape=(len(at), len(node)))
