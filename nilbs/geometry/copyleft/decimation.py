"""Surfaces with fewer triangles, by MeshLab (pymeshlab, GPL)."""

import numpy as np

from nilbs.geometry.validation import arrays


def decimated(V: np.ndarray, F: np.ndarray, facets: int) -> tuple[np.ndarray, np.ndarray]:
    """A surface of about as many triangles as `facets`, of the same shape and topology.

    One that has no more is returned as it is; the topology may forbid so few.

    Notes
    -----
    Edges are collapsed in the order of their quadric errors [1]_.

    References
    ----------
    .. [1] Garland, Heckbert, Surface simplification using quadric error metrics, SIGGRAPH 1997,
       doi:10.1145/258734.258849.
    """
    V, F = arrays(V=(V, "n 3"), F=(F, "m 3", "V"))
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
