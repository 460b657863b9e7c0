"""Weights on a grid, fitted so that interpolation gives the surface its own."""

import numpy as np
from scipy.sparse import csr_array, diags_array

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_shares
from nilbs.geometry.rest_grids import scaled_rows
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.validation import arrays, check_indices

# Samples of the surface on the area of a cell's face, and the most of all.
SAMPLES, MOST = 12, 2**20
ROUNDS = 8
# In samples that lie about a node on average: a node with fewer changes little.
DAMPING = 0.05


def fit_to_skin(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray | csr_array,
    grid: Grid,
    node: np.ndarray,
    W_node: np.ndarray | csr_array,
    *,
    smallest: float = 0.0,
    rng: np.random.Generator,
) -> csr_array:
    """Weights of grid nodes (s,), changed where multilinear interpolation misses those of the surface.

    The surface V, F has weights W, the nodes have W_node. Cells with a corner without weights are left out. Weights
    below `smallest` are dropped on the way; rows sum to one.

    Notes
    -----
    Weights change within a cell, most of all where the surface is folded or thin. A few rounds of the simultaneous
    iterative reconstruction technique [1]_ take the mean of what samples about a node miss onto the node. More would
    fit two sheets that share a cell with weights of their own by values far outside 0 to 1.

    With the interpolation A at samples that have the weights S W, a round adds D A^T (S W - A W_node); A^T A and A^T S
    W are computed once, so that a round costs the same for any number of samples.

    References
    ----------
    .. [1] Gilbert, Iterative methods for the three-dimensional reconstruction of an object from projections, 1972,
       doi:10.1016/0022-5193(72)90180-4.
    """
    V, F, node = arrays(V=(V, "n d"), F=(F, "m d", int), node=(node, "s", int))
    check_indices("node", node[:, None], grid.size, "nodes of the grid")
    W, W_node = csr_array(W), csr_array(W_node)
    if (W.shape[0], W_node.shape) != (len(V), (len(node), W.shape[1])):
        raise ValueError(f"W and W_node must be (n, b) = ({len(V)}, b) and (s, b) = ({len(node)}, b)")
    area = facet_areas(V, F).sum() / grid.spacing ** (V.shape[1] - 1)
    x, facet = facet_samples(V, F, int(min(np.ceil(SAMPLES * area), MOST)), rng=rng)
    at, A = _interpolation(grid, node, x)
    near = np.unique(A.indices)
    if not len(near):  # no node is at the surface
        return scaled_rows(W_node, smallest=smallest)
    A = csr_array(A[:, near])
    back = csr_array(A.T)
    share = A.sum(axis=0)
    damped = diags_array(1 / (share + DAMPING * share.mean()))
    wanted = damped @ (csr_array(back @ facet_shares(V, F, x[at], facet[at])) @ W)
    read = damped @ csr_array(back @ A)
    W_near = start = W_node[near]
    for _ in range(ROUNDS):
        W_near = scaled_rows(csr_array(W_near + wanted - read @ W_near), smallest=smallest)
    # Rows of nodes at the surface change, and no others.
    place = csr_array((np.ones(len(near)), (near, np.arange(len(near)))), shape=(len(node), len(near)))
    return scaled_rows(csr_array(W_node + place @ csr_array(W_near - start)), smallest=smallest)


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
