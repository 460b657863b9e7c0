"""Rest distances at rest points, compiled, from bricks of values."""

from collections.abc import Sequence
from math import prod
from typing import NamedTuple, Self

import numpy as np

from nilbs.engine.compiled import inlined
from nilbs.engine.weights import origin_in_space

ZERO = np.float32(0)


class Distances(NamedTuple):
    """Bricks of rest distances as compiled code reads them: in space, where a plane has one cell across."""

    origin: np.ndarray  # (3,) position of the first node
    spacing: np.float32  # edge of a cell of the coarsest grid
    brick: np.ndarray  # (n_1, n_2, n_3) number of a cell's brick, -1 for none
    finer: np.ndarray  # the same for cells of bricks
    values: np.ndarray  # of nodes, in units
    unit: np.ndarray  # (1 + divisions,) of the coarsest grid, of bricks, of bricks in bricks and so on
    parts: np.ndarray  # (divisions, 3) cells of a brick along each axis
    first_value: np.ndarray  # (divisions,) where its values begin
    first_cell: np.ndarray  # (divisions,) where its cells begin in `finer`, -1 for the last division

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
        if d == 2:  # every node twice, on both sides of the plane
            values, first_value = np.repeat(values, 2), [2 * first for first in first_value]
        return cls(
            origin_in_space(origin, spacing),
            np.float32(spacing),
            brick.reshape(*brick.shape, *[1] * (3 - d)),
            finer,
            values,
            unit,
            np.array([[n.parts, n.parts, n.parts if d == 3 else 1] for n in made], dtype=np.int64).reshape(-1, 3),
            np.array(first_value, dtype=np.int64),
            np.array([-1 if n.first_cell is None else n.first_cell for n in made], dtype=np.int64),
        )


class Division(NamedTuple):
    """One division of cells: in how many parts, and where its bricks' nodes and, but for the last, cells begin."""

    parts: int
    first_value: int
    first_cell: int | None


def divisions(
    brick: np.ndarray, finer: np.ndarray, parts: Sequence[int], *, values: int | None = None
) -> list[Division]:
    """What each division of bricks has of their values and of `finer`.

    Raises
    ------
    ValueError
        If there are more or fewer values, where their number is given, or cells than the bricks have.
    """
    d, found = brick.ndim, []
    value, cell, above = prod(n + 1 for n in brick.shape), 0, brick.ravel()
    for at, part in enumerate(parts):
        bricks, last = int(above.max(initial=-1)) + 1, at == len(parts) - 1
        if not bricks:
            break
        found.append(Division(part, value, None if last else cell))
        value += bricks * (part + 1) ** d
        above = finer[cell : cell + (0 if last else bricks * part**d)]
        cell += 0 if last else bricks * part**d
    if values not in (None, value) or cell != len(finer):
        raise ValueError(
            f"the grid and its bricks have {value} nodes and the bricks {cell} cells, not {values} and {len(finer)}"
        )
    return found


@inlined
def rest_distance(p0, p1, p2, distances):  # type: ignore[no-untyped-def]
    """Signed distance at a rest point, as `nilbs.fields.cache.RestCache` has it."""
    t = distances
    n0, n1, n2 = t.brick.shape
    inverse = np.float32(1) / t.spacing
    g0, g1, g2 = (p0 - t.origin[0]) * inverse, (p1 - t.origin[1]) * inverse, (p2 - t.origin[2]) * inverse
    f0, f1, f2 = (
        min(max(g0, ZERO), np.float32(n0)),
        min(max(g1, ZERO), np.float32(n1)),
        min(max(g2, ZERO), np.float32(n2)),
    )
    beyond = t.spacing * np.sqrt((g0 - f0) ** 2 + (g1 - f1) ** 2 + (g2 - f2) ** 2)
    c0, c1, c2 = min(int(f0), n0 - 1), min(int(f1), n1 - 1), min(int(f2), n2 - 1)
    f0 -= np.float32(c0)
    f1 -= np.float32(c1)
    f2 -= np.float32(c2)
    s1 = n2 + 1
    s0 = (n1 + 1) * s1
    at = c0 * s0 + c1 * s1 + c2
    unit = t.unit[0]
    number = t.brick[c0, c1, c2]
    for division in range(t.parts.shape[0]):
        if number < 0:
            break
        m0, m1, m2 = t.parts[division, 0], t.parts[division, 1], t.parts[division, 2]
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
        cell = t.first_cell[division]
        number = t.finer[cell + number * (m0 * m1 * m2) + (c0 * m1 + c1) * m2 + c2] if cell >= 0 else -1
    v = t.values
    v000, v001 = np.float32(v[at]), np.float32(v[at + 1])
    v010, v011 = np.float32(v[at + s1]), np.float32(v[at + s1 + 1])
    v100, v101 = np.float32(v[at + s0]), np.float32(v[at + s0 + 1])
    v110, v111 = np.float32(v[at + s0 + s1]), np.float32(v[at + s0 + s1 + 1])
    u00, u01 = v000 + f2 * (v001 - v000), v010 + f2 * (v011 - v010)
    u10, u11 = v100 + f2 * (v101 - v100), v110 + f2 * (v111 - v110)
    t0, t1 = u00 + f1 * (u01 - u00), u10 + f1 * (u11 - u10)
    return unit * (t0 + f0 * (t1 - t0)) + beyond
