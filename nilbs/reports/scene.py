"""Coloured surfaces as one GLB file, for the scene of a page."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from nilbs.figures.canvas import BODY
from nilbs.figures.views import View

if TYPE_CHECKING:
    from nilbs.geometry.surface import Surface


def scene_of_surfaces(surfaces: Mapping[str, "tuple[Surface, np.ndarray | None]"], view: View) -> bytes:
    """Surfaces in space as meshes of a GLB file, turned so that the view's up is +Y and its viewer at +Z.

    Parameters
    ----------
    surfaces : mapping of str to (Surface, (n, 3) array or None)
        By name: vertices and triangles, and colours of the vertices from 0 to 1; one colour where there are none. What
        has no triangle is left out.
    view : View

    Returns
    -------
    glb : bytes
    """
    import trimesh
    from matplotlib.colors import to_rgb

    meshes: dict[str, trimesh.parent.Geometry] = {}
    for name, ((U, F), colours) in surfaces.items():
        if len(F):
            paint = np.broadcast_to(to_rgb(BODY) if colours is None else colours, (len(U), 3))
            opaque = np.column_stack([np.round(255 * paint), np.full(len(U), 255)]).astype(np.uint8)
            meshes[name] = trimesh.Trimesh(U @ view.axes.T, F, vertex_colors=opaque, process=False)
    glb: bytes = trimesh.Scene(meshes).export(file_type="glb") if meshes else b""
    return glb
