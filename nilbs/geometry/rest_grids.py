"""The rest pose on grids: signed distance whose zero is the surface, and weights that continue beyond it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.sparse import csr_array, vstack

from nilbs.geometry.distance import closest_points
from nilbs.geometry.facets import facet_areas, facet_normals
from nilbs.geometry.grids import Grid, cell_corners
from nilbs.geometry.interpolation import facet_shares, volume_shares
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.topology import group_labels, ridges
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import occupancy

# Nodes that are evaluated at once.
CHUNK = 2**19
# The coarsest grid has at least this many cells along its shortest edge.
COARSEST = 4
# Samples of the surface on the area of a cell's face, and the most of all.
SAMPLES, MOST_SAMPLES = 8, 2**21
# Of the fit of bricks to the surface; damping in samples that lie about a node on average.
ROUNDS, DAMPING = 8, 0.05
# In cells: what lies this far on either side of a surface shows which side is the inside.
NEAR = 0.02
NOTHING = np.empty(0, dtype=np.int64), np.empty(0)


def distance_grid(V: np.ndarray, F: np.ndarray, grid: Grid) -> np.ndarray:
    """Signed distance at the nodes of a grid: exact within two diagonals of a cell of the surface.

    Elsewhere the sign is right, and the value is linear between nodes of the coarser grid that was exact there.

    Notes
    -----
    Every other node is found first, by the same rule; distance changes at most as fast as position, so a node that is
    far from the surface by interpolation is far from it.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> distance_grid(*square, Grid([-1, 0.5], 0.5, (4, 2)))[:, 0]
    array([ 1. ,  0.5,  0. , -0.5])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    shape = np.array(grid.shape)
    if (shape - 1).min() <= 2 * COARSEST:
        return _exact(V, F, grid, np.arange(grid.size)).reshape(grid.shape)
    coarse = Grid(grid.origin, 2 * grid.spacing, tuple(shape // 2 + 1))
    distance = _refined(distance_grid(V, F, coarse), grid.shape)
    near = np.flatnonzero(np.abs(distance) < 2 * coarse.spacing * np.sqrt(len(shape)))
    distance.ravel()[near] = _exact(V, F, grid, near)
    return distance


class Bricks(NamedTuple):
    """Values on a grid whose cells are divided, and the cells of those again.

    `values` (s,) are those of the grid's nodes, then of each brick's, division by division; the last axis runs fastest.
    `brick`, of the shape of the grid's cells, numbers the bricks of the first division, and `finer` (c,) those of the
    next divisions for the cells of every brick but the last ones; -1 is a cell that is not divided.
    """

    values: np.ndarray
    brick: np.ndarray
    finer: np.ndarray


def distance_bricks(
    V: np.ndarray,
    F: np.ndarray,
    grid: Grid,
    *,
    parts: Sequence[int],
    tolerance: float,
    most: int,
    rng: np.random.Generator,
) -> Bricks:
    """Signed distance on a grid that is divided at the surface, and again where that is not enough.

    The edge of a cell is divided in parts[0] parts, of those cells that need it in parts[1] and so on; the (parts +
    1)^d nodes of a divided cell are a brick. All cells in which samples of the surface lie are divided once. A cell of
    a brick is divided if the distance at the samples in it, which should be zero, is more than `tolerance` on average.
    If that gives more than `most` values, cells are divided that hold the largest errors. A surface within the body
    does not count.

    Notes
    -----
    Linear interpolation between exact values of a convex function is too large everywhere, so that the body would be
    too thin. Values at nodes of bricks are exact first and then fitted to the samples, by a few rounds of the
    simultaneous iterative reconstruction technique, as in `nilbs.geometry.skin_fit`. They keep their signs.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    >>> rng = np.random.default_rng(0)
    >>> bricks = distance_bricks(*square, Grid([-0.5, 0.4], 0.2, (6, 2)), parts=[2], tolerance=0.0, most=99, rng=rng)
    >>> bricks.brick.ravel()
    array([-1, -1,  0, -1, -1], dtype=int32)
    >>> bricks.values[[12, 15, 18]].round(3) + 0.0
    array([ 0.1,  0. , -0.1])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    if min(parts, default=2) < 2:
        raise ValueError(f"parts must be at least 2, got {list(parts)}")
    coarse = distance_grid(V, F, grid)
    d, cells = coarse.ndim, np.array(grid.shape) - 1
    density = SAMPLES * facet_areas(V, F).sum() / grid.spacing ** (d - 1)
    wanted = np.minimum(density * np.cumprod(parts, dtype=float) ** (d - 1), MOST_SAMPLES).astype(int) + 1
    samples, chosen = _Samples.of(V, F, int(wanted.max(initial=0)) if len(F) else 0, grid, rng)
    brick = _numbered(tuple(cells), chosen) if len(parts) else np.full(cells, -1, dtype=np.int32)
    values, finer = [coarse.ravel()], [np.empty(0, dtype=np.int32)]
    known = NOTHING
    for division, part in enumerate(parts):
        grid = Grid(grid.origin, grid.spacing / part, tuple(part * cells + 1))
        # Bricks side by side share their nodes, and those of the brick that is divided are known.
        node, row = np.unique(_brick_nodes(chosen, part, grid), return_inverse=True)
        exact = _exact(V, F, grid, node, (_scaled(known[0], part, tuple(cells + 1), grid.shape), known[1]))
        known, cells, row = (node, exact), part * cells, row.reshape(-1, *(part + 1,) * d)
        samples, cell = samples.divided(part)
        corners = cell_corners(exact[row] < 0, d)
        crossed = np.any(corners, axis=0) & ~np.all(corners, axis=0)
        kept = samples.on_border(V, F, cell, crossed.ravel(), NEAR * grid.spacing)
        samples, cell = samples.some(kept), cell[kept]
        A, cell_of = samples.interpolation(row, len(node), wanted[division])
        fitted = _fitted(A, exact, grid.spacing)
        if division == len(parts) - 1:
            values.append(fitted[row.ravel()])
            break
        missed, count = (np.bincount(cell_of, errors, minlength=crossed.size) for errors in (np.abs(A @ fitted), None))
        room = (most - sum(map(len, values)) - row.size) // (parts[division + 1] + 1) ** d
        again = missed > tolerance * count
        if again.sum() > room:
            again[np.argsort(missed)[: again.size - max(room, 0)]] = False
        # Cells that are divided are not read.
        values.append(_fitted(A[~again[cell_of]], exact, grid.spacing)[row.ravel()])
        number = np.where(again, np.cumsum(again) - 1, -1).astype(np.int32)
        finer.append(number)
        divided = np.argwhere(again.reshape(crossed.shape))
        chosen = part * chosen[divided[:, 0]] + divided[:, 1:]
        samples = samples._replace(brick=number[cell]).some(again[cell])
    return Bricks(np.concatenate(values), brick, np.concatenate(finer))


class _Samples(NamedTuple):
    """Random points (p, d) of a surface in bricks, in random order; those of lower `number` are fewer, but as even."""

    number: np.ndarray
    x: np.ndarray
    facet: np.ndarray
    brick: np.ndarray
    cell: np.ndarray  # (p, d) of the brick
    share: np.ndarray  # (p, d) of the way through that cell

    @classmethod
    def of(cls, V: np.ndarray, F: np.ndarray, n: int, grid: Grid, rng: np.random.Generator) -> tuple[Self, np.ndarray]:
        """Samples in the cells of a grid, and those cells (k, d); a `brick` is one of these."""
        x, facet = facet_samples(V, F, n, rng=rng) if n else (np.empty((0, V.shape[1])), np.empty(0, dtype=np.int64))
        cells = np.array(grid.shape) - 1
        place = (x - grid.origin) / grid.spacing
        number = np.flatnonzero(((place >= 0) & (place <= cells)).all(axis=1))
        cell = np.minimum(place[number].astype(np.int64), cells - 1)
        chosen, brick = np.unique(np.ravel_multi_index(tuple(cell.T), cells), return_inverse=True)
        samples = cls(number, x[number], facet[number], brick, cell, place[number] - cell)
        return samples, np.stack(np.unravel_index(chosen, cells), axis=-1)

    def divided(self, part: int) -> tuple[Self, np.ndarray]:
        """The same in bricks of `part` cells instead of in one cell each; and these (p,), counted brick by brick."""
        d = self.x.shape[1]
        place = part * self.share
        cell = np.minimum(place.astype(np.int64), part - 1)
        flat = np.ravel_multi_index(tuple(cell.T), (part,) * d) + self.brick * part**d
        return self._replace(cell=cell, share=place - cell), flat

    def some(self, kept: np.ndarray) -> Self:
        """Chosen ones."""
        return type(self)(*(array[kept] for array in self))

    def on_border(self, V: np.ndarray, F: np.ndarray, cell: np.ndarray, crossed: np.ndarray, near: float) -> np.ndarray:
        """Whether samples (p,) lie in cells that hold a border of the body.

        A cell with corners on both sides does. Another one holds something thin, or a surface within the body, which
        has the inside on both sides: two samples of it decide.
        """
        doubtful = np.flatnonzero(~crossed[cell])
        there, first = np.unique(cell[doubtful], return_index=True)
        last = np.unique(cell[doubtful[::-1]], return_index=True)[1]
        tested = doubtful[np.concatenate([first, len(doubtful) - 1 - last])]
        step = near * facet_normals(V, F)[self.facet[tested]]
        sides = [
            np.concatenate(
                [occupancy(V, F, x) for x in np.array_split(self.x[tested] + side, len(tested) // CHUNK + 1)]
            )
            for side in (step, -step)
        ]
        holds = crossed.copy()
        holds[np.concatenate([there, there])[sides[0] != sides[1]]] = True
        return holds[cell]

    def interpolation(self, row: np.ndarray, n: int, count: int) -> tuple[csr_array, np.ndarray]:
        """How much each of n nodes counts at the first of all samples, (p, n); and their cells (p,).

        The nodes of bricks are given as `row` (k, part + 1, .., part + 1).
        """
        used = self.number < count
        brick, cell, share = self.brick[used], self.cell[used], self.share[used].astype(np.float32)
        p, d = cell.shape
        size = row.shape[1]
        first = np.ravel_multi_index(tuple(cell.T), (size,) * d) + brick * size**d
        corners = np.ravel_multi_index(np.indices((2,) * d).reshape(d, -1), (size,) * d)
        index = row.ravel().astype(np.int32)[first[:, None] + corners]
        weight = np.ones((p, 1), dtype=np.float32)
        for axis in range(d):
            ends = np.stack([1 - share[:, axis], share[:, axis]], axis=1)
            weight = (weight[:, :, None] * ends[:, None]).reshape(p, 2 ** (axis + 1))
        A = csr_array((weight.ravel(), index.ravel(), np.arange(p + 1) * 2**d), shape=(p, n))
        return A, np.ravel_multi_index(tuple(cell.T), (size - 1,) * d) + brick * (size - 1) ** d


def weight_grid(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray | csr_array,
    V_volume: np.ndarray,
    T: np.ndarray,
    W_volume: np.ndarray | csr_array,
    grid: Grid,
    *,
    band: float,
    depth: float,
) -> tuple[np.ndarray, csr_array]:
    """Nodes (s,) of a grid in the body and in a band around it, and their weights (s, b), whose rows sum to one.

    The surface V, F has weights W, the volume mesh V_volume, T has W_volume. `band` is the width of the band; beyond
    `depth` from the surface weights do not change any more. Outside the body weights may leave [0, 1].

    Notes
    -----
    A point outside, at p + s n for its closest place p, has 2 W(p) - W(p - s n): so weights have no kink at the
    skin, which interpolation on the grid would smear over both sides. Farther than `depth` nothing changes any more.
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    W, W_volume = csr_array(W), csr_array(W_volume)
    distance = distance_grid(V, F, grid).ravel()
    node = np.flatnonzero(distance < band)
    if not len(node):
        node = np.array([int(distance.argmin())])
    found = []
    for start in range(0, len(node), CHUNK):
        part = node[start : start + CHUNK]
        x, inside = grid.nodes(part), distance[part] < 0
        away, facet, closest = closest_points(V, F, x[~inside])
        # The point mirrored in the surface, no deeper than `depth`.
        mirrored = closest - (x[~inside] - closest) * (np.minimum(away, depth) / np.maximum(away, 1e-300))[:, None]
        place = x.copy()
        place[~inside] = mirrored
        W_part = volume_shares(V_volume, T, place) @ W_volume
        # One and the same product for all: rows of points inside count once, those of mirrored ones -1 times.
        sign = csr_array((np.where(inside, 1.0, -1.0), (np.arange(len(part)), np.arange(len(part)))))
        twice = csr_array(
            (np.full(len(closest), 2.0), (np.flatnonzero(~inside), np.arange(len(closest)))),
            shape=(len(part), len(closest)),
        )
        found.append(sign @ W_part + twice @ (facet_shares(V, F, closest, facet) @ W))
    return node, scaled_rows(csr_array(vstack(found)))


def scaled_rows(W: csr_array, *, smallest: float = 0.0) -> csr_array:
    """The same without entries below `smallest`, and with rows that sum to one.

    Examples
    --------
    >>> scaled_rows(csr_array([[0.8, 0.1, 1e-9]]), smallest=1e-6).toarray().round(3)
    array([[0.889, 0.111, 0.   ]])
    """
    kept = np.abs(W.data) >= smallest
    first = np.concatenate([[0], np.cumsum(kept)])[W.indptr]
    W = csr_array((W.data[kept], W.indices[kept], first), shape=W.shape)
    return csr_array((W.data / np.repeat(W.sum(axis=1), np.diff(W.indptr)), W.indices, W.indptr), shape=W.shape)


def _brick_nodes(chosen: np.ndarray, part: int, grid: Grid) -> np.ndarray:
    """Nodes of the bricks (k, nodes) of cells (k, d), which are `part` cells of the grid wide."""
    d = chosen.shape[1]
    first = np.ravel_multi_index(tuple(part * chosen.T), grid.shape)
    local = np.ravel_multi_index(np.indices((part + 1,) * d).reshape(d, -1), grid.shape)
    return first[:, None] + local


def _scaled(node: np.ndarray, part: int, coarse: tuple[int, ...], fine: tuple[int, ...]) -> np.ndarray:
    """Nodes (s,) of a grid as those of one that has `part` cells for each of its own."""
    return np.ravel_multi_index([part * index for index in np.unravel_index(node, coarse)], fine)


def _fitted(A: csr_array, exact: np.ndarray, spacing: float) -> np.ndarray:
    """Values near those at nodes whose interpolation A at samples of the surface is zero, nearly."""
    if not A.nnz:
        return exact
    back = A.T
    share = np.asarray(back.sum(axis=1))
    share = 1 / (share + DAMPING * share[share > 0].mean())
    found = exact.astype(np.float32)
    for _ in range(ROUNDS):
        found -= share * (back @ (A @ found))
    found = np.clip(found, exact - spacing / 2, exact + spacing / 2)
    return np.where(exact < 0, np.minimum(found, 0), np.maximum(found, 0))


def _numbered(shape: tuple[int, ...], chosen: np.ndarray) -> np.ndarray:
    """Numbers of chosen places (k, d) of an array, in their order, and -1 elsewhere."""
    number = np.full(shape, -1, dtype=np.int32)
    number[tuple(chosen.T)] = np.arange(len(chosen))
    return number


def _exact(
    V: np.ndarray, F: np.ndarray, grid: Grid, node: np.ndarray, known: tuple[np.ndarray, np.ndarray] = NOTHING
) -> np.ndarray:
    """Signed distance at nodes of a grid, given as ascending indices among all; some nodes and values are known."""
    signed = np.full(len(node), np.nan)
    at = np.searchsorted(node, known[0])
    there = node[np.minimum(at, len(node) - 1)] == known[0] if len(node) else np.zeros(len(at), dtype=bool)
    signed[at[there]] = known[1][there]
    new = np.flatnonzero(np.isnan(signed))
    length = np.abs(signed)
    length[new] = _at_nodes(lambda x: closest_points(V, F, x)[0], grid, node[new])
    side = _sides(F, grid, node, length)
    # All nodes of a side lie where one that is known lies, or the one farthest from the surface.
    order = np.lexsort((length, ~np.isnan(signed), side))
    last = order[np.diff(side[order], append=-1) != 0]
    inside = signed[last] < 0
    open_ = np.flatnonzero(np.isnan(signed[last]))
    inside[open_] = _at_nodes(lambda x: occupancy(V, F, x), grid, node[last[open_]]) > 0
    return np.where(inside[side], -length, length)


def _sides(F: np.ndarray, grid: Grid, node: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Number nodes so that those of one number lie on the same side of a surface.

    Two neighbours that are together farther from a closed surface than from each other have no surface between them.
    Through an open one inside and outside hang together, and every node has a number of its own.
    """
    meeting = ridges(F)
    if np.bincount(meeting.ridge.ravel(), meeting.sign.ravel()).any():
        return np.arange(len(node))
    pairs = []
    for axis, size in enumerate(grid.shape):
        stride = int(np.prod(grid.shape[axis + 1 :]))
        first = np.flatnonzero(node // stride % size < size - 1)
        second = np.searchsorted(node, node[first] + stride)
        there = np.flatnonzero(node[np.minimum(second, len(node) - 1)] == node[first] + stride)
        first, second = first[there], second[there]
        # With room for rounding: one wrong pair would turn the whole body.
        apart = length[first] + length[second] > 1.01 * grid.spacing
        pairs.append(np.stack([first[apart], second[apart]]))
    first, second = np.concatenate(pairs, axis=1)
    return group_labels(first, second, len(node))


def _at_nodes(function: Callable[[np.ndarray], np.ndarray], grid: Grid, node: np.ndarray) -> np.ndarray:
    """Values of a function at nodes of a grid, some at once."""
    values = np.empty(len(node))
    for start in range(0, len(node), CHUNK):
        part = slice(start, start + CHUNK)
        values[part] = function(grid.nodes(node[part]))
    return values


def _refined(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values at every other node, linear in between."""
    for axis, size in enumerate(shape):
        index = np.arange(size)
        first = values.take(index // 2, axis=axis)
        second = values.take((index + 1) // 2, axis=axis)
        values = (first + second) / 2
    return values
