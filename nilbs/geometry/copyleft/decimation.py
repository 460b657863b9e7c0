"""Surfaces with fewer triangles, by MeshLab (pymeshlab, GPL)."""

import numpy as np

from nilbs.geometry.validation import arrays, check_indices


def decimated(V: np.ndarray, F: np.ndarray, facets: int) -> tuple[np.ndarray, np.ndarray]:
    """Surface with fewer triangles that keeps its shape and topology.

    Parameters
    ----------
    V : (n, 3) float array
        Vertices.
    F : (m, 3) int array
        Triangles.
    facets : int
        How many are wanted; a surface that has no more is returned as it is.

    Returns
    -------
    V_few : (n', 3) float array
    F_few : (m', 3) int array
        Where the topology forbids more collapses, somewhat more than wanted.

    Raises
    ------
    ValueError
        If the sizes disagree.

    Notes
    -----
    Edges are collapsed in the order of their quadric errors [1]_.

    References
    ----------
    .. [1] Garland, Heckbert, Surface simplification using quadric error metrics, SIGGRAPH 1997,
       doi:10.1145/258734.258849.

    Examples
    --------
    >>> from nilbs.geometry.grids import Grid
    >>> from nilbs.geometry.level_sets import isosurface
    >>> grid = Grid.cube([[-1, -1, -1], [1, 1, 1]], 20)
    >>> V, F = isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)
    >>> len(decimated(V, F, 200)[1])
    200
    """
    V, F = arrays(V=(V, "n 3"), F=(F, "m 3", int))
    check_indices("F", F, len(V), "vertices")
    if len(F) <= facets:
        return V, F
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V, F))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=facets, preservetopology=True, preservenormal=True, planarquadric=True
    )
    few = meshes.current_mesh()
    return few.vertex_matrix(), few.face_matrix().astype(np.int64)
