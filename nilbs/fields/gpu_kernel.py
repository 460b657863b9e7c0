"""The root search of `nilbs.engine.search` as one kernel on a GPU: from posed points to rest distances.

Each lane of a warp has a point, and a program is one warp: its loops end when its 32 points are done, without barriers,
while other warps hide the time that memory takes. All starts of a point go through one loop, of which each turn is one
look-up of the forward map: lanes wait for the one with the most look-ups, not for the slowest from each start.

What a lane reads lies in records of 16 bytes, each read by one instruction: points in any order read some 2 kB each in
places of their own, and the number of such reads is what limits the caches. The tables take some 30 MiB together, less
than the second cache of a large GPU, so that points are not sorted: that would take as long as it saves.

Tiles (n, 4) hold homogeneous points (x, y, z, 1) or rows of transforms, a record in each lane.
"""

from __future__ import annotations  # without Triton nothing evaluates them

from collections.abc import Callable
from typing import Any, NamedTuple

from nilbs.engine import search
from nilbs.geometry.weight_blocks import EDGE as BLOCK_EDGE

try:
    import triton
    import triton.language as tl
except ImportError as error:
    PROBLEM: str | None = " ".join(str(error).split())
else:
    PROBLEM = None


def compiled(function: Callable[..., Any]) -> Any:
    """The function compiled by Triton, for any number n alike; without Triton the function as it is."""
    return triton.jit(function, do_not_specialize=["n"]) if PROBLEM is None else function


def constant(value: float) -> Any:
    """A number as compiled code takes it."""
    return tl.constexpr(value) if PROBLEM is None else value


ROOT, STEP, SHORTER = constant(search.ROOT), constant(search.STEP), constant(search.SHORTER)
ITERATIONS, SHORT, CLOSE = constant(search.ITERATIONS), constant(search.SHORT), constant(search.CLOSE)
SMALLEST, SAME, ASIDE = constant(search.SMALLEST), constant(search.SAME), constant(search.ASIDE)
EDGE = constant(BLOCK_EDGE)
# Starts that a lane keeps at a time, the deepest first; others are found again when these are done.
KEPT = 4
ROUNDS = constant(search.MOST // KEPT)
NONE = constant(2**63 - 1)
# The depth of a start in a cell whose image is flat, and reaches of cells from here on are infinite.
FLAT_DEPTH, INFINITE = constant(0.5), constant(1e30)


class Voxels(NamedTuple):
    """Cells of the lattice by voxels: which boxes of cells reach into each."""

    frame: Any  # (7,) low corner, voxels per length, voxels along each axis
    first: Any  # (voxels + 1,) int32: where the cells of each begin
    cell: Any  # int32
    record: Any  # (c, 8, 4) of each cell; see `nilbs.fields.gpu_search`


class Blends(NamedTuple):
    """Blended transforms of a pose at the nodes of blocks."""

    frame: Any  # (7,) first node, cells per length, blocks along each axis
    block: Any  # (n_1, n_2, n_3, 4) int32 of each place: the number of its block, and the first cell of that
    row: Any  # (nodes, d, 4)


class Bricks(NamedTuple):
    """Rest distances, as `nilbs.engine.distances.Distances`."""

    frame: Any  # (7,) first node, cells per length, cells along each axis, all of the coarsest grid
    division: Any  # (1 + 5 divisions,) int32: how many; of each the parts, where values begin, where bricks begin
    brick: Any
    divided: Any
    below: Any
    value: Any  # not `values`, which tuples of Triton have
    unit: Any


@compiled
def search_kernel(x, n, distance, x_rest, voxels, blends, bricks, D: tl.constexpr, LANES: tl.constexpr):  # type: ignore[no-untyped-def]
    """Write the smallest distances at roots of points (n, d) and where they are, as `nilbs.engine.search` does."""
    i = tl.program_id(0).to(tl.int64) * LANES + tl.arange(0, LANES)
    there = i < n
    k = tl.arange(0, 4)[None, :]
    p = tl.load(x + D * i[:, None] + k, mask=there[:, None] & (k < D), other=0.0)
    p = tl.where(k == 3, 1.0, p)
    begin, end = _voxel(p, there, k, voxels)
    best = tl.full([LANES], float("inf"), tl.float32)
    found = tl.full([LANES, 4], float("nan"), tl.float32)
    # The last roots, so that a start close to one is left out.
    root0 = tl.full([LANES, 4], 1e15, tl.float32)
    root1, root2, root3 = root0, root0, root0
    left = begin < end
    last = tl.full([LANES], -1, tl.int64)
    rounds = 0
    while _any(left) & (rounds < ROUNDS):
        rounds += 1
        key0, key1, key2, key3 = _starts(p, begin, end, left, last, k, voxels)
        last = key3
        fresh = left & (key0 != NONE)
        active = fresh
        # The best point of a search, its residual, whether space is turned inside out there, and the next step.
        r, s = p, tl.zeros_like(p)
        least, turned = tl.zeros_like(best), left & False
        turns = tl.zeros([LANES], tl.int32)
        while _any(active):
            if _any(fresh):
                start, same = _start(p, key0, fresh, k, voxels)
                known = _near(start, root0, same) | _near(start, root1, same)
                known = fresh & (known | _near(start, root2, same) | _near(start, root3, same))
                begun = fresh & ~known
                r, s = tl.where(begun[:, None], start, r), tl.where(begun[:, None], 0.0, s)
                least, turns = tl.where(begun, float("inf"), least), tl.where(begun, 0, turns)
                key0, key1, key2, key3 = _next(known, key0, key1, key2, key3, NONE)
                fresh = known & (key0 != NONE)
                active = active & (~known | fresh)
            on = active & ~fresh
            q = r + s
            residual, det, step = _look_up(p, q, on, k, blends, D)
            better = on & (residual < least)
            least, turned = tl.where(better, residual, least), tl.where(better, det < 0, turned)
            r = tl.where(better[:, None], q, r)
            length = tl.sqrt(_square(step))
            finite = length < float("inf")
            step = step / tl.maximum(length / STEP, 1.0)[:, None]
            s = tl.where(better[:, None], step, s * SHORTER)
            # The next step would be below the precision: it is taken, and its image is not computed.
            close = better & finite & (residual < CLOSE) & (length < SHORT)
            r = tl.where(close[:, None], r + step, r)
            turns += on.to(tl.int32)
            done = on & (close | (better & ~finite) | (turns > ITERATIONS))
            if _any(done):
                root = done & (least < ROOT)
                if _any(root):
                    value = _rest_distance(r, root, k, bricks)
                    nearer = root & (value < best)
                    best, found = tl.where(nearer, value, best), tl.where(nearer[:, None], r, found)
                    kept = (root & ~turned)[:, None]  # near a root at which space is turned inside out lie others
                    root3, root2, root1, root0 = _next(kept, root3, root2, root1, root0, r)
                key0, key1, key2, key3 = _next(done, key0, key1, key2, key3, NONE)
                fresh = fresh | (done & (best >= 0) & (key0 != NONE))
                active = active & (~done | fresh)
        left = left & (best >= 0) & (last != NONE)
    tl.store(distance + i, best, mask=there)
    tl.store(x_rest + D * i[:, None] + k, found, mask=there[:, None] & (k < D))


@compiled
def _any(mask):  # type: ignore[no-untyped-def]
    return tl.max(mask.to(tl.int32), axis=0) > 0


@compiled
def _next(where, a, b, c, d, last):  # type: ignore[no-untyped-def]
    """A queue of four without its first, and with a last."""
    return tl.where(where, b, a), tl.where(where, c, b), tl.where(where, d, c), tl.where(where, last, d)


@compiled
def _near(a, b, length):  # type: ignore[no-untyped-def]
    return _square(a - b) < length * length


@compiled
def _records(table, at, on, k):  # type: ignore[no-untyped-def]
    """Records (n, 4) of a table."""
    return tl.load(table + (4 * at)[:, None] + k, mask=on[:, None], other=0)


@compiled
def _column(tile, number: tl.constexpr, k):  # type: ignore[no-untyped-def]
    return tl.sum(tl.where(k == number, tile, 0), axis=1)


@compiled
def _tile(a, b, c, last, k):  # type: ignore[no-untyped-def]
    """The tile of three columns and a number."""
    return tl.where(k == 0, a[:, None], tl.where(k == 1, b[:, None], tl.where(k == 2, c[:, None], last)))


@compiled
def _square(tile):  # type: ignore[no-untyped-def]
    return tl.sum(tile * tile, axis=1)


@compiled
def _clamped(value, high):  # type: ignore[no-untyped-def]
    return tl.minimum(tl.maximum(value, 0.0), high)


@compiled
def _in_frame(frame, tile, k):  # type: ignore[no-untyped-def]
    """Columns of points in cells of a grid, and the numbers of its cells."""
    scale = tl.load(frame + 3)
    return (
        (_column(tile, 0, k) - tl.load(frame)) * scale,
        (_column(tile, 1, k) - tl.load(frame + 1)) * scale,
        (_column(tile, 2, k) - tl.load(frame + 2)) * scale,
        tl.load(frame + 4).to(tl.int32),
        tl.load(frame + 5).to(tl.int32),
        tl.load(frame + 6).to(tl.int32),
    )


@compiled
def _voxel(p, there, k, voxels):  # type: ignore[no-untyped-def]
    """Where the cells of a point's voxel begin and end; points outside all have none."""
    v0, v1, v2, n0, n1, n2 = _in_frame(voxels.frame, p, k)
    inside = there & (v0 >= 0) & (v1 >= 0) & (v2 >= 0) & (v0 < n0) & (v1 < n1) & (v2 < n2)
    v0, v1, v2 = tl.where(inside, v0, 0.0), tl.where(inside, v1, 0.0), tl.where(inside, v2, 0.0)
    first = voxels.first + (v0.to(tl.int32) * n1 + v1.to(tl.int32)) * n2 + v2.to(tl.int32)
    return tl.load(first, mask=inside, other=0), tl.load(first + 1, mask=inside, other=0)


@compiled
def _starts(p, begin, end, left, last, k, voxels):  # type: ignore[no-untyped-def]
    """Keys of the deepest cells whose images hold a point, after those up to a last one: depth, then number."""
    key0 = tl.full(begin.shape, NONE, tl.int64)
    key1, key2, key3 = key0, key0, key0
    at = begin
    on = left & (at < end)
    while _any(on):
        cell = tl.load(voxels.cell + at, mask=on, other=0)
        low, high = _records(voxels.record, 8 * cell, on, k), _records(voxels.record, 8 * cell + 1, on, k)
        hit = on & (tl.max(((p < low) | (p > high)).to(tl.int32), axis=1) == 0)
        if _any(hit):
            u, reach = _in_cell(p, cell, hit, k, voxels)
            u = tl.where(k < 3, tl.abs(u), 0.0)
            hit = hit & (tl.max((u > reach).to(tl.int32), axis=1) == 0)
            depth = tl.where(tl.max(reach, axis=1) < INFINITE, tl.max(u, axis=1), FLAT_DEPTH)
            key = (depth.to(tl.int32, bitcast=True).to(tl.int64) << 32) | cell
            key = tl.where(hit & (key > last), key, NONE)
            key0, key = tl.minimum(key0, key), tl.maximum(key0, key)
            key1, key = tl.minimum(key1, key), tl.maximum(key1, key)
            key2, key = tl.minimum(key2, key), tl.maximum(key2, key)
            key3 = tl.minimum(key3, key)
        at += 1
        on = left & (at < end)
    return key0, key1, key2, key3


@compiled
def _in_cell(p, cell, on, k, voxels):  # type: ignore[no-untyped-def]
    """Tiles: a point in the edges of a cell, from its centre, and how far the cell reaches in them."""
    away = p - _records(voxels.record, 8 * cell + 2, on, k)  # the last is 1 - 1
    row0 = _records(voxels.record, 8 * cell + 3, on, k)
    row1 = _records(voxels.record, 8 * cell + 4, on, k)
    row2 = _records(voxels.record, 8 * cell + 5, on, k)
    u = _tile(tl.sum(row0 * away, 1), tl.sum(row1 * away, 1), tl.sum(row2 * away, 1), 0.0, k)
    return u, _tile(_column(row0, 3, k), _column(row1, 3, k), _column(row2, 3, k), 0.0, k)


@compiled
def _start(p, key, on, k, voxels):  # type: ignore[no-untyped-def]
    """Where a search from a cell begins, and how near to a root that is no new one."""
    cell = (key & 0x7FFFFFFF).to(tl.int32)
    u, _ = _in_cell(p, cell, on, k, voxels)
    edge = _records(voxels.record, 8 * cell + 7, on, k)
    start = _records(voxels.record, 8 * cell + 6, on, k) + edge * tl.minimum(tl.maximum(u, -ASIDE), ASIDE)
    return start, _column(edge, 0, k) * SAME


@compiled
def _look_up(p, q, on, k, blends, D: tl.constexpr):  # type: ignore[no-untyped-def]
    """Residual and determinant at rest points q, and the Newton step from there."""
    f0, f1, f2, n0, n1, n2 = _in_frame(blends.frame, q, k)
    b0 = tl.minimum(tl.maximum(f0, 0.0).to(tl.int32) // EDGE, n0 - 1)
    b1 = tl.minimum(tl.maximum(f1, 0.0).to(tl.int32) // EDGE, n1 - 1)
    b2 = tl.minimum(tl.maximum(f2, 0.0).to(tl.int32) // EDGE, n2 - 1)
    block = _records(blends.block, (b0 * n1 + b1) * n2 + b2, on, k)
    f0 = _clamped(f0 - _column(block, 1, k), EDGE)
    f1 = _clamped(f1 - _column(block, 2, k), EDGE)
    f2 = _clamped(f2 - _column(block, 3, k), EDGE)
    i0, i1 = tl.minimum(f0.to(tl.int32), EDGE - 1), tl.minimum(f1.to(tl.int32), EDGE - 1)
    i2 = tl.minimum(f2.to(tl.int32), EDGE - 1)
    # In the plane all nodes are there twice, on both sides.
    across: tl.constexpr = EDGE + 1 if D == 3 else 2
    if D == 2:
        i2 = i2 * 0
    node = ((_column(block, 0, k) * (EDGE + 1) + i0) * (EDGE + 1) + i1) * across + i2
    h0, h1, h2 = (f0 - i0)[:, None], (f1 - i1)[:, None], (f2 - i2)[:, None]
    x0, a00, a01, a02 = _row(blends, node, 0, q, h0, h1, h2, on, k, D, across)
    x1, a10, a11, a12 = _row(blends, node, 1, q, h0, h1, h2, on, k, D, across)
    if D == 3:
        x2, a20, a21, a22 = _row(blends, node, 2, q, h0, h1, h2, on, k, D, across)
    else:
        x2, a20, a21, a22 = x0 * 0, x0 * 0, x0 * 0, x0 * 0 + 1
    m0, m1, m2 = _column(p, 0, k) - x0, _column(p, 1, k) - x1, _column(p, 2, k) - x2
    c0, c1, c2 = a11 * a22 - a12 * a21, a02 * a21 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c0 + a10 * c1 + a20 * c2
    held = tl.where(tl.abs(det) < SMALLEST, tl.where(det < 0, -SMALLEST, SMALLEST), det)
    s0 = c0 * m0 + c1 * m1 + c2 * m2
    s1 = (a12 * a20 - a10 * a22) * m0 + (a00 * a22 - a02 * a20) * m1 + (a02 * a10 - a00 * a12) * m2
    s2 = (a10 * a21 - a11 * a20) * m0 + (a01 * a20 - a00 * a21) * m1 + (a00 * a11 - a01 * a10) * m2
    return tl.sqrt(m0 * m0 + m1 * m1 + m2 * m2), det, _tile(s0, s1, s2, 0.0, k) * (1.0 / held)[:, None]


@compiled
def _row(blends, node, number: tl.constexpr, q, h0, h1, h2, on, k, D: tl.constexpr, across: tl.constexpr):  # type: ignore[no-untyped-def]
    """A coordinate of the image of q and its derivatives: of w (R q + t) they are w R and the image times the slope."""
    at = node * D + number
    along1: tl.constexpr = across * D
    along0: tl.constexpr = (EDGE + 1) * across * D
    c000, c010 = _records(blends.row, at, on, k), _records(blends.row, at + along1, on, k)
    c100, c110 = _records(blends.row, at + along0, on, k), _records(blends.row, at + along0 + along1, on, k)
    c001, c011, c101, c111 = c000, c010, c100, c110
    if D == 3:
        c001, c011 = _records(blends.row, at + D, on, k), _records(blends.row, at + along1 + D, on, k)
        c101 = _records(blends.row, at + along0 + D, on, k)
        c111 = _records(blends.row, at + along0 + along1 + D, on, k)
    value, g0, g1, g2 = _trilinear(c000, c001, c010, c011, c100, c101, c110, c111, h0, h1, h2)
    scale = tl.load(blends.frame + 3)
    return (
        tl.sum(value * q, axis=1),
        _column(value, 0, k) + scale * tl.sum(g0 * q, axis=1),
        _column(value, 1, k) + scale * tl.sum(g1 * q, axis=1),
        _column(value, 2, k) + scale * tl.sum(g2 * q, axis=1),
    )


@compiled
def _trilinear(v000, v001, v010, v011, v100, v101, v110, v111, f0, f1, f2):  # type: ignore[no-untyped-def]
    """Value and slopes in a cell; see `nilbs.engine.distances.trilinear`."""
    d00, d01, d10, d11 = v001 - v000, v011 - v010, v101 - v100, v111 - v110
    e0, e1 = d00 + f1 * (d01 - d00), d10 + f1 * (d11 - d10)
    u00, u01, u10, u11 = v000 + f2 * d00, v010 + f2 * d01, v100 + f2 * d10, v110 + f2 * d11
    g0, g1 = u01 - u00, u11 - u10
    t0, t1 = u00 + f1 * g0, u10 + f1 * g1
    return t0 + f0 * (t1 - t0), t1 - t0, g0 + f0 * (g1 - g0), e0 + f0 * (e1 - e0)


@compiled
def _rest_distance(r, on, k, bricks):  # type: ignore[no-untyped-def]
    """Signed distance at rest points; see `nilbs.engine.distances`."""
    g0, g1, g2, n0, n1, n2 = _in_frame(bricks.frame, r, k)
    f0, f1, f2 = _clamped(g0, n0), _clamped(g1, n1), _clamped(g2, n2)
    b0, b1, b2 = g0 - f0, g1 - f1, g2 - f2
    beyond = tl.sqrt(b0 * b0 + b1 * b1 + b2 * b2) / tl.load(bricks.frame + 3)
    i0, i1 = tl.minimum(f0.to(tl.int32), n0 - 1), tl.minimum(f1.to(tl.int32), n1 - 1)
    i2 = tl.minimum(f2.to(tl.int32), n2 - 1)
    f0, f1, f2 = f0 - i0, f1 - i1, f2 - i2
    along1 = tl.zeros_like(i0) + n2 + 1
    along0 = (n1 + 1) * along1
    at = i0 * along0 + i1 * along1 + i2
    unit = tl.zeros_like(f0) + tl.load(bricks.unit)
    number = tl.load(bricks.brick + (i0 * n1 + i1) * n2 + i2, mask=on, other=-1)
    for division in range(tl.load(bricks.division)):
        table = bricks.division + 1 + 5 * division
        m0, m1, m2 = tl.load(table), tl.load(table + 1), tl.load(table + 2)
        values, first = tl.load(table + 3), tl.load(table + 4)
        within = number >= 0
        i0, i1 = tl.minimum((f0 * m0).to(tl.int32), m0 - 1), tl.minimum((f1 * m1).to(tl.int32), m1 - 1)
        i2 = tl.minimum((f2 * m2).to(tl.int32), m2 - 1)
        f0, f1 = tl.where(within, f0 * m0 - i0, f0), tl.where(within, f1 * m1 - i1, f1)
        f2 = tl.where(within, f2 * m2 - i2, f2)
        along1 = tl.where(within, m2 + 1, along1)
        along0 = tl.where(within, (m1 + 1) * (m2 + 1), along0)
        inner = (i0 * (m1 + 1) + i1) * (m2 + 1) + i2
        at = tl.where(within, values + number * ((m0 + 1) * (m1 + 1) * (m2 + 1)) + inner, at)
        unit = tl.where(within, tl.load(bricks.unit + division + 1), unit)
        # The cells of a brick that have bricks are bits; before a cell's are as many as bits below its own.
        within = within & (first >= 0)
        bits = tl.load(bricks.divided + first + number, mask=within, other=0).to(tl.uint64, bitcast=True)
        bit = ((i0 * m1 + i1) * m2 + i2).to(tl.uint64)
        below = tl.load(bricks.below + first + number, mask=within, other=0)
        one = tl.full(bits.shape, 1, tl.uint64)
        number = tl.where(((bits >> bit) & one) != 0, below + _ones(bits & ((one << bit) - one)), -1)
    v = bricks.value
    v000, v001 = _value(v, at, on), _value(v, at + 1, on)
    v010, v011 = _value(v, at + along1, on), _value(v, at + along1 + 1, on)
    v100, v101 = _value(v, at + along0, on), _value(v, at + along0 + 1, on)
    v110, v111 = _value(v, at + along0 + along1, on), _value(v, at + along0 + along1 + 1, on)
    value, _, _, _ = _trilinear(v000, v001, v010, v011, v100, v101, v110, v111, f0, f1, f2)
    return unit * value + beyond


@compiled
def _value(values, at, on):  # type: ignore[no-untyped-def]
    return tl.load(values + at, mask=on, other=0).to(tl.float32)


@compiled
def _ones(bits):  # type: ignore[no-untyped-def]
    """How many bits are set in integers of 64 bits."""
    bits = bits - ((bits >> 1) & 0x5555555555555555)
    bits = (bits & 0x3333333333333333) + ((bits >> 2) & 0x3333333333333333)
    bits = (bits + (bits >> 4)) & 0x0F0F0F0F0F0F0F0F
    return ((bits * 0x0101010101010101) >> 56).to(tl.int32)
