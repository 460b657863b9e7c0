"""The forward map (eq. 4) at rest points with its derivative, compiled, from weights in blocks."""

from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import distance_transform_edt

from nilbs.engine.compiled import PROBLEM, inlined
from nilbs.geometry.plane import transforms_in_space
from nilbs.geometry.weight_blocks import EDGE, ONE, WeightBlocks

if PROBLEM is None:
    from nilbs.engine.lanes import (
        bits,
        filled,
        halves,
        joined,
        lane,
        load,
        load_counts,
        lowest,
        numbers,
        spread,
        store,
        swapped,
    )  # fmt: skip

ZERO = np.float32(0)
# Weights that are loaded at once.
LOADED = 8


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
    weight: np.ndarray  # of each node of a block the weights of its bones, in parts of `ONE`; then `LOADED` zeros

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
            np.append(weight, np.zeros(LOADED, dtype=weight.dtype)),
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


def columns(B: np.ndarray) -> np.ndarray:
    """Transforms (b, 12) in lanes: columns (b, 2, 8) of four numbers, of which the last is zero."""
    found = np.zeros((len(B), 4, 4), dtype=np.float32)
    found[..., :3] = B.reshape(-1, 3, 4).transpose(0, 2, 1)
    return found.reshape(-1, 2, 8)


@inlined
def weight_cell(p0, p1, p2, weights):  # type: ignore[no-untyped-def]
    """The cell of a rest point: where its weights begin, steps between them, its bones, and the place in it."""
    m2 = weights.cells[2]
    inverse = np.float32(1) / weights.spacing
    f0 = (p0 - weights.origin[0]) * inverse
    f1 = (p1 - weights.origin[1]) * inverse
    f2 = (p2 - weights.origin[2]) * inverse
    n0, n1, n2 = weights.block.shape
    b0, b1 = min(max(int(f0) // EDGE, 0), n0 - 1), min(max(int(f1) // EDGE, 0), n1 - 1)
    b2 = min(max(int(f2) // EDGE if m2 == EDGE else int(f2), 0), n2 - 1)
    block = weights.block[b0, b1, b2]
    f0 = min(max(f0 - np.float32(weights.place[block, 0]), ZERO), np.float32(EDGE))
    f1 = min(max(f1 - np.float32(weights.place[block, 1]), ZERO), np.float32(EDGE))
    f2 = min(max(f2 - np.float32(weights.place[block, 2]), ZERO), np.float32(m2))
    i0, i1, i2 = min(int(f0), EDGE - 1), min(int(f1), EDGE - 1), min(int(f2), m2 - 1)
    begin = weights.first[block]
    bones = weights.first[block + 1] - begin
    s1 = (m2 + 1) * bones
    s0 = (EDGE + 1) * s1
    at = begin * ((EDGE + 1) * (EDGE + 1) * (m2 + 1)) + i0 * s0 + i1 * s1 + i2 * bones
    return at, s0, s1, begin, bones, f0 - np.float32(i0), f1 - np.float32(i1), f2 - np.float32(i2)


@inlined
def forward(p0, p1, p2, weights, B, slots):  # type: ignore[no-untyped-def]
    """The image of a rest point and its derivative, row by row, in a pose from `columns` of `counted` transforms.

    Slots (1, 4, 8) are overwritten.
    """
    at, s0, s1, begin, bones, f0, f1, f2 = weight_cell(p0, p1, p2, weights)
    inverse = np.float32(1) / weights.spacing
    h0, h1, h2 = spread(f0), spread(f1), spread(f2)
    w = weights.weight
    here0, here1 = halves(p0, p1), halves(p2, np.float32(1))
    # Sums over bones: of weight times transform in two parts, of slope times image along three axes.
    sum0 = sum1 = along0 = along1 = along2 = spread(ZERO)
    for k in range(0, bones, LOADED):
        # The weights of eight bones and their slopes by trilinear interpolation.
        c000, c001 = load_counts(w, at + k), load_counts(w, at + bones + k)
        c010, c011 = load_counts(w, at + s1 + k), load_counts(w, at + s1 + bones + k)
        c100, c101 = load_counts(w, at + s0 + k), load_counts(w, at + s0 + bones + k)
        c110, c111 = load_counts(w, at + s0 + s1 + k), load_counts(w, at + s0 + s1 + bones + k)
        some = joined(joined(joined(c000, c001), joined(c010, c011)), joined(joined(c100, c101), joined(c110, c111)))
        v000, v010, v100, v110 = numbers(c000), numbers(c010), numbers(c100), numbers(c110)
        d00, d01 = numbers(c001) - v000, numbers(c011) - v010
        d10, d11 = numbers(c101) - v100, numbers(c111) - v110
        e0, e1 = d00 + h1 * (d01 - d00), d10 + h1 * (d11 - d10)
        u00, u01, u10, u11 = v000 + h2 * d00, v010 + h2 * d01, v100 + h2 * d10, v110 + h2 * d11
        g0, g1 = u01 - u00, u11 - u10
        t0, t1 = u00 + h1 * g0, u10 + h1 * g1
        store(slots, 0, 0, t0 + h0 * (t1 - t0))
        store(slots, 0, 1, t1 - t0)
        store(slots, 0, 2, g0 + h0 * (g1 - g0))
        store(slots, 0, 3, e0 + h0 * (e1 - e0))
        left = bits(filled(some)) & ((1 << min(bones - k, LOADED)) - 1)
        while left:
            lane_of = lowest(left)
            left &= left - 1
            b = weights.bone[begin + k + lane_of]
            move0, move1 = load(B, b, 0), load(B, b, 1)
            y = move0 * here0 + move1 * here1
            v = spread(slots[0, 0, lane_of])
            sum0 += v * move0
            sum1 += v * move1
            along0 += spread(slots[0, 1, lane_of]) * y
            along1 += spread(slots[0, 2, lane_of]) * y
            along2 += spread(slots[0, 3, lane_of]) * y
    # The derivative of w (R x + t) is w R and the image of x times the slope.
    x = sum0 * here0 + sum1 * here1
    x += swapped(x)
    scale = spread(inverse)
    a0 = sum0 + scale * (along0 + swapped(along0))
    a1 = swapped(sum0) + scale * (along1 + swapped(along1))
    a2 = sum1 + scale * (along2 + swapped(along2))
    return (
        lane(x, 0), lane(x, 1), lane(x, 2), lane(a0, 0), lane(a1, 0), lane(a2, 0), lane(a0, 1), lane(a1, 1),
        lane(a2, 1), lane(a0, 2), lane(a1, 2), lane(a2, 2),
    )  # fmt: skip
