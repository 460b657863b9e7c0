"""The forward map (eq. 4) and its derivative at rest points, from weights in blocks."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.ndimage import distance_transform_edt

from nilbs.engine.compiled import compiled
from nilbs.geometry.weight_blocks import EDGE, ONE, WeightBlocks


class Weights(NamedTuple):
    """Blocks of weights as compiled code reads them: in space, where a plane has one cell across.

    A rest point outside all blocks has the weights of the nearest place in the nearest block.
    """

    origin: np.ndarray  # (3,) position of the first node
    spacing: np.float32  # edge of a cell
    cells: tuple[int, int, int]  # of a block along each axis
    block: np.ndarray  # (n_1, n_2, n_3) number of the block of a place, or of the nearest one
    place: np.ndarray  # (k, 3) first cell of each block
    first: np.ndarray  # (k + 1,) where its bones begin
    bone: np.ndarray
    weight: np.ndarray  # of each node of a block the weights of its bones, in parts of `ONE`

    @classmethod
    def of(cls, blocks: WeightBlocks, origin: np.ndarray, spacing: float) -> Self:
        """The weights of a grid in d dimensions."""
        k, d = blocks.place.shape
        place = np.zeros((k, 3), dtype=np.int32)
        place[:, :d] = blocks.place
        there = np.full(place.max(axis=0) + 1, -1, dtype=np.int32)
        there[tuple(place.T)] = np.arange(k)
        nearest = distance_transform_edt(there < 0, return_distances=False, return_indices=True)
        weight = blocks.weight
        if d == 2:  # every node twice, on both sides of the plane
            bones = np.repeat(np.diff(blocks.first), (EDGE + 1) ** d)
            twice = np.repeat(bones, 2)
            begins = np.repeat(np.cumsum(bones) - bones, 2)
            weight = weight[np.arange(twice.sum()) + np.repeat(begins - np.cumsum(twice) + twice, twice)]
        cells = (EDGE, EDGE, EDGE if d == 3 else 1)
        return cls(
            _in_space(origin, spacing),
            np.float32(spacing),
            cells,
            there[tuple(nearest)],
            place * np.array(cells, dtype=np.int32),
            blocks.first.astype(np.int64),
            blocks.bone.astype(np.int32),
            weight,
        )


class Distances(NamedTuple):
    """Bricks of rest distances as compiled code reads them: in space, where a plane has one cell across."""

    origin: np.ndarray  # (3,) position of the first node
    spacing: np.float32  # edge of a cell of the coarsest grid
    brick: np.ndarray  # (n_1, n_2, n_3) number of a cell's brick, -1 for none
    finer: np.ndarray  # the same for cells of bricks
    values: np.ndarray  # of nodes, in parts of `unit`
    unit: np.ndarray  # (1 + divisions,) what a value of the coarsest grid, of a brick and so on is counted in
    parts: np.ndarray  # (divisions, 3) cells of a brick along each axis
    first_value: np.ndarray  # (divisions,) where its values begin
    first_cell: np.ndarray  # (divisions,) where its cells begin in `finer`, -1 for the last division

    @classmethod
    def of(cls, bricks: Mapping[str, Any], origin: np.ndarray, spacing: float) -> Self:
        """The distances of a grid in d dimensions."""
        raise NotImplementedError


def transforms(B: np.ndarray) -> np.ndarray:
    """A pose (b, d+1, d+1) as compiled code reads it: upper rows (b, 12) in space, in float32."""
    from nilbs.geometry.plane import transforms_in_space

    return np.ascontiguousarray(transforms_in_space(B)[:, :3].reshape(-1, 12), dtype=np.float32)
