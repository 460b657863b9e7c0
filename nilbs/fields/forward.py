"""The forward field: skinning weights of rest points, the same for every pose, kept on a grid."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

# Weights below this are not kept; the rest of the row is scaled to sum to one.
SMALLEST = 1e-4


class Forward(NamedTuple):
    """Images (n, d) of rest points, and the derivative (n, d, d) of posed by rest coordinates."""

    x: Tensor
    jacobian: Tensor


class ForwardField(nn.Module):
    """Forward skinning x = sum_b W_b(x_rest) B_b x_rest (eq. 4) with weights interpolated multilinearly on a grid.

    A pose blends the transforms once, at the grid's nodes; after that a point costs the same for any number of bones.

    Parameters
    ----------
    row : (n_1, .., n_d) int tensor
        Row of weights of every node; nodes far from the body have that of the nearest node that has one of its own.
    node : (rows,) int tensor
        The node of each row, counted with the last axis running fastest.
    bone, weight : (s,) int and float tensors
        Weights that are not zero and their bones, row by row.
    first : (rows + 1,) int tensor
        Where each row begins.
    origin : (d,) tensor
        Position of the first node.
    spacing : float
        Edge of a cell.
    """

    row: Tensor
    node: Tensor
    bone: Tensor
    weight: Tensor
    first: Tensor
    origin: Tensor

    def __init__(
        self,
        row: Tensor,
        node: Tensor,
        bone: Tensor,
        weight: Tensor,
        first: Tensor,
        origin: Tensor,
        spacing: float,
    ) -> None:
        super().__init__()
        parts = {"row": row, "node": node, "bone": bone, "weight": weight, "first": first, "origin": origin}
        for name, tensor in parts.items():
            self.register_buffer(name, tensor, persistent=False)
        self.spacing = float(spacing)

    def nodes(self) -> Tensor:
        """Rest places (rows, d) of the nodes that have weights of their own."""
        index = torch.stack(torch.unravel_index(self.node.long(), self.row.shape), dim=-1)
        return self.origin + self.spacing * index

    def blends(self, B: Tensor) -> Tensor:
        """Blended transforms (rows, d (d+1)) of all rows in a pose: the upper rows, one after the other."""
        d = B.shape[-1] - 1
        return nn.functional.embedding_bag(
            self.bone, B[:, :d].reshape(len(B), -1), self.first[:-1], mode="sum", per_sample_weights=self.weight
        )

    def pose(self, x_rest: Tensor, blends: Tensor) -> Forward:
        """Images of rest points (n, d) and their derivatives; points beyond the grid move with its border."""
        n, d = x_rest.shape
        corners, near = self._corners(x_rest, blends)
        # Along one axis after the other: value and derivatives so far, each over the axes that are left.
        parts = [corners]
        for axis in range(d):
            share = near[:, axis].reshape(n, *(1,) * (d - axis))
            ends = [(part[:, 0], part[:, 1]) for part in parts]
            slope = (ends[0][1] - ends[0][0]) / self.spacing
            parts = [low + share * (high - low) for low, high in ends] + [slope]
        blend, *slopes = (part.reshape(n, d, d + 1) for part in parts)
        moved = affine(blend, x_rest)
        turned = torch.stack([affine(slope, x_rest) for slope in slopes], dim=-1)
        return Forward(moved, blend[..., :d] + turned)

    def blend(self, x_rest: Tensor, blends: Tensor) -> Tensor:
        """Blended transforms (n, d, d+1) at rest points (n, d)."""
        n, d = x_rest.shape
        values, near = self._corners(x_rest, blends)
        for axis in range(d):
            values = torch.lerp(values[:, 0], values[:, 1], near[:, axis].reshape(n, *(1,) * (d - axis)))
        return values.reshape(n, d, d + 1)

    def _corners(self, x_rest: Tensor, blends: Tensor) -> tuple[Tensor, Tensor]:
        """Blends at the corners (n, 2, .., 2, d (d+1)) of each point's cell, and the share (n, d) of the farther."""
        n, d = x_rest.shape
        shape = torch.tensor(self.row.shape, dtype=x_rest.dtype, device=x_rest.device)
        position = torch.minimum(((x_rest - self.origin) / self.spacing).clamp_min(0), shape - 1)
        cell = torch.minimum(torch.nan_to_num(position.detach()).floor(), shape - 2)
        strides = self.row.stride()
        base = (cell.long() * torch.tensor(strides, device=cell.device)).sum(dim=-1)
        offsets = torch.tensor([np.dot(corner, strides) for corner in np.ndindex(*(2,) * d)], device=cell.device)
        corners = blends[self.row.ravel()[base[:, None] + offsets]].reshape(n, *(2,) * d, blends.shape[1])
        return corners, position - cell


def packed_weights(node: np.ndarray, W_node: np.ndarray, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Weights (s, b) at nodes (s,) of a grid as `ForwardField` holds them: "row", "node", "bone", "weight", "first"."""
    from scipy.ndimage import distance_transform_edt

    known = np.zeros(shape, dtype=bool)
    known.ravel()[node] = True
    row = np.full(shape, -1, dtype=np.int32)
    row.ravel()[node] = np.arange(len(node), dtype=np.int32)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    kept = np.abs(W_node) > SMALLEST
    weight = np.where(kept, W_node, 0)
    weight /= weight.sum(axis=1, keepdims=True)
    return {
        "row": row[tuple(nearest)],
        "node": np.asarray(node, dtype=np.int32),
        "bone": np.nonzero(kept)[1].astype(np.int32),
        "weight": weight[kept],
        "first": np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int32),
    }


def affine(A: Tensor, x: Tensor) -> Tensor:
    """Points (n, d) moved by affine maps (n, d, d+1)."""
    return (A[..., :-1] @ x[..., None])[..., 0] + A[..., -1]
