import tracemalloc

import numpy as np
import pytest
from scipy.sparse import csr_array

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_values
from nilbs.geometry.rest_grids import weight_grid
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.skin_fit import DAMPING, ROUNDS, SAMPLES, fit_to_skin
from nilbs.geometry.weight_blocks import WeightBlocks

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def read(grid: Grid, W_grid: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Multilinear interpolation (p, b) of values (.., b) at all nodes, one corner after the other."""
    position = (x - grid.origin) / grid.spacing
    cell = np.minimum(position.astype(int), np.array(grid.shape) - 2)
    found = np.zeros((len(x), W_grid.shape[-1]))
    for corner in np.ndindex(*(2,) * x.shape[1]):
        share = np.where(corner, position - cell, 1 - position + cell).prod(axis=1)
        found += share[:, None] * W_grid[tuple((cell + corner).T)]
    return found


def fit(c, cells: int) -> tuple[Grid, np.ndarray, np.ndarray, np.ndarray]:
    """A grid, its nodes with weights, these weights, and the fitted weights."""
    grid = Grid.box(c.V, cells, pad=0.1)
    node, W_node = weight_grid(c.V, c.F, c.W, c.V_volume, c.T, c.W_volume, grid, band=0.1 * c.L, depth=0.015 * c.L)
    fitted = fit_to_skin(c.V, c.F, c.W, grid, node, W_node, rng=np.random.default_rng(0))
    return grid, node, W_node.toarray(), fitted.toarray()


def filled(grid: Grid, node: np.ndarray, W_node: np.ndarray) -> np.ndarray:
    W_grid = np.full((grid.size, W_node.shape[1]), np.nan)
    W_grid[node] = W_node
    return W_grid.reshape(*grid.shape, -1)


@DIMENSIONS
def test_interpolation_is_nearer_to_the_weights_of_the_surface(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    grid, node, W_node, fitted = fit(c, 30)
    x, facet = facet_samples(c.V, c.F, 5000, rng=rng)  # not the samples of the fit
    skin = facet_values(c.V, c.F, c.W, x, facet)
    before, after = (np.abs(read(grid, filled(grid, node, W), x) - skin).sum(axis=1).mean() for W in (W_node, fitted))
    assert 0 < after < 0.8 * before
    np.testing.assert_allclose(fitted.sum(axis=1), 1, atol=1e-9)


@DIMENSIONS
def test_nodes_of_cells_without_surface_stay(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    grid, node, W_node, fitted = fit(c, 30)
    changed = (np.abs(fitted - W_node) > 1e-12).any(axis=1)
    x, _ = facet_samples(c.V, c.F, 200_000, rng=rng)
    cell = np.unique(((x - grid.origin) / grid.spacing).astype(int), axis=0)
    crossed = np.zeros(grid.shape, dtype=bool)
    for corner in np.ndindex(*(2,) * d):
        crossed[tuple((cell + corner).T)] = True
    assert not changed[~crossed.ravel()[node]].any()
    assert changed[crossed.ravel()[node]].mean() > 0.9


@DIMENSIONS
def test_weights_that_the_grid_interpolates_exactly_stay(d: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, 20, pad=0.1)
    slope = np.linspace(0.1, 0.3, d)
    first, at_nodes = c.V @ slope, grid.points() @ slope
    W, W_node = (np.stack([values, 1 - values], axis=1) for values in (first, at_nodes))
    fitted = fit_to_skin(c.V, c.F, W, grid, np.arange(grid.size), W_node, rng=np.random.default_rng(0))
    np.testing.assert_allclose(fitted.toarray(), W_node, atol=1e-9)


@DIMENSIONS
def test_the_surface_between_nodes_without_weights_does_not_count(d: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, 10)
    node = np.array([0])  # in a corner, far from the surface
    W_node = np.full((1, c.W.shape[1]), 1 / c.W.shape[1])
    for away in (grid, Grid(grid.origin + 9 * c.L, grid.spacing, grid.shape)):
        fitted = fit_to_skin(c.V, c.F, c.W, away, node, W_node, rng=np.random.default_rng(0))
        np.testing.assert_allclose(fitted.toarray(), W_node, rtol=1e-15)


def test_nodes_that_the_grid_does_not_have_are_refused(characters) -> None:
    c = characters[2]
    grid = Grid.box(c.V, 10)
    with pytest.raises(ValueError, match=r"node\[1\] = \[1000000\] does not index the \d+ nodes of the grid"):
        fit_to_skin(c.V, c.F, c.W, grid, [0, 10**6], np.ones((2, c.W.shape[1])), rng=np.random.default_rng(0))


def test_weights_of_other_shapes_are_refused(characters) -> None:
    c = characters[2]
    grid = Grid.box(c.V, 10)
    with pytest.raises(ValueError, match=r"W and W_node must be \(n, b\) = .* and \(s, b\) = \(3, b\)"):
        fit_to_skin(c.V, c.F, c.W, grid, [0, 1, 2], c.W[:2], rng=np.random.default_rng(0))


@DIMENSIONS
def test_it_is_the_technique_of_the_notes(d: int, characters) -> None:
    c = characters[d]
    grid, node, W_node, fitted = fit(c, 8)
    # A slow twin: every sample and corner by itself.
    area = facet_areas(c.V, c.F).sum() / grid.spacing ** (d - 1)
    x, facet = facet_samples(c.V, c.F, int(np.ceil(SAMPLES * area)), rng=np.random.default_rng(0))
    skin = facet_values(c.V, c.F, c.W, x, facet)
    W_grid, share = filled(grid, node, W_node), np.zeros(grid.shape)
    samples = []
    for place, wanted in zip((x - grid.origin) / grid.spacing, skin, strict=True):
        cell = place.astype(int)
        around = [
            (tuple(cell + corner), np.where(corner, place - cell, 1 - place + cell).prod())
            for corner in np.ndindex(*(2,) * d)
        ]
        if not any(np.isnan(W_grid[at]).any() for at, _ in around):
            samples.append((around, wanted))
            for at, weight in around:
                share[at] += weight
    assert samples
    damped = share + DAMPING * share[share > 0].mean()
    for _ in range(ROUNDS):
        change = np.zeros_like(W_grid)
        for around, wanted in samples:
            missed = wanted - sum(weight * W_grid[at] for at, weight in around)
            for at, weight in around:
                change[at] += weight * missed
        W_grid += change / damped[..., None]
    np.testing.assert_allclose(fitted, W_grid.reshape(grid.size, -1)[node], atol=1e-9)


def test_small_weights_are_dropped(characters) -> None:
    c = characters[2]
    grid, node, W_node, _ = fit(c, 20)
    kept = fit_to_skin(c.V, c.F, c.W, grid, node, W_node, smallest=0.01, rng=np.random.default_rng(0))
    whole = fit_to_skin(c.V, c.F, c.W, grid, node, W_node, rng=np.random.default_rng(0))
    assert kept.nnz < 0.8 * whole.nnz
    assert np.abs(kept.data).min() >= 0.01
    np.testing.assert_allclose(kept.sum(axis=1), 1, atol=1e-12)
    assert np.abs(kept - whole).max() < 0.1


def test_memory_does_not_grow_with_the_bones(characters) -> None:
    c = characters[3]
    grid = Grid.box(c.V, 60, pad=0.1)
    # Of 600 bones, of which three move any vertex.
    wide = [
        csr_array((W.data, 200 * W.indices, W.indptr), shape=(W.shape[0], 600))
        for W in map(csr_array, (c.W, c.W_volume))
    ]
    tracemalloc.start()
    try:
        node, W_node = weight_grid(c.V, c.F, wide[0], c.V_volume, c.T, wide[1], grid, band=0.1 * c.L, depth=0.015 * c.L)
        fitted = fit_to_skin(c.V, c.F, wide[0], grid, node, W_node, rng=np.random.default_rng(0))
        blocks = WeightBlocks.pack(node, fitted, grid)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(np.unique(blocks.bone)) == 3
    # A table of all nodes and bones in double precision would take eight bytes for each.
    assert peak < 4 * len(node) * 600
