"""Where searches start: cells of the rest pose, moved by a pose and sorted into a grid around the posed body.

A cell is small enough that its image is nearly a parallelepiped, so that the inverse of one linear map takes a posed
point close to its canonical points. A point that lies in the image of no cell is far outside the body.
"""

from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import compiled
from nilbs.engine.weights import Weights
from nilbs.geometry.weight_blocks import ONE

# Cells are divided where weights in them are farther from multilinear than this.
BENT = 0.04
# How far the image of a cell may reach beyond what its corners say: times their deviation from the linear map, and in
# edges of the cell.
STRETCH, MARGIN = 1.5, 0.1
# The most cells of the finest grid around the posed body along an edge, and how many times it is coarsened.
FINEST, LEVELS = 128, 8


class Lattice(NamedTuple):
    """Cells (c) of the rest pose around the body, and the weights of their corners."""

    node: np.ndarray  # (n, 3) rest places of the corners
    first: np.ndarray  # (n + 1,) where the bones of a corner begin
    bone: np.ndarray
    weight: np.ndarray
    corner: np.ndarray  # (c, 8) nodes of each cell, the last axis running fastest
    center: np.ndarray  # (c, 3)
    edge: np.ndarray  # (c, 3)

    @classmethod
    def of(cls, weights: Weights, chosen: np.ndarray) -> Self:
        """Cells of chosen blocks (j,), divided where weights bend."""
        m = np.array(weights.cells)
        place = np.empty((len(chosen) * m.prod(), 3), dtype=np.int32)
        size, block = np.empty_like(place), np.empty(len(place), dtype=np.int32)
        count = _divided(weights, chosen, BENT, place, size, block)
        place, size, block = place[:count], size[:count], block[:count]
        corner = place[:, None] + size[:, None] * np.array(list(np.ndindex(2, 2, 2)))
        shape = corner.reshape(-1, 3).max(axis=0, initial=0) + 1
        flat = np.ravel_multi_index(tuple(corner.reshape(-1, 3).T), tuple(shape))
        _, one, which = np.unique(flat, return_index=True, return_inverse=True)
        at, block = corner.reshape(-1, 3)[one], block[one // 8]
        n0, n1, n2 = (at - weights.place[block]).T
        within = (n0 * (m[1] + 1) + n1) * (m[2] + 1) + n2
        bones = np.diff(weights.first)[block]
        ends = np.cumsum(bones)
        entry = np.arange(bones.sum()) - np.repeat(ends - bones, bones)
        nodes = (m + 1).prod()
        weight = weights.weight[entry + np.repeat(nodes * weights.first[block] + within * bones, bones)]
        return cls(
            (weights.origin + weights.spacing * at).astype(np.float32),
            np.concatenate([[0], ends]).astype(np.int32),
            weights.bone[entry + np.repeat(weights.first[block], bones)],
            (weight / np.float32(ONE)).astype(np.float32),
            which.reshape(-1, 8).astype(np.int32),
            (weights.origin + weights.spacing * (place + size / 2)).astype(np.float32),
            (weights.spacing * size).astype(np.float32),
        )


class Starts(NamedTuple):
    """A lattice in a pose.

    Cells are kept in grids of doubled edges, each in the finest whose cells are not much smaller than its image.
    """

    center: np.ndarray  # (c, 3) centre of the images of its corners
    inverse: np.ndarray  # (c, 9) inverse of the linear map, from space into edges of the cell
    reach: np.ndarray  # (c, 3) how far from the centre the image extends, in edges
    lower: np.ndarray  # (c, 3) corners of a box around the image
    upper: np.ndarray
    origin: np.ndarray  # (3,) of all grids
    edge: np.ndarray  # (l,) of the cells of each grid
    shape: np.ndarray  # (l, 3)
    base: np.ndarray  # (l + 1,) where the cells of each grid begin in `first`
    first: np.ndarray  # where the members of a grid's cell begin
    member: np.ndarray  # cells of the lattice

    @classmethod
    def of(cls, lattice: Lattice, B: np.ndarray) -> Self:
        """The starts in a pose (b, 12)."""
        n, c = len(lattice.node), len(lattice.corner)
        x = np.empty((n, 3), dtype=np.float32)
        _posed(lattice, B, x)
        center, reach, lower, upper = (np.empty((c, 3), dtype=np.float32) for _ in range(4))
        inverse = np.empty((c, 9), dtype=np.float32)
        _images(lattice, x, center, inverse, reach, lower, upper)
        origin = lower.min(axis=0, initial=0) if not c else lower.min(axis=0)
        extent = upper.max(axis=0, initial=-np.inf) - origin if c else np.zeros(3, dtype=np.float32)
        finest = max(float(lattice.edge[:, 0].max(initial=0)), float(extent.max()) / FINEST, 1e-6)
        edge = (finest * 2.0 ** np.arange(LEVELS)).astype(np.float32)
        shape = (extent / edge[:, None]).astype(np.int64) + 1
        base = np.concatenate([[0], np.cumsum(shape.prod(axis=1))])
        level = np.empty(c, dtype=np.int64)
        first = np.zeros(base[-1] + 1, dtype=np.int64)
        _count(lower, upper, origin, edge, shape, base, level, first)
        member = np.empty(int(first[-1]), dtype=np.int32)
        _fill(lower, upper, origin, edge, shape, base, level, first, member)
        return cls(center, inverse, reach, lower, upper, origin, edge, shape, base, first, member)
