"""Poses, points, and what is true there."""

from typing import NamedTuple

import numpy as np

from nilbs.geometry.grids import Grid
from nilbs.geometry.metrics import intersection_over_union
from nilbs.geometry.sampling import near_surface_samples, uniform_samples
from nilbs.geometry.winding import winding_number
from nilbs.methods.base import NOISE
from nilbs.models.model import Model
from nilbs.race.contestants import DISTANCE
from nilbs.race.plan import NEAR

# Points at most that a score is taken of.
SCORED = 100_000
# The fast winding number is evaluated again where it is this close to one half, as far as so many angles allow.
UNSURE, ANGLES = 0.2, 4e9


class Scene(NamedTuple):
    """A pose (b, 4, 4) and posed points (n, 3), in mesh units."""

    B: np.ndarray
    x: np.ndarray


def scenes(model: Model, points: int, kind: str, poses: int, block: int, blocks: int, *, seed: int) -> list[Scene]:
    """One block of a stream of poses that are evenly spread over the model's motion; of one pose, its middle."""
    total, last = poses * blocks, len(model.motion) - 1
    found = []
    for k in range(block * poses, (block + 1) * poses):
        B = model.motion.at(frame=last * (k + 0.5) / total)
        rng = np.random.default_rng([seed, k])
        U = model.skinning.posed(B)
        if kind == NEAR:
            x = near_surface_samples(U, model.character.F, points, std=NOISE * model.character.L, rng=rng)
        else:
            cube = Grid.cube(U, 1)
            x = uniform_samples(cube.lower, cube.upper, points, rng=rng)
        found.append(Scene(B, x))
    return found


class Truth:
    """The posed mesh itself, at the first `SCORED` points of a scene."""

    def __init__(self, model: Model, scene: Scene) -> None:
        self.F, self.L = model.character.F, model.character.L
        self.U, self.x = model.skinning.posed(scene.B), scene.x[:SCORED].copy()
        self.inside = self._inside()
        self._length: np.ndarray | None = None

    def _inside(self) -> np.ndarray:
        winding = np.abs(winding_number(self.U, self.F, self.x))
        unsure = np.flatnonzero(np.abs(winding - 0.5) < UNSURE)
        unsure = unsure[: int(ANGLES / len(self.F))]
        if len(unsure):
            winding[unsure] = np.abs(winding_number(self.U, self.F, self.x[unsure], exact=True))
        return winding > 0.5

    @property
    def length(self) -> np.ndarray:
        """Distances (n,) to the surface, by libigl."""
        if self._length is None:
            import igl

            F = np.ascontiguousarray(self.F, dtype=np.int64)
            self._length = np.sqrt(igl.point_mesh_squared_distance(self.x, self.U, F)[0])
        return self._length

    def scores(self, quantity: str, answer: np.ndarray) -> dict[str, float]:
        """What a contestant's answer differs by: shares, and lengths in units of L."""
        answer = answer[:SCORED]
        inside = answer < 0 if quantity == DISTANCE else answer
        found = {
            "differing": float((inside != self.inside).mean()),
            "iou": float(intersection_over_union(inside, self.inside)),
        }
        if quantity == DISTANCE:
            error = np.abs(np.abs(answer) - self.length) / self.L
            median, p95, p99 = np.percentile(error, [50, 95, 99])
            found |= {"error_median": median, "error_p95": p95, "error_p99": p99, "error_max": error.max()}
        return {name: float(value) for name, value in found.items()}
