import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from nilbs.fields.cache import RestCache

SHAPES = {2: (5, 4), 3: (5, 4, 3)}
ORIGIN, SPACING = 0.3, 0.25


def cache(values: np.ndarray, *, width: float = 0.1) -> RestCache:
    origin = torch.full((values.ndim,), ORIGIN, dtype=torch.float64)
    return RestCache.of_grid(torch.as_tensor(values), origin, SPACING, width=width)


def nodes(d: int) -> np.ndarray:
    return ORIGIN + SPACING * np.stack(np.meshgrid(*map(np.arange, SHAPES[d]), indexing="ij"), axis=-1)


def inside(d: int, n: int, rng: np.random.Generator) -> np.ndarray:
    return ORIGIN + SPACING * rng.uniform(0, np.array(SHAPES[d]) - 1, (n, d))


@pytest.mark.parametrize("d", [2, 3])
def test_an_affine_function_is_read_exactly(d: int, rng: np.random.Generator) -> None:
    slope = rng.normal(size=d)
    x = inside(d, 300, rng)
    distance = cache(nodes(d) @ slope + 0.7).distance(torch.as_tensor(x))
    np.testing.assert_allclose(distance, x @ slope + 0.7, atol=1e-13)


@pytest.mark.parametrize("d", [2, 3])
def test_any_values_are_interpolated_multilinearly(d: int, rng: np.random.Generator) -> None:
    values = rng.normal(size=SHAPES[d])
    axes = [ORIGIN + SPACING * np.arange(n) for n in SHAPES[d]]
    x = np.concatenate([inside(d, 300, rng), nodes(d).reshape(-1, d)])
    expected = RegularGridInterpolator(axes, values)(np.clip(x, None, [axis[-1] for axis in axes]))
    np.testing.assert_allclose(cache(values).distance(torch.as_tensor(x)), expected, atol=1e-13)


@pytest.mark.parametrize("d", [2, 3])
def test_beyond_the_grid_the_distance_to_it_is_added(d: int, rng: np.random.Generator) -> None:
    values = rng.normal(size=SHAPES[d])
    lower, upper = ORIGIN, ORIGIN + SPACING * (np.array(SHAPES[d]) - 1)
    x = rng.uniform(-3, 4, (300, d))
    nearest = np.clip(x, lower, upper)
    there = cache(values).distance(torch.as_tensor(nearest)).numpy()
    distance = cache(values).distance(torch.as_tensor(x)).numpy()
    np.testing.assert_allclose(distance, there + np.linalg.norm(x - nearest, axis=1), atol=1e-12)
    assert (np.linalg.norm(x - nearest, axis=1) > 0).sum() > 200


@pytest.mark.parametrize("d", [2, 3])
def test_continuous_across_cells_and_across_the_border(d: int, rng: np.random.Generator) -> None:
    values = rng.normal(size=SHAPES[d])
    x = ORIGIN + SPACING * rng.integers(0, SHAPES[d], (300, d))  # nodes, those of the border among them
    step = 1e-9 * rng.normal(size=(300, d))
    field = cache(values)
    before, after = field.distance(torch.as_tensor(x - step)), field.distance(torch.as_tensor(x + step))
    np.testing.assert_allclose(before, after, atol=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_the_derivative_is_right_inside_and_beyond(d: int, rng: np.random.Generator) -> None:
    field = cache(rng.normal(size=SHAPES[d]))
    # Kinks lie on cell faces: keep the middle of cells, and one point beyond each side.
    position = np.concatenate([np.floor(rng.uniform(0, np.array(SHAPES[d]) - 1, (8, d))), np.full((1, d), -2.0)])
    position = np.concatenate([position, [np.array(SHAPES[d]) + 2.0]])
    x = ORIGIN + SPACING * (position + rng.uniform(0.2, 0.8, position.shape))
    x = torch.tensor(x, requires_grad=True)
    assert torch.autograd.gradcheck(field.distance, x)
    assert torch.autograd.gradcheck(field.occupancy, x)


@pytest.mark.parametrize("d", [2, 3])
def test_the_derivative_is_finite_everywhere(d: int) -> None:
    field = cache(np.zeros(SHAPES[d]))
    x = torch.tensor(np.concatenate([nodes(d).reshape(-1, d), np.full((1, d), 1e30)]), requires_grad=True)
    field.distance(x).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_occupancy_is_a_sigmoid_of_the_distance() -> None:
    x = torch.full((3, 2), ORIGIN, dtype=torch.float64)
    for distance, expected in ((0.0, 0.5), (-0.2, 1 / (1 + np.exp(-2.0))), (0.2, 1 / (1 + np.exp(2.0)))):
        occupancy = cache(np.full((2, 2), distance), width=0.1).occupancy(x)
        np.testing.assert_allclose(occupancy, expected, atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_without_a_canonical_point_has_no_distance_and_changes_no_other(d: int) -> None:
    x = np.full((3, d), ORIGIN)
    x[1, -1], x[2, 0] = np.nan, np.inf
    distance = cache(np.full(SHAPES[d], 0.5)).distance(torch.as_tensor(x))
    assert distance[0] == 0.5
    assert torch.isnan(distance[1])
    assert distance[2] == np.inf
    # Nor in a divided cell.
    x = np.full((3, d), ORIGIN + SPACING * 1.1)
    x[1, -1] = np.nan
    distance = Tree(d, np.random.default_rng(0)).cache().distance(torch.as_tensor(x))
    assert torch.isfinite(distance[0])
    assert torch.isnan(distance[1])
    assert distance[2] == distance[0]


def test_leading_dimensions_and_the_order_in_memory_do_not_matter(rng: np.random.Generator) -> None:
    values, x = rng.normal(size=SHAPES[3]), torch.as_tensor(inside(3, 12, rng))
    expected = cache(values).distance(x)
    turned = torch.as_tensor(values.T.copy()).permute(2, 1, 0)
    assert not turned.is_contiguous()
    field = RestCache.of_grid(turned, torch.full((3,), ORIGIN, dtype=torch.float64), SPACING, width=0.1)
    np.testing.assert_array_equal(field.distance(x.reshape(3, 4, 3)), expected.reshape(3, 4))


class Tree:
    """Random values on a grid of which two cells are divided, one of them without and one with divided cells in it."""

    PARTS = (3, 2)

    def __init__(self, d: int, rng: np.random.Generator) -> None:
        shape = np.array(SHAPES[d])
        cells = [(1,) * d, tuple(shape - 2)]
        coarse, first, second = rng.normal(size=shape), rng.normal(size=(2, *(4,) * d)), rng.normal(size=(2, *(3,) * d))
        self.brick = np.full(shape - 1, -1, dtype=np.int32)
        self.brick[cells[0]], self.brick[cells[1]] = 0, 1
        finer = np.full((2, *(3,) * d), -1, dtype=np.int32)
        parts = [(0,) * d, (2,) * d]
        finer[1][parts[0]], finer[1][parts[1]] = 0, 1
        self.finer = finer.ravel()
        self.coarse, self.values = coarse, np.concatenate([part.ravel() for part in (coarse, first, second)])
        corners = [ORIGIN + SPACING * np.array(cell) for cell in cells]
        finest = [corners[1] + SPACING / 3 * np.array(part) for part in parts]
        # Corner, edge and nodes of every brick; the finest last.
        self.bricks = [
            *zip(corners, (SPACING, SPACING), first, strict=True),
            *zip(finest, (SPACING / 3, SPACING / 3), second, strict=True),
        ]

    def cache(self, **changes) -> RestCache:
        d = self.brick.ndim
        arrays = {"values": self.values, "brick": self.brick, "finer": self.finer, "origin": np.full(d, ORIGIN)}
        tensors = {name: torch.as_tensor(array) for name, array in (arrays | changes).items()}
        return RestCache(**tensors, spacing=SPACING, parts=self.PARTS, width=0.1)


@pytest.mark.parametrize("d", [2, 3])
def test_a_divided_cell_is_read_at_its_own_nodes(d: int, rng: np.random.Generator) -> None:
    tree = Tree(d, rng)
    field = tree.cache()
    lower, upper = ORIGIN, ORIGIN + SPACING * (np.array(SHAPES[d]) - 1)
    x = rng.uniform(lower - 0.3, upper + 0.3, (4000, d))
    x = np.concatenate([x, *(corner + edge * rng.uniform(0, 1, (300, d)) for corner, edge, _ in tree.bricks)])
    nearest = np.clip(x, lower, upper)
    # Cells that are not divided are as they were.
    expected, finest = cache(tree.coarse).distance(torch.as_tensor(nearest)).numpy(), np.full(len(x), -1)
    for k, (corner, edge, fine) in enumerate(tree.bricks):
        at = (nearest - corner) / edge
        within = ((at > -1e-12) & (at < 1 + 1e-12)).all(axis=1)
        axes = [np.linspace(0, 1, fine.shape[0])] * d
        expected[within], finest[within] = RegularGridInterpolator(axes, fine)(np.clip(at[within], 0, 1)), k
    expected += np.linalg.norm(x - nearest, axis=1)
    np.testing.assert_allclose(field.distance(torch.as_tensor(x)).numpy(), expected, atol=1e-12)
    assert (np.bincount(finest + 1, minlength=5) > 100).all()


@pytest.mark.parametrize("d", [2, 3])
def test_a_divided_cell_has_derivatives(d: int, rng: np.random.Generator) -> None:
    tree = Tree(d, rng)
    # Kinks lie on the faces of the smallest cells: keep their middles.
    x = np.concatenate([
        corner + edge / n * (rng.integers(0, n, (4, d)) + rng.uniform(0.1, 0.4, (4, d)))
        for corner, edge, n in ((corner, edge, 2 * (fine.shape[0] - 1)) for corner, edge, fine in tree.bricks)
    ])  # fmt: skip
    assert torch.autograd.gradcheck(tree.cache().distance, torch.tensor(x, requires_grad=True))


@pytest.mark.parametrize("d", [2, 3])
def test_bricks_must_have_all_their_nodes_and_cells(d: int, rng: np.random.Generator) -> None:
    tree = Tree(d, rng)
    for change in (
        {"values": tree.values[:-1]},
        {"values": np.concatenate([tree.values, [0.0]])},
        {"finer": tree.finer[:-1]},
        {"finer": np.concatenate([tree.finer, tree.finer[:1]])},
        {"brick": tree.brick + 1},
        {"finer": np.where(tree.finer < 0, tree.finer, 2**30)},
    ):
        with pytest.raises(ValueError, match=r"bricks have \d+ nodes and the bricks \d+ cells, not"):
            tree.cache(**change)
