import numpy as np
import pytest
from scipy.sparse import csr_array

from nilbs.geometry.grids import Grid
from nilbs.geometry.weight_blocks import EDGE, LARGEST, LEAST, ONE, WeightBlocks

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
# A last block that is whole, and one that reaches beyond the grid.
SHAPES = {2: (13, 11), 3: (9, 10, 7)}
BONES = 7


def weights(s: int, rng: np.random.Generator) -> np.ndarray:
    """Rows that sum to one, with about half of the bones."""
    W = rng.dirichlet(np.ones(BONES), s) * (rng.random((s, BONES)) < 0.5)
    W[W.sum(axis=1) == 0, 0] = 1
    return W / W.sum(axis=1, keepdims=True)


def tables(blocks: WeightBlocks, bones: int = BONES) -> np.ndarray:
    """Weights (k, nodes, b) of all blocks, in parts of one."""
    nodes = (EDGE + 1) ** blocks.place.shape[1]
    found = np.zeros((len(blocks.place), nodes, bones), dtype=int)
    for k, (begin, end) in enumerate(zip(blocks.first, blocks.first[1:], strict=False)):
        found[k][:, blocks.bone[begin:end]] = blocks.weight[nodes * begin : nodes * end].reshape(nodes, end - begin)
    return found


def dense(rows: dict[str, np.ndarray], bones: int = BONES) -> np.ndarray:
    return csr_array((rows["weight"], rows["bone"], rows["first"]), shape=(len(rows["node"]), bones)).toarray()


@DIMENSIONS
def test_rows_are_what_was_packed(d: int, rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(d), 1.0, SHAPES[d])
    node, W = np.arange(grid.size), weights(grid.size, rng)
    for given in (W, csr_array(W)):
        rows = WeightBlocks.pack(node, given, grid).rows(grid.shape)
        np.testing.assert_array_equal(rows["node"], node)
        np.testing.assert_array_equal(rows["row"].ravel(), node)
        found = dense(rows)
        assert np.abs(found - W).max() < 1 / ONE
        np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
        # What is no weight stays none.
        assert (found[W == 0] == 0).all()


@DIMENSIONS
def test_every_node_of_a_block_sums_to_one(d: int, rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(d), 1.0, SHAPES[d])
    node = np.sort(rng.choice(grid.size, 40, replace=False))
    blocks = WeightBlocks.pack(node, weights(40, rng), grid)
    assert (tables(blocks).sum(axis=2) == ONE).all()
    assert [array.dtype for array in blocks] == [np.int32, np.int64, np.int32, np.int16]


@DIMENSIONS
def test_blocks_are_those_with_a_node(d: int, rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(d), 1.0, SHAPES[d])
    node = np.sort(rng.choice(grid.size, 3, replace=False))
    W = weights(3, rng)
    blocks = WeightBlocks.pack(node, W, grid)
    # A slow twin: every block by itself.
    index = np.stack(np.unravel_index(node, grid.shape), axis=-1)
    places, found = [], tables(blocks)
    for place in np.ndindex(*[-(-(n - 1) // EDGE) for n in grid.shape]):
        low = EDGE * np.array(place)
        if ((index >= low) & (index <= low + EDGE)).all(axis=1).any():
            places.append(place)
    assert blocks.place.tolist() == [list(place) for place in places]
    for k, place in enumerate(places):
        for n, local in enumerate(np.ndindex(*(EDGE + 1,) * d)):
            at = np.minimum(EDGE * np.array(place) + local, np.array(grid.shape) - 1)
            away = np.linalg.norm(index - at, axis=1)
            nearest = np.flatnonzero(away == away.min())
            assert min(np.abs(found[k, n] / ONE - W[row]).max() for row in nearest) < 1 / ONE


@DIMENSIONS
def test_weights_out_of_range_are_moved_to_their_part_within(d: int) -> None:
    grid = Grid(np.zeros(d), 1.0, (2,) * d)
    W = np.array([[1.0, 0, 0], [2.6, -1.6, 0], [3.0, -2.5, 0.5], [-0.4, 1.4, 0], [2.0, -1.0, 0]])
    kept = W[[1, 2, 3, 4] + [0] * (2**d - 4)]
    found = dense(WeightBlocks.pack(np.arange(2**d), kept, grid).rows(grid.shape), 3)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(found[0], [2, -1, 0], atol=1 / ONE)
    # (3, -2.5, 0.5) is p + t (w - p) with p = (6/7, 0, 1/7); t = 0.4 brings the second weight to -1.
    np.testing.assert_allclose(found[1], [6 / 7 + 0.4 * (3 - 6 / 7), -1, 1 / 7 + 0.4 * (0.5 - 1 / 7)], atol=1 / ONE)
    np.testing.assert_allclose(found[2], W[3], atol=1 / ONE)
    np.testing.assert_allclose(found[3], W[4], atol=1 / ONE)
    assert found.min() >= LEAST
    assert found.max() <= LARGEST + 1 / ONE


def test_any_weights_fit_into_their_integers(rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(3), 1.0, (6, 6, 6))
    W = rng.normal(size=(grid.size, 90)) * 10.0 ** rng.uniform(-3, 3, (grid.size, 1))
    W[:, 0] += 1 - W.sum(axis=1)
    found = tables(WeightBlocks.pack(np.arange(grid.size), W, grid), 90)
    assert (found.sum(axis=2) == ONE).all()
    assert found.min() >= LEAST * ONE - 1
    assert found.max() <= LARGEST * ONE + 1


@DIMENSIONS
def test_nodes_outside_all_blocks_have_the_row_of_the_nearest(d: int, rng: np.random.Generator) -> None:
    grid = Grid(np.zeros(d), 1.0, SHAPES[d])
    rows = WeightBlocks.pack(np.array([0]), weights(1, rng), grid).rows(grid.shape)
    x = grid.points()
    away = np.linalg.norm(x[:, None] - x[rows["node"]], axis=2)
    np.testing.assert_allclose(away[np.arange(grid.size), rows["row"].ravel()], away.min(axis=1))
