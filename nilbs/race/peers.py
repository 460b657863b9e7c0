"""Contestants that query the posed mesh by other libraries.

All skin by `nilbs.engine.skinning`, so that none waits for slow skinning, and get points in their own precision.
"""

from typing import Any

import numpy as np

from nilbs.models.model import Model
from nilbs.race.contestants import DISTANCE, OCCUPANCY, Kind


class _OfMesh:
    """What is skinned in every pose."""

    def __init__(self, model: Model, quantity: str, threads: int) -> None:
        self.F, self.skinning = np.ascontiguousarray(model.character.F, dtype=np.int64), model.skinning
        self.V = model.character.V
        self.quantity, self.threads = quantity, threads

    def points(self, x: np.ndarray) -> Any:
        """The points in single precision."""
        return np.ascontiguousarray(x, dtype=np.float32)

    def skinned(self, B: np.ndarray) -> np.ndarray:
        """Posed vertices (n, 3) in single precision."""
        return self.skinning.posed(B).astype(np.float32)


class Libigl(_OfMesh):
    """Fast winding number, and the closest point by libigl's tree; both are built in every pose."""

    def points(self, x: np.ndarray) -> np.ndarray:
        """The points as they are."""
        return x

    def pose(self, B: np.ndarray) -> None:
        """Skin and build."""
        import igl

        self.U = self.skinning.posed(B)
        self.winding = igl.FastWindingNumberBVH()
        self.winding.init(self.U, self.F)
        if self.quantity == DISTANCE:
            self.tree = igl.AABB()
            self.tree.init(self.U, self.F)

    def query(self, x: np.ndarray) -> np.ndarray:
        """By the absolute winding number."""
        inside = np.abs(self.winding.winding_number(x)) > 0.5
        if self.quantity == OCCUPANCY:
            return inside
        length = np.sqrt(self.tree.squared_distance(self.U, self.F, x)[0])
        return np.where(inside, -length, length)


class Open3D(_OfMesh):
    """RaycastingScene, which counts the crossings of a ray; it has no refit."""

    def pose(self, B: np.ndarray) -> None:
        """Skin and build."""
        from open3d import core, t

        U = self.skinned(B)
        self.scene = t.geometry.RaycastingScene(nthreads=self.threads)
        self.scene.add_triangles(core.Tensor.from_numpy(U), core.Tensor.from_numpy(self.F.astype(np.uint32)))
        self.query(U[:1])  # what is built at the first query belongs to the pose

    def query(self, x: np.ndarray) -> np.ndarray:
        """By the parity of crossings."""
        from open3d import core

        x = core.Tensor.from_numpy(x)
        if self.quantity == DISTANCE:
            return self.scene.compute_signed_distance(x, nthreads=self.threads).numpy()
        return self.scene.compute_occupancy(x, nthreads=self.threads).numpy() > 0.5


class Embree(_OfMesh):
    """trimesh, whose rays embreex casts; it has no refit."""

    def points(self, x: np.ndarray) -> np.ndarray:
        """The points as they are."""
        return x

    def pose(self, B: np.ndarray) -> None:
        """Skin and build."""
        from trimesh import Trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self.scene = RayMeshIntersector(Trimesh(self.skinning.posed(B), self.F, process=False))
        self.query(self.V[:1])  # what is built at the first query belongs to the pose

    def query(self, x: np.ndarray) -> np.ndarray:
        """By the parity of crossings."""
        return self.scene.contains_points(x)


class Mesdf(_OfMesh):
    """The code of pysdf: distance from the triangles around the nearest vertex; updated in every pose."""

    def __init__(self, model: Model, quantity: str, threads: int) -> None:
        import mesdf

        super().__init__(model, quantity, threads)
        # mesdf reads these arrays in every pose, and does not keep them alive.
        self.U, self.facets = self.V.astype(np.float32), self.F.astype(np.uint32)
        self.sdf = mesdf.SDF(self.U, self.facets, True, False)

    def pose(self, B: np.ndarray) -> None:
        """Skin and update."""
        self.U[:] = self.skinning.posed(B)
        self.sdf.update()

    def query(self, x: np.ndarray) -> np.ndarray:
        """By the parity of crossings; its own distances are positive inside."""
        if self.quantity == DISTANCE:
            return -np.ravel(self.sdf(x, False, self.threads))
        return np.ravel(self.sdf.contains(x, self.threads))


class Fcpw(_OfMesh):
    """A tree of boxes that is refitted in every pose."""

    def __init__(self, model: Model, quantity: str, threads: int) -> None:
        import fcpw

        super().__init__(model, quantity, threads)
        self.scene = fcpw.scene_3D()
        self.scene.set_object_count(1)
        self.scene.set_object_vertices(np.asfortranarray(self.V, dtype=np.float32), 0)
        self.scene.set_object_triangles(np.asfortranarray(self.F, dtype=np.int32), 0)
        self.scene.build(fcpw.aggregate_type.bvh_surface_area, True)

    def points(self, x: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
        """The points as a list of fcpw and as an array, and how far to search."""
        import fcpw

        x = x.astype(np.float32)
        return fcpw.float_3D_list(list(x)), np.asfortranarray(x), np.full(len(x), np.inf, dtype=np.float32)

    def pose(self, B: np.ndarray) -> None:
        """Skin and refit."""
        import fcpw

        # Vertices that are set as an array are not those that refit reads.
        self.scene.update_object_vertices(fcpw.float_3D_list(list(self.skinned(B))), 0)
        self.scene.refit()

    def query(self, x: tuple[Any, np.ndarray, np.ndarray]) -> np.ndarray:
        """By the parity of crossings."""
        import fcpw

        points, places, far = x
        inside = fcpw.uint32_list([0] * len(far))
        self.scene.contains(points, inside)
        inside = np.array(list(inside), dtype=bool)
        if self.quantity == OCCUPANCY:
            return inside
        found = fcpw.interaction_3D_list()
        self.scene.find_closest_points(places, far, found)
        length = np.array([place.d for place in found])
        return np.where(inside, -length, length)


class Warp(_OfMesh):
    """NVIDIA Warp's mesh, refitted in every pose, with the sign of its winding number."""

    device = "cuda"

    def __init__(self, model: Model, quantity: str, threads: int) -> None:
        from nilbs.race.warp_mesh import WarpMesh

        super().__init__(model, quantity, threads)
        self.mesh = WarpMesh(self.V, self.F, self.device)

    def pose(self, B: np.ndarray) -> None:
        """Skin, move to the device and refit."""
        self.mesh.refit(self.skinned(B))

    def query(self, x: np.ndarray) -> np.ndarray:
        """Points are moved to the device and answers back."""
        distance = self.mesh.signed_distance(x)
        return distance if self.quantity == DISTANCE else distance < 0


_BOTH = (OCCUPANCY, DISTANCE)
KINDS = (
    Kind("libigl", _BOTH, Libigl, "igl", "libigl", "fast winding number; for distances also the tree of boxes"),
    Kind("Open3D", _BOTH, Open3D, "open3d", "open3d-cpu", "RaycastingScene, built in every pose; crossings of one ray"),
    Kind("trimesh + embreex", (OCCUPANCY,), Embree, "embreex", "embreex", "built in every pose; rays on one thread"),
    Kind("mesdf", _BOTH, Mesdf, "mesdf", "mesdf", "updated in every pose; distances are those near the closest vertex"),
    Kind("fcpw", _BOTH, Fcpw, "fcpw", "fcpw", "refitted in every pose; lists of its Python module are converted"),
    Kind("Warp", _BOTH, Warp, "warp", "warp-lang", "on a GPU, refitted in every pose; points and answers are moved"),
)
