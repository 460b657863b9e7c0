"""Distances of the union of rigid parts, on arrays."""

import numpy as np
from scipy.spatial import cKDTree

from nilbs.engine.array_engine import ArrayAnswers
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.grids import Grid

# Cells along the longest edge of the grid that bounds how far the shape reaches beyond the vertices of a part.
RESOLUTION = 32
# In units of the body's longest edge: the smallest distance of a place that no part holds.
SMALLEST = 1e-6
# In those units: a distance above this may be returned too small.
NEAR = 0.1


class RigidPieces:
    """Distances of the union of rigid parts.

    The weights at a place are those of the nearest vertex of the surface or the volume. The distance is the exact one
    to the rest shape at the deepest candidate that lies in its own part. If there is none it is positive and at most
    the distance to the nearest part, which may be the cut between two. The cut itself is no surface: at a place inside
    it does not count.
    """

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray, V_volume: np.ndarray, W_volume: np.ndarray) -> None:
        self.V, self.F, self.W = V, F, W
        places = np.concatenate([V, V_volume])
        self.owner = np.concatenate([W, W_volume]).argmax(axis=1)
        self.tree = cKDTree(places)
        reach = self._reach()
        self.lower = np.full((W.shape[1], V.shape[1]), np.inf)
        self.upper = -self.lower
        np.minimum.at(self.lower, self.owner, places - reach)
        np.maximum.at(self.upper, self.owner, places + reach)
        # One tree for all parts: a further coordinate holds them so far apart that a query stays within its own.
        self.apart = 10 * (np.linalg.norm(np.ptp(places, axis=0)) + reach)
        self.part_tree = cKDTree(np.column_stack([places, self.apart * self.owner]))

    def __call__(self, B: np.ndarray) -> ArrayAnswers:
        """Distances and canonical points in a pose."""
        d = self.V.shape[1]
        linear, offset = B[:, :d, :d].copy(), B[:, :d, d, None]
        # A bone that flattens space has no inverse: its candidates lie far away.
        singular = np.abs(np.linalg.det(linear)) < 1e-12
        linear[singular] = np.eye(d)
        inverse = np.linalg.inv(linear)
        translation = -inverse @ offset
        translation[singular] = (self.V.max(axis=0) + 10 * np.ptp(self.V, axis=0).max())[:, None]
        return lambda x: self._answers((inverse @ x.T + translation).swapaxes(1, 2))

    def _answers(self, candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance and canonical point of queries whose bones' rigid inverses are `candidates` (b, n, d)."""
        # A part lies in its box, so beyond the box the distance to the box is a bound.
        beyond = np.maximum(np.maximum(self.lower[:, None] - candidates, candidates - self.upper[:, None]), 0)
        value = np.linalg.norm(beyond, axis=2)
        bone, point = np.nonzero(value == 0)
        place = candidates[bone, point]
        own = self.owner[self.tree.query(place)[1]] == bone
        value[bone[own], point[own]] = signed_distance(self.V, self.F, place[own])
        exact = np.zeros(value.shape, dtype=bool)
        exact[bone[own], point[own]] = True
        # The smallest bound is made exact until the smallest value is exact.
        point = np.arange(candidates.shape[1])
        while len(point):
            bone = value[:, point].argmin(axis=0)
            open_ = ~exact[bone, point] & (value[bone, point] < NEAR)
            bone, point = bone[open_], point[open_]
            value[bone, point] = np.maximum(value[bone, point], self._bound(bone, candidates[bone, point]))
            exact[bone, point] = True
        nearest, n = value.argmin(axis=0), np.arange(candidates.shape[1])
        return value[nearest, n], candidates[nearest, n]

    def _bound(self, bone: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Least distances from places to the parts of bones that do not hold them.

        A step changes the distances to the nearest vertex of the part and of another by its length at most, so half
        their difference lies between here and the part. And a part lies in the shape.
        """
        near, _ = self.tree.query(place)
        far, _ = self.part_tree.query(np.column_stack([place, self.apart * bone]))
        return np.maximum(np.maximum((far - near) / 2, signed_distance(self.V, self.F, place)), SMALLEST)

    def _reach(self) -> float:
        """How far a place in the shape may lie from the nearest vertex, a bound."""
        grid = Grid.box(self.V, RESOLUTION)
        nodes = grid.points()
        step = grid.spacing * np.sqrt(nodes.shape[1]) / 2  # no place in the grid is farther from a node
        close = nodes[signed_distance(self.V, self.F, nodes) <= step]
        return float(self.tree.query(close)[0].max(initial=0)) + step
