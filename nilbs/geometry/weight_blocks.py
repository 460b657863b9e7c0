"""Skinning weights of the rest pose in small blocks of cells, each with the few bones that matter in it."""

from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import distance_transform_edt

from nilbs.geometry.grids import Grid

# Cells along each edge of a block.
EDGE = 4
# Weights are stored as this many parts of one; those outside the body may leave [0, 1] up to `LARGEST`.
ONE = 16_383
LARGEST = 32_767 / ONE


class WeightBlocks(NamedTuple):
    """Weights at the nodes of a grid, block by block.

    A block has `EDGE` cells along each axis, and (EDGE + 1)^d nodes, the last axis running fastest; blocks side by side
    repeat the nodes that they share. Nodes hold the weights of the bones of their block one after the other, as
    integers that sum to `ONE`.

    Attributes
    ----------
    place : (k, d) int32 array
        Where the blocks are, in blocks from the origin.
    first : (k + 1,) int64 array
        Where the bones of each block begin in `bone`; its weights begin (EDGE + 1)^d times as far in `weight`.
    bone : (s,) int32 array
        Bones, block by block.
    weight : ((EDGE + 1)^d s,) int16 array
    """

    place: np.ndarray
    first: np.ndarray
    bone: np.ndarray
    weight: np.ndarray

    @classmethod
    def pack(cls, node: np.ndarray, W: np.ndarray, grid: Grid) -> Self:
        """Blocks of all nodes (s,) of a grid that have weights (s, b), and of those that share a block with them.

        The latter have the weights of the nearest node with some.
        """
        shape = np.array(grid.shape)
        d = len(shape)
        known = np.zeros(grid.shape, dtype=bool)
        known.ravel()[node] = True
        number = np.empty(grid.shape, dtype=np.int32)
        number.ravel()[node] = np.arange(len(node))
        nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
        number = number[tuple(nearest)]
        index = np.stack(np.unravel_index(node, grid.shape), axis=-1)
        blocks = -(-(shape - 1) // EDGE)
        has = np.zeros(blocks, dtype=bool)
        for shift in np.ndindex(*(2,) * d):  # a node on a border belongs to the blocks on both sides
            has[tuple(np.clip((index - shift) // EDGE, 0, blocks - 1).T)] = True
        place = np.argwhere(has)
        local = np.argwhere(np.ones((EDGE + 1,) * d, dtype=bool))
        at = np.minimum(EDGE * place[:, None] + local, shape - 1)
        rows = number[tuple(np.moveaxis(at, -1, 0))]
        return cls(place.astype(np.int32), *_by_block(rows, *_rounded(W)))

    def rows(self, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
        """The same without repeats, on the grid of that shape, as `nilbs.fields.forward.ForwardField` takes it.

        Nodes outside all blocks have the row of the nearest node inside.
        """
        local = np.argwhere(np.ones((EDGE + 1,) * self.place.shape[1], dtype=bool))
        at = np.minimum(EDGE * self.place[:, None] + local, np.array(shape) - 1)
        node, one = np.unique(np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), shape), return_index=True)
        block, within = one // len(local), one % len(local)
        bones = np.diff(self.first)[block]
        ends = np.cumsum(bones)
        entry = np.arange(ends[-1]) - np.repeat(ends - bones, bones)
        weight = self.weight[entry + np.repeat(len(local) * self.first[block] + within * bones, bones)]
        bone = self.bone[entry + np.repeat(self.first[block], bones)]
        kept = weight != 0
        lengths = np.bincount(np.repeat(np.arange(len(node)), bones)[kept], minlength=len(node))
        row = np.full(shape, -1, dtype=np.int32)
        row.ravel()[node] = np.arange(len(node))
        nearest = distance_transform_edt(row < 0, return_distances=False, return_indices=True)
        return {
            "row": row[tuple(nearest)],
            "node": node.astype(np.int32),
            "bone": bone[kept],
            "weight": weight[kept] / ONE,
            "first": np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32),
        }


def _rounded(W: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, bone and integer weight of all weights that are not zero, row by row; each row sums to `ONE`."""
    found = []
    for begin in range(0, len(W), 2**16):  # pieces, because the table of a character with many bones is large
        part = W[begin : begin + 2**16]
        whole = np.round(np.clip(part, -LARGEST / 2, LARGEST / 2) * ONE).astype(np.int32)
        row, largest = np.arange(len(part)), part.argmax(axis=1)
        whole[row, largest] += ONE - whole.sum(axis=1)
        row, bone = np.nonzero(whole)
        found.append((row + begin, bone, whole[row, bone]))
    row, bone, weight = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return row, bone, weight


def _by_block(rows: np.ndarray, row: np.ndarray, bone: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, ...]:
    """First, bone and weight of `WeightBlocks`, from the rows (k, nodes) of its nodes and the weights of rows."""
    k, nodes = rows.shape
    lengths = np.bincount(row, minlength=rows.max() + 1)
    begins = np.concatenate([[0], np.cumsum(lengths)])
    count = lengths[rows.ravel()]
    ends = np.cumsum(count)
    entry = np.arange(ends[-1]) + np.repeat(begins[rows.ravel()] - ends + count, count)
    place = np.repeat(np.arange(k * nodes), count)  # block and node of the entry
    bones = int(bone.max()) + 1
    pair, which = np.unique(place // nodes * bones + bone[entry], return_inverse=True)
    first = np.searchsorted(pair, np.arange(k + 1) * bones)
    of_block = np.diff(first)
    block, node = place // nodes, place % nodes
    out = np.zeros(nodes * len(pair), dtype=np.int16)
    out[nodes * first[block] + node * of_block[block] + which - first[block]] = weight[entry]
    return first.astype(np.int64), (pair % bones).astype(np.int32), out
