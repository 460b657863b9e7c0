"""Consistent orientation of facets."""

import numpy as np

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.topology import group_labels, ridges
from nilbs.geometry.validation import arrays


def coherent_orientation(V: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn facets so that neighbours agree on which side is outside.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets; d is 2 or 3. Facets are edges in the plane, triangles in space.

    Returns
    -------
    F : (m, d) int array
        The same facets in the same order, some of them turned around.
    flipped : (m,) bool array
        Which facets were turned.

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Notes
    -----
    Neighbours are two facets at an edge (in the plane: at a vertex) that no third one shares. In each patch of
    neighbours the side that has more area stays as it is: a closed patch that is inside out stays so. A patch with one
    side only, such as a Moebius strip, keeps at least as many neighbours that agree as it had.

    Every facet stands in a graph twice, as it is and turned around, and is joined to the neighbour's copy that agrees
    with it; a patch with two sides falls apart into the two.

    Examples
    --------
    >>> V = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 1, 0]]
    >>> F, flipped = coherent_orientation(V, [[0, 1, 2], [0, 3, 2], [1, 4, 2]])
    >>> F.tolist(), flipped.tolist()
    ([[0, 1, 2], [0, 2, 3], [1, 4, 2]], [False, True, False])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    m = len(F)
    if not m:
        return F.copy(), np.zeros(0, dtype=bool)
    first, second, alike = ridges(F).neighbours()
    patch = group_labels(first, second, m)
    turned, one_sided = _sides(first, second, alike, m)
    if one_sided.any():
        # Along a tree of its neighbours every patch has two sides; elsewhere these may disagree.
        tree = _tree(first, second, alike, m)
        along_tree, _ = _sides(first[tree], second[tree], alike[tree], m)
        turned = np.where(one_sided, along_tree, turned)
    area = facet_areas(V, F)
    majority = np.bincount(patch, np.where(turned, -area, area), minlength=m) >= 0
    turned = turned == majority[patch]
    # Patches that do not gain neighbours that agree stay as they were.
    before = np.bincount(patch[first], ~alike, minlength=m)
    after = np.bincount(patch[first], alike == (turned[first] != turned[second]), minlength=m)
    flipped = turned & (after < before)[patch]
    return np.where(flipped[:, None], F[:, [0, 2, 1] if F.shape[1] == 3 else [1, 0]], F), flipped


def _sides(first: np.ndarray, second: np.ndarray, alike: np.ndarray, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Facets on one of the two sides of their patch, and those whose patch has one side only."""
    copy = np.where(alike, second, second + m)
    other = np.where(alike, second + m, second)
    label = group_labels(np.concatenate([first, first + m]), np.concatenate([copy, other]), 2 * m)
    return label[:m] > label[m:], label[:m] == label[m:]


def _tree(first: np.ndarray, second: np.ndarray, alike: np.ndarray, m: int) -> np.ndarray:
    """Pairs that join every patch without a loop, as many that agree as can be."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    # Two facets may be neighbours twice; a graph holds one edge for them.
    _, once = np.unique(np.minimum(first, second) * m + np.maximum(first, second), return_index=True)
    cost = once + 1.0 + ~alike[once] * len(first)
    graph = coo_array((cost, (first[once], second[once])), shape=(m, m)).tocsr()
    return np.rint((minimum_spanning_tree(graph).data - 1) % max(len(first), 1)).astype(np.int64)
