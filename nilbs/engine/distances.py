"""Rest distances at rest points, compiled, from bricks of values."""

from collections.abc import Sequence
from math import prod
from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import PROBLEM, inlined
from nilbs.engine.weights import origin_in_space

if PROBLEM is None:
    from nilbs.engine.lanes import ones

ZERO = np.float32(0)
# The cells of a divided cell have a bit each.
MOST_PARTS = 64
NONE = np.empty(0, dtype=np.uint64)


class Distances(NamedTuple):
    """Bricks of rest distances as compiled code reads them: in space, where a plane has one cell across."""

    origin: np.ndarray  # (3,) position of the first node
    spacing: np.float32  # edge of a cell of the coarsest grid
    brick: np.ndarray  # (n_1, n_2, n_3) number of a cell's brick, -1 for none
    divided: np.ndarray  # of each brick but the last division's the cells that have bricks, one bit for each
    below: np.ndarray  # the number of the first of those
    values: np.ndarray  # of nodes, in units
    unit: np.ndarray  # (1 + divisions,) of the coarsest grid, of bricks, of bricks in bricks and so on
    parts: np.ndarray  # (divisions, 3) cells of a brick along each axis
    first_value: np.ndarray  # (divisions,) where its values begin
    first_brick: np.ndarray  # (divisions,) where its bricks begin in `divided`, -1 for the last division

    @classmethod
    def of(
        cls,
        values: np.ndarray,
        unit: np.ndarray,
        brick: np.ndarray,
        finer: np.ndarray,
        origin: np.ndarray,
        spacing: float,
        parts: Sequence[int],
    ) -> Self:
        """The distances of a grid in d dimensions; the arrays are those of `nilbs.geometry.rest_grids.Bricks`."""
        d = brick.ndim
        made = divisions(brick, finer, parts)
        first_value = [division.first_value for division in made]
        rows = [
            (finer[n.first_cell : n.first_cell + n.bricks * n.parts**d] >= 0).reshape(n.bricks, -1)
            for n in made
            if n.first_cell is not None
        ]
        counts = [row.sum(axis=1) for row in rows]
        ends = np.cumsum([0, *map(len, rows)])
        divided = [row @ (np.uint64(1) << np.arange(row.shape[1], dtype=np.uint64)) for row in rows]
        if d == 2:  # every node twice, on both sides of the plane
            values, first_value = np.repeat(values, 2), [2 * first for first in first_value]
        return cls(
            origin_in_space(origin, spacing),
            np.float32(spacing),
            brick.reshape(*brick.shape, *[1] * (3 - d)),
            np.concatenate(divided or [NONE]),
            np.concatenate([np.cumsum(count) - count for count in counts] or [NONE]).astype(np.int32),
            values,
            unit,
            np.array([[n.parts, n.parts, n.parts if d == 3 else 1] for n in made], dtype=np.int64).reshape(-1, 3),
            np.array(first_value, dtype=np.int64),
            np.array([-1 if n.first_cell is None else ends[k] for k, n in enumerate(made)], dtype=np.int64),
        )


class Division(NamedTuple):
    """One division of cells: in how many parts, and where its bricks' nodes and, but for the last, cells begin."""

    parts: int
    bricks: int
    first_value: int
    first_cell: int | None


def divisions(
    brick: np.ndarray, finer: np.ndarray, parts: Sequence[int], *, values: int | None = None
) -> list[Division]:
    """What each division of bricks has of their values and of `finer`.

    Raises
    ------
    ValueError
        If there are more or fewer values, where their number is given, or cells than the bricks have, or bricks of
        bricks are not numbered in order.
    """
    d, found, ordered = brick.ndim, [], True
    value, cell, above = prod(n + 1 for n in brick.shape), 0, brick.ravel()
    for at, part in enumerate(parts):
        bricks, last = int(above.max(initial=-1)) + 1, at == len(parts) - 1
        if not bricks:
            break
        found.append(Division(part, bricks, value, None if last else cell))
        value += bricks * (part + 1) ** d
        above = finer[cell : cell + (0 if last else bricks * part**d)]
        numbers = above[above >= 0]
        ordered &= bool((numbers == np.arange(len(numbers))).all())
        cell += 0 if last else bricks * part**d
    if values not in (None, value) or cell != len(finer):
        raise ValueError(
            f"the grid and its bricks have {value} nodes and the bricks {cell} cells, not {values} and {len(finer)}"
        )
    if not ordered:
        raise ValueError("bricks of bricks must be numbered in order")
    return found


@inlined
def distance_cell(p0, p1, p2, distances):  # type: ignore[no-untyped-def]
    """The cell of a rest point.

    Where its values begin, steps between them, their unit, the place in the cell, cells per length along each axis, and
    how far beyond the grid the point lies, in cells of the coarsest.
    """
    t = distances
    n0, n1, n2 = t.brick.shape
    scale0 = scale1 = scale2 = np.float32(1) / t.spacing
    g0, g1, g2 = (p0 - t.origin[0]) * scale0, (p1 - t.origin[1]) * scale1, (p2 - t.origin[2]) * scale2
    f0 = min(max(g0, ZERO), np.float32(n0))
    f1 = min(max(g1, ZERO), np.float32(n1))
    f2 = min(max(g2, ZERO), np.float32(n2))
    b0, b1, b2 = g0 - f0, g1 - f1, g2 - f2
    c0, c1, c2 = min(int(f0), n0 - 1), min(int(f1), n1 - 1), min(int(f2), n2 - 1)
    f0 -= np.float32(c0)
    f1 -= np.float32(c1)
    f2 -= np.float32(c2)
    s1 = n2 + 1
    s0 = (n1 + 1) * s1
    at = c0 * s0 + c1 * s1 + c2
    unit = t.unit[0]
    number = np.int64(t.brick[c0, c1, c2])
    for division in range(t.parts.shape[0]):
        if number < 0:
            break
        m0, m1, m2 = t.parts[division, 0], t.parts[division, 1], t.parts[division, 2]
        scale0 *= np.float32(m0)
        scale1 *= np.float32(m1)
        scale2 *= np.float32(m2)
        f0 *= np.float32(m0)
        f1 *= np.float32(m1)
        f2 *= np.float32(m2)
        c0, c1, c2 = min(int(f0), m0 - 1), min(int(f1), m1 - 1), min(int(f2), m2 - 1)
        f0 -= np.float32(c0)
        f1 -= np.float32(c1)
        f2 -= np.float32(c2)
        s1 = m2 + 1
        s0 = (m1 + 1) * s1
        at = t.first_value[division] + number * ((m0 + 1) * s0) + c0 * s0 + c1 * s1 + c2
        unit = t.unit[division + 1]
        first, cell = t.first_brick[division], np.uint64((c0 * m1 + c1) * m2 + c2)
        number = np.int64(first + number)
        if first < 0 or not (t.divided[number] >> cell) & np.uint64(1):
            break
        number = t.below[number] + ones(t.divided[number] & ((np.uint64(1) << cell) - np.uint64(1)))
    return at, s0, s1, unit, f0, f1, f2, scale0, scale1, scale2, b0, b1, b2


@inlined
def trilinear(values, at, s0, s1, s2, f0, f1, f2):  # type: ignore[no-untyped-def]
    """Value and slopes in a cell, of integers at its corners."""
    v000, v001 = np.float32(values[at]), np.float32(values[at + s2])
    v010, v011 = np.float32(values[at + s1]), np.float32(values[at + s1 + s2])
    v100, v101 = np.float32(values[at + s0]), np.float32(values[at + s0 + s2])
    v110, v111 = np.float32(values[at + s0 + s1]), np.float32(values[at + s0 + s1 + s2])
    d00, d01, d10, d11 = v001 - v000, v011 - v010, v101 - v100, v111 - v110
    e0, e1 = d00 + f1 * (d01 - d00), d10 + f1 * (d11 - d10)
    u00, u01, u10, u11 = v000 + f2 * d00, v010 + f2 * d01, v100 + f2 * d10, v110 + f2 * d11
    h0, h1 = u01 - u00, u11 - u10
    t0, t1 = u00 + f1 * h0, u10 + f1 * h1
    return t0 + f0 * (t1 - t0), t1 - t0, h0 + f0 * (h1 - h0), e0 + f0 * (e1 - e0)


@inlined
def rest_distance(p0, p1, p2, distances):  # type: ignore[no-untyped-def]
    """Signed distance at a rest point, as `nilbs.fields.cache.RestCache` has it."""
    at, s0, s1, unit, f0, f1, f2, _, _, _, b0, b1, b2 = distance_cell(p0, p1, p2, distances)
    value, _, _, _ = trilinear(distances.values, at, s0, s1, 1, f0, f1, f2)
    return unit * value + distances.spacing * np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
