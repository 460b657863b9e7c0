import numpy as np
import pytest

from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning


def weights(n: int, b: int, rng: np.random.Generator) -> np.ndarray:
    return rng.dirichlet(np.ones(b), n)


def bones(d: int, b: int, rng: np.random.Generator, *, angle: float = 1.0) -> np.ndarray:
    theta = angle * rng.uniform(-1, 1, (b, 3 if d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), rng.normal(size=(b, d)))


@pytest.mark.parametrize("d", [2, 3])
def test_a_loop_over_points_and_bones(d: int, rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(6, d)), weights(6, 4, rng), bones(d, 4, rng)
    U, x_rest = np.zeros((6, d)), np.zeros((6, d))
    for i in range(6):
        blend = sum(W[i, b] * B[b] for b in range(4))
        U[i] = (blend @ [*V[i], 1])[:d]
        x_rest[i] = (np.linalg.inv(blend) @ [*V[i], 1])[:d]
    np.testing.assert_allclose(linear_blend_skinning(V, W, B), U, atol=1e-14)
    np.testing.assert_allclose(inverse_linear_blend_skinning(V, W, B), x_rest, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, np.pi - 1e-7])
def test_one_rigid_motion_on_every_bone_is_that_motion(d: int, angle: float, rng: np.random.Generator) -> None:
    V, W = rng.normal(size=(200, d)), weights(200, 5, rng)
    B = np.repeat(bones(d, 1, rng, angle=angle), 5, axis=0)
    np.testing.assert_allclose(linear_blend_skinning(V, W, B), transform_points(B[0], V), atol=1e-10)
    x_rest = inverse_linear_blend_skinning(V, W, B)
    np.testing.assert_allclose(x_rest, transform_points(np.linalg.inv(B[0]), V), atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_posed_and_back(d: int, rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(300, d)), weights(300, 4, rng), bones(d, 4, rng)
    U = linear_blend_skinning(V, W, B)
    np.testing.assert_allclose(inverse_linear_blend_skinning(U, W, B), V, atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_the_world_moves_and_the_answer_moves(d: int, rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(50, d)), weights(50, 4, rng), bones(d, 4, rng)
    world = bones(d, 1, rng)[0]
    U = linear_blend_skinning(V, W, B)
    np.testing.assert_allclose(linear_blend_skinning(V, W, world @ B), transform_points(world, U), atol=1e-13)
    x_rest = inverse_linear_blend_skinning(transform_points(world, U), W, world @ B)
    np.testing.assert_allclose(x_rest, V, atol=1e-12)


def test_the_plane_is_a_slice_of_space(rng: np.random.Generator) -> None:
    V, W, B = rng.normal(size=(50, 2)), weights(50, 4, rng), bones(2, 4, rng)
    in_space = np.broadcast_to(np.eye(4), (4, 4, 4)).copy()
    rows, columns = np.ix_([0, 1, 3], [0, 1, 3])
    in_space[:, rows, columns] = B
    flat = np.pad(V, ((0, 0), (0, 1)))
    for function in (linear_blend_skinning, inverse_linear_blend_skinning):
        answer = function(flat, W, in_space)
        np.testing.assert_allclose(answer[:, :2], function(V, W, B), atol=1e-13)
        np.testing.assert_array_equal(answer[:, 2], 0)


def test_the_blend_is_inverted_and_not_the_bones() -> None:
    # Half-way between a quarter turn and its opposite lies a shrunken identity, whose inverse expands.
    B = rigid_transforms(rotation_matrices([[np.pi / 4], [-np.pi / 4]]), np.zeros((2, 2)))
    shrink = np.sqrt(0.5)
    np.testing.assert_allclose(linear_blend_skinning([[1, 0]], [[0.5, 0.5]], B), [[shrink, 0]])
    np.testing.assert_allclose(inverse_linear_blend_skinning([[1, 0]], [[0.5, 0.5]], B), [[1 / shrink, 0]])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_opposite_rotations_in_equal_parts_have_no_inverse(d: int, scale: float) -> None:
    turn = rotation_matrices(np.array([0, 0, np.pi])[-1 if d == 2 else 0 :])  # the sine of pi is not quite zero
    B = rigid_transforms(scale * np.stack([np.eye(d), turn]), np.zeros((2, d)))
    x_rest = inverse_linear_blend_skinning(np.ones((2, d)), [[0.5, 0.5], [1, 0]], B)
    assert np.isnan(x_rest[0]).all()
    np.testing.assert_allclose(x_rest[1], 1 / scale)


@pytest.mark.parametrize("function", [linear_blend_skinning, inverse_linear_blend_skinning])
@pytest.mark.parametrize("d", [2, 3])
def test_no_points(function, d: int) -> None:
    assert function(np.zeros((0, d)), np.zeros((0, 2)), np.stack([np.eye(d + 1)] * 2)).shape == (0, d)


@pytest.mark.parametrize("function", [linear_blend_skinning, inverse_linear_blend_skinning])
def test_sizes_that_disagree_are_refused(function) -> None:
    with pytest.raises(ValueError, match=r"^W must be \(n, b\) = \(5, b\), got \(4, 3\)$"):
        function(np.zeros((5, 2)), np.zeros((4, 3)), np.zeros((3, 3, 3)))
    with pytest.raises(ValueError, match=r"^B must be \(b, d\+1, d\+1\) = \(3, 3, 3\), got \(2, 3, 3\)$"):
        function(np.zeros((5, 2)), np.zeros((5, 3)), np.zeros((2, 3, 3)))
    with pytest.raises(ValueError, match=r"^B must be \(b, d\+1, d\+1\) = \(3, 3, 3\), got \(3, 4, 4\)$"):
        function(np.zeros((5, 2)), np.zeros((5, 3)), np.zeros((3, 4, 4)))
