import numpy as np
import pytest
import torch

from nilbs.engine.array_engine import WIDTH, ArrayEngine
from nilbs.fields.array_field import ArrayField
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import node_levels
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics, random_rotations
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy
from nilbs.methods.rigid_parts.field import RigidPieces


def rigid(c) -> ArrayField:
    return ArrayField(ArrayEngine(RigidPieces(c.V, c.F, c.W, c.V_volume, c.W_volume)))


def bent(c, rng: np.random.Generator, std: float = 0.6) -> np.ndarray:
    return forward_kinematics(
        c.skeleton.C, c.skeleton.BE, c.skeleton.P, random_rotations(c.skeleton.P, c.d, 1, std=std, rng=rng)
    )[0]


def around(c, B: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    U = linear_blend_skinning(c.V, c.W, B)
    pad = 0.3 * np.ptp(U, axis=0)
    return rng.uniform(U.min(axis=0) - pad, U.max(axis=0) + pad, (n, c.d))


def slow_parts(c, B: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Canonical points (b, n, d) by every bone, their distances, and which are in their own part; without a tree."""
    places, W = np.concatenate([c.V, c.V_volume]), np.concatenate([c.W, c.W_volume])
    x_rest = np.array([transform_points(np.linalg.inv(B[b]), x) for b in range(len(B))])
    distance, own = np.empty(x_rest.shape[:2]), np.empty(x_rest.shape[:2], dtype=bool)
    for b in range(len(B)):
        distance[b] = signed_distance(c.V, c.F, x_rest[b])
        for i in range(len(x)):
            own[b, i] = W[np.linalg.norm(places - x_rest[b, i], axis=1).argmin()].argmax() == b
    return x_rest, distance, own


@pytest.mark.parametrize("d", [2, 3])
def test_it_equals_the_union_written_out(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    x = around(c, B, 300, rng)
    answer = rigid(c).posed(torch.as_tensor(B))(torch.as_tensor(x))
    x_rest, distance, own = slow_parts(c, B, x)
    level = np.where(own, distance, np.inf).min(axis=0)
    inside = level < 0
    assert 30 < inside.sum() < 270
    np.testing.assert_array_equal(answer.level < 0, inside)
    np.testing.assert_allclose(answer.distance[inside], level[inside], atol=1e-12)
    deepest = np.where(own, distance, np.inf).argmin(axis=0)
    chosen = x_rest[deepest, np.arange(len(x))]
    np.testing.assert_allclose(answer.x_rest[inside], chosen[inside], atol=1e-12)
    assert (answer.distance[~inside] > 0).all()
    np.testing.assert_array_equal(answer.level, answer.distance)
    assert answer.width == WIDTH


@pytest.mark.parametrize("d", [2, 3])
def test_outside_the_distance_is_no_more_than_to_any_part(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    field = rigid(c).posed(torch.as_tensor(B))
    x = around(c, B, 2000, rng)
    distance = field(torch.as_tensor(x)).distance.numpy()
    # Points of posed parts: the nearest of them is about as far as the part.
    held, outside = x[distance < 0], distance > 0
    nearest = np.linalg.norm(x[outside][:, None] - held, axis=2).min(axis=1)
    assert (distance[outside] <= nearest + 1e-5).all()
    # And it is not far below.
    assert np.median(distance[outside] / nearest) > 0.5


@pytest.mark.parametrize("d", [2, 3])
def test_at_rest_it_is_the_rest_shape(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    world = rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), rng.normal(size=d))
    B = np.repeat(world[None], len(c.skeleton.BE), axis=0)
    x_rest = around(c, np.repeat(np.eye(d + 1)[None], len(B), axis=0), 1000, rng)
    answer = rigid(c).posed(torch.as_tensor(B))(torch.as_tensor(transform_points(world, x_rest)))
    true = signed_distance(c.V, c.F, x_rest)
    inside = true < 0
    np.testing.assert_array_equal(answer.level < 0, inside)
    np.testing.assert_allclose(answer.x_rest[inside], x_rest[inside], atol=1e-9)
    np.testing.assert_allclose(answer.distance[inside], true[inside], atol=1e-9)
    assert (answer.distance.numpy()[~inside] <= true[~inside] + 1e-5).all()
    # Near the skin the distance is exact, also on the seams, where parts meet.
    near = ~inside & (true < 0.03 * c.L)
    assert near.any()
    np.testing.assert_allclose(answer.distance[near], true[near], atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_blocks_that_extraction_passes_over_hold_no_surface(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    field = rigid(c).posed(torch.as_tensor(B))

    def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance = field(torch.as_tensor(x)).distance.numpy()
        return distance, distance

    grid = Grid.cube(linear_blend_skinning(c.V, c.W, B), {2: 96, 3: 64}[d])
    coarse, queries = node_levels(levels, grid, stride=4)
    assert queries < coarse.size
    np.testing.assert_array_equal(coarse.ravel() < 0, levels(grid.points())[0] < 0)


def test_two_parts_that_turn_apart_keep_their_shape() -> None:
    # A bar cut at x = 0; the right half turns by a right angle about the origin.
    V = np.array([[-1.0, -0.2], [1, -0.2], [1, 0.2], [-1, 0.2]])
    V = np.concatenate([np.linspace(V[i], V[(i + 1) % 4], 20, endpoint=False) for i in range(4)])
    F = np.stack([np.arange(80), np.roll(np.arange(80), -1)], axis=1)
    W = np.stack([V[:, 0] < 0, V[:, 0] >= 0], axis=1).astype(float)
    turn = rigid_transforms(rotation_matrices(np.array([np.pi / 2])), np.zeros(2))
    field = ArrayField(ArrayEngine(RigidPieces(V, F, W, np.zeros((0, 2)), np.zeros((0, 2)))))
    posed = field.posed(torch.as_tensor(np.stack([np.eye(3), turn])))
    x = torch.tensor([[-0.5, 0.0], [0.0, 0.5], [0.5, 0.0], [0.0, -0.5]], dtype=torch.float64)
    answer = posed(x)
    torch.testing.assert_close(answer.distance[:2], torch.full((2,), -0.2, dtype=torch.float64))
    assert (answer.distance[2:] > 0.1).all()
    torch.testing.assert_close(answer.x_rest[:2], torch.tensor([[-0.5, 0.0], [0.5, 0.0]], dtype=torch.float64))


@pytest.mark.parametrize("d", [2, 3])
def test_a_bone_that_flattens_space_holds_nothing(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = np.repeat(np.eye(d + 1)[None], len(c.skeleton.BE), axis=0)
    B[-1, :d, :d] = 0
    x = torch.as_tensor(c.V_volume)
    answer = rigid(c).posed(torch.as_tensor(B))(x)
    own = c.W_volume.argmax(axis=1) == len(B) - 1
    inner = signed_distance(c.V, c.F, c.V_volume) < -1e-9
    assert (own & inner).any()
    assert (answer.level.numpy()[own & inner] > 0).all()
    assert (answer.level.numpy()[~own & inner] < 0).all()
    B[:, :d, :d] = 0
    assert (rigid(c).posed(torch.as_tensor(B))(x).distance > 5).all()


def test_types_and_no_points(characters) -> None:
    c = characters[3]
    posed = rigid(c).float().posed(torch.eye(4).expand(len(c.skeleton.BE), 4, 4))
    answer = posed(torch.as_tensor(c.V_volume).float())
    assert answer.level.dtype == answer.distance.dtype == answer.x_rest.dtype == torch.float32
    inner = signed_distance(c.V, c.F, c.V_volume) < -1e-4
    np.testing.assert_array_equal(answer.level.numpy()[inner] < 0, occupancy(c.V, c.F, c.V_volume[inner]))
    empty = posed(torch.zeros((0, 3)))
    assert empty.level.shape == (0,)
    assert empty.x_rest.shape == (0, 3)
