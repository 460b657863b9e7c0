"""The forward map (eq. 4) at rest points with its derivative, compiled, from weights in blocks."""

from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import distance_transform_edt

from nilbs.engine.compiled import inlined
from nilbs.geometry.plane import transforms_in_space
from nilbs.geometry.weight_blocks import EDGE, ONE, WeightBlocks

ZERO = np.float32(0)


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
            twice, begins = np.repeat(bones, 2), np.repeat(np.cumsum(bones) - bones, 2)
            weight = weight[np.arange(twice.sum()) + np.repeat(begins - np.cumsum(twice) + twice, twice)]
        cells = (EDGE, EDGE, EDGE if d == 3 else 1)
        return cls(
            origin_in_space(origin, spacing),
            np.float32(spacing),
            cells,
            there[tuple(nearest)],
            place * np.array(cells, dtype=np.int32),
            blocks.first.astype(np.int64),
            blocks.bone.astype(np.int32),
            weight,
        )


def origin_in_space(origin: np.ndarray, spacing: float) -> np.ndarray:
    """The first node (3,) of a grid; one of the plane has the plane in the middle of its cells."""
    return np.append(origin, [-spacing / 2] * (3 - len(origin))).astype(np.float32)


def transforms(B: np.ndarray) -> np.ndarray:
    """A pose (b, d+1, d+1) as compiled code reads it: the upper rows (b, 12) in space."""
    return np.ascontiguousarray(transforms_in_space(B)[:, :3].reshape(-1, 12), dtype=np.float32)


def counted(B: np.ndarray) -> np.ndarray:
    """Transforms (b, 12) divided by `ONE`, for weights that are counted in parts of it."""
    return B / np.float32(ONE)


@inlined
def forward(p0, p1, p2, weights, B):  # type: ignore[no-untyped-def]
    """The image of a rest point and its derivative, row by row, in a pose that `counted` returned."""
    m0, m1, m2 = weights.cells
    inverse = np.float32(1) / weights.spacing
    f0 = (p0 - weights.origin[0]) * inverse
    f1 = (p1 - weights.origin[1]) * inverse
    f2 = (p2 - weights.origin[2]) * inverse
    n0, n1, n2 = weights.block.shape
    block = weights.block[
        min(max(int(f0) // m0, 0), n0 - 1), min(max(int(f1) // m1, 0), n1 - 1), min(max(int(f2) // m2, 0), n2 - 1)
    ]
    f0 = min(max(f0 - np.float32(weights.place[block, 0]), ZERO), np.float32(m0))
    f1 = min(max(f1 - np.float32(weights.place[block, 1]), ZERO), np.float32(m1))
    f2 = min(max(f2 - np.float32(weights.place[block, 2]), ZERO), np.float32(m2))
    i0, i1, i2 = min(int(f0), m0 - 1), min(int(f1), m1 - 1), min(int(f2), m2 - 1)
    f0 -= np.float32(i0)
    f1 -= np.float32(i1)
    f2 -= np.float32(i2)
    begin = weights.first[block]
    bones = weights.first[block + 1] - begin
    s1 = (m2 + 1) * bones
    s0 = (m1 + 1) * s1
    at = begin * ((m0 + 1) * (m1 + 1) * (m2 + 1)) + i0 * s0 + i1 * s1 + i2 * bones
    w = weights.weight
    x0 = x1 = x2 = a00 = a01 = a02 = a10 = a11 = a12 = a20 = a21 = a22 = ZERO
    for k in range(bones):
        # The weight of a bone and its slopes by trilinear interpolation.
        v000, v001 = np.float32(w[at + k]), np.float32(w[at + bones + k])
        v010, v011 = np.float32(w[at + s1 + k]), np.float32(w[at + s1 + bones + k])
        v100, v101 = np.float32(w[at + s0 + k]), np.float32(w[at + s0 + bones + k])
        v110, v111 = np.float32(w[at + s0 + s1 + k]), np.float32(w[at + s0 + s1 + bones + k])
        d00, d01, d10, d11 = v001 - v000, v011 - v010, v101 - v100, v111 - v110
        e0, e1 = d00 + f1 * (d01 - d00), d10 + f1 * (d11 - d10)
        u00, u01, u10, u11 = v000 + f2 * d00, v010 + f2 * d01, v100 + f2 * d10, v110 + f2 * d11
        h0, h1 = u01 - u00, u11 - u10
        t0, t1 = u00 + f1 * h0, u10 + f1 * h1
        v = t0 + f0 * (t1 - t0)
        g0, g1, g2 = (t1 - t0) * inverse, (h0 + f0 * (h1 - h0)) * inverse, (e0 + f0 * (e1 - e0)) * inverse
        # The derivative of w (R x + t) is w R and the image of x times the slope.
        b = weights.bone[begin + k]
        y = B[b, 0] * p0 + B[b, 1] * p1 + B[b, 2] * p2 + B[b, 3]
        x0 += v * y
        a00 += v * B[b, 0] + g0 * y
        a01 += v * B[b, 1] + g1 * y
        a02 += v * B[b, 2] + g2 * y
        y = B[b, 4] * p0 + B[b, 5] * p1 + B[b, 6] * p2 + B[b, 7]
        x1 += v * y
        a10 += v * B[b, 4] + g0 * y
        a11 += v * B[b, 5] + g1 * y
        a12 += v * B[b, 6] + g2 * y
        y = B[b, 8] * p0 + B[b, 9] * p1 + B[b, 10] * p2 + B[b, 11]
        x2 += v * y
        a20 += v * B[b, 8] + g0 * y
        a21 += v * B[b, 9] + g1 * y
        a22 += v * B[b, 10] + g2 * y
    return x0, x1, x2, a00, a01, a02, a10, a11, a12, a20, a21, a22
