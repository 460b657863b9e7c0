"""A mesh of NVIDIA Warp."""

from functools import cache
from typing import Any

import numpy as np


class WarpMesh:
    """A mesh on a device, refitted in every pose.

    Parameters
    ----------
    V, F : (n, 3) float array and (m, 3) int array
        Rest vertices and triangles.
    device : str
        "cuda" or "cpu".
    """

    def __init__(self, V: np.ndarray, F: np.ndarray, device: str) -> None:
        import warp as wp

        wp.config.quiet = True
        wp.init()
        self.device = device
        points = wp.array(V.astype(np.float32), dtype=wp.vec3, device=device)
        indices = wp.array(F.astype(np.int32).ravel(), dtype=wp.int32, device=device)
        self.mesh = wp.Mesh(points, indices, support_winding_number=True)

    def refit(self, U: np.ndarray) -> None:
        """Take posed vertices (n, 3) of float32."""
        import warp as wp

        self.mesh.points.assign(U)
        self.mesh.refit()
        wp.synchronize_device(self.device)

    def signed_distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) of points (n, 3) of float32, negative inside."""
        import warp as wp

        points = wp.array(x, dtype=wp.vec3, device=self.device)
        found = wp.empty(len(x), dtype=wp.float32, device=self.device)
        wp.launch(_kernel(), dim=len(x), inputs=[self.mesh.id, points, found], device=self.device)
        return np.asarray(found.numpy())


@cache
def _kernel() -> Any:
    import warp as wp

    def signed_distance(mesh, points, found):  # type: ignore[no-untyped-def]
        i = wp.tid()
        place = wp.mesh_query_point_sign_winding_number(mesh, points[i], 1.0e30)
        closest = wp.mesh_eval_position(mesh, place.face, place.u, place.v)
        found[i] = place.sign * wp.length(points[i] - closest)

    # Types of Warp, which reads them here; they are none to a type checker.
    vectors, numbers = wp.array(dtype=wp.vec3), wp.array(dtype=wp.float32)
    signed_distance.__annotations__ = {"mesh": wp.uint64, "points": vectors, "found": numbers}
    return wp.kernel(signed_distance)
