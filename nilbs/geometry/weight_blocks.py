"""Skinning weights of the rest pose in small blocks of cells, each with the few bones that matter in it."""

from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array

from nilbs.geometry.grids import Grid

# Cells along each edge of a block.
EDGE = 4
# Weights are stored as this many parts of one, so that a 16-bit integer holds those of `LEAST` to `LARGEST`: outside
# the body weights may leave [0, 1].
ONE = 16_383
LEAST, LARGEST = -1.0, 2.0


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
    def pack(cls, node: np.ndarray, W: np.ndarray | csr_array, grid: Grid) -> Self:
        """Blocks of all nodes (s,) of a grid that have weights (s, b), and of those that share a block with them.

        The latter have the weights of the nearest node with some. Rows sum to one; one that leaves the range of what is
        stored is moved towards its own part in [0, 1], just far enough.
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
        rows = number.ravel()[_nodes(place, grid.shape)]
        return cls(place.astype(np.int32), *_by_block(rows, _rounded(csr_array(W))))

    def rows(self, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
        """The same without repeats, on the grid of that shape, as `nilbs.fields.forward.ForwardField` takes it.

        Nodes outside all blocks have the row of the nearest node inside.
        """
        at = _nodes(self.place, shape)
        nodes = at.shape[1]
        node, one = np.unique(at, return_index=True)
        block, within = one // nodes, one % nodes
        bones = np.diff(self.first)[block]
        ends = np.cumsum(bones)
        entry = np.arange(ends[-1]) - np.repeat(ends - bones, bones)
        weight = self.weight[entry + np.repeat(nodes * self.first[block] + within * bones, bones)]
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


def _nodes(place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Nodes (k, (EDGE + 1)^d) of blocks in a grid of nodes; beyond the grid its last ones."""
    local = np.argwhere(np.ones((EDGE + 1,) * len(shape), dtype=bool))
    at = np.minimum(EDGE * place[:, None] + local, np.array(shape) - 1)
    return np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), shape)


def _rounded(W: csr_array) -> csr_array:
    """Weights in parts of `ONE`, which they sum to in every row, each less than a part from what it was."""
    W = _bounded(W)
    row = np.repeat(np.arange(W.shape[0]), np.diff(W.indptr))
    parts = np.floor(W.data * ONE)
    whole = parts.astype(np.int32)
    # Of what is left over, the largest remainders get a part each.
    order = np.lexsort((parts - W.data * ONE, row))
    left = ONE - np.bincount(row, whole, minlength=W.shape[0]).astype(np.int64)
    rank = np.arange(len(order)) - W.indptr[row[order]]
    whole[order] += rank < left[row[order]]
    return csr_array((whole, W.indices, W.indptr), shape=W.shape)


def _bounded(W: csr_array) -> csr_array:
    """Rows that sum to one, each moved towards its own part in [0, 1] as far as `LEAST` and `LARGEST` need."""
    row = np.repeat(np.arange(W.shape[0]), np.diff(W.indptr))
    positive = np.maximum(W.data, 0)
    positive /= np.bincount(row, positive, minlength=W.shape[0])[row]
    away = W.data - positive
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.where(away > 0, (LARGEST - positive) / away, (LEAST - positive) / away)
    share = np.ones(W.shape[0])
    np.minimum.at(share, row[away != 0], most[away != 0])
    return csr_array((positive + share[row] * away, W.indices, W.indptr), shape=W.shape)


def _by_block(rows: np.ndarray, W: csr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First, bone and weight of `WeightBlocks`, from the rows (k, nodes) of its nodes."""
    k, nodes = rows.shape
    count = np.diff(W.indptr)[rows.ravel()]
    ends = np.cumsum(count)
    entry = np.arange(ends[-1]) + np.repeat(W.indptr[rows.ravel()] - ends + count, count)
    place = np.repeat(np.arange(k * nodes), count)  # block and node of the entry
    block, node = place // nodes, place % nodes
    there = np.zeros((k, W.shape[1]), dtype=bool)
    there[block, W.indices[entry]] = True
    first = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    which = (np.cumsum(there, axis=1, dtype=np.int32) - 1)[block, W.indices[entry]]
    out = np.zeros(nodes * first[-1], dtype=np.int16)
    out[nodes * first[block] + node * np.diff(first)[block] + which] = W.data[entry]
    return first.astype(np.int64), np.nonzero(there)[1].astype(np.int32), out
