import numpy as np
import pytest

from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_values
from nilbs.geometry.rest_grids import weight_grid
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.skin_fit import BONES, fit_to_skin

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
    return grid, node, W_node, fit_to_skin(c.V, c.F, c.W, grid, node, W_node, rng=np.random.default_rng(0))


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
    changed = (fitted != W_node).any(axis=1)
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
    np.testing.assert_allclose(fitted, W_node, atol=1e-9)


@DIMENSIONS
def test_the_surface_between_nodes_without_weights_does_not_count(d: int, characters) -> None:
    c = characters[d]
    grid = Grid.box(c.V, 10)
    node = np.array([0])  # in a corner, far from the surface
    W_node = np.full((1, c.W.shape[1]), 1 / c.W.shape[1])
    for away in (grid, Grid(grid.origin + 9 * c.L, grid.spacing, grid.shape)):
        fitted = fit_to_skin(c.V, c.F, c.W, away, node, W_node, rng=np.random.default_rng(0))
        np.testing.assert_array_equal(fitted, W_node)


def test_nodes_that_the_grid_does_not_have_are_refused(characters) -> None:
    c = characters[2]
    grid = Grid.box(c.V, 10)
    with pytest.raises(ValueError, match=r"node\[1\] = \[1000000\] does not index the \d+ nodes of the grid"):
        fit_to_skin(c.V, c.F, c.W, grid, [0, 10**6], np.ones((2, c.W.shape[1])), rng=np.random.default_rng(0))


def test_bones_are_fitted_alike_however_many_there_are(characters) -> None:
    c = characters[2]
    grid, node, W_node, alone = fit(c, 20)
    times = BONES // c.W.shape[1] + 2
    many = fit_to_skin(c.V, c.F, np.tile(c.W, times), grid, node, np.tile(W_node, times), rng=np.random.default_rng(0))
    np.testing.assert_allclose(many, np.tile(alone, times), atol=1e-12)
