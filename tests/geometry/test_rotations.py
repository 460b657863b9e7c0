import numpy as np
import pytest
from scipy.linalg import expm

from nilbs.geometry.rotations import (
    nearest_rotations,
    rigid_transforms,
    rotation_matrices,
    rotation_vectors,
    slerp,
    transform_points,
)

ANGLES = [0.0, 1e-300, 1e-160, 1e-9, 1e-7, 1e-3, 0.5, np.pi / 2, 3.0, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-9]


def directions(d: int, rng: np.random.Generator) -> np.ndarray:
    """Unit rotation axes (n, 3), the coordinate axes among them; in the plane both signs (2, 1)."""
    if d == 2:
        return np.array([[1.0], [-1.0]])
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(20, 3))])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def random_rotation_matrices(d: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform rotations by the QR decomposition of normal matrices."""
    Q, R = np.linalg.qr(rng.normal(size=(n, d, d)))
    Q *= np.sign(np.diagonal(R, axis1=1, axis2=2))[:, None, :]
    Q[:, :, 0] *= np.linalg.det(Q)[:, None]
    return Q


def test_a_quarter_turn_of_the_plane_and_about_each_axis_of_space() -> None:
    turn = np.pi / 2
    np.testing.assert_allclose(rotation_matrices([turn]) @ [1, 0], [0, 1], atol=1e-15)
    for k in range(3):
        R = rotation_matrices(turn * np.eye(3)[k])
        np.testing.assert_allclose(R @ np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3], atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [*ANGLES, np.pi, 4.0, 2 * np.pi, 100.0])
def test_orthogonal_to_rounding_at_every_angle(d: int, angle: float, rng: np.random.Generator) -> None:
    R = rotation_matrices(angle * directions(d, rng))
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(d), R.shape), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-13)


@pytest.mark.parametrize("angle", [1e-7, 0.3, 2.0, np.pi])
def test_the_exponential_of_the_cross_product_matrix(angle: float, rng: np.random.Generator) -> None:
    for theta in angle * directions(3, rng):
        x, y, z = theta
        np.testing.assert_allclose(rotation_matrices(theta), expm([[0, -z, y], [z, 0, -x], [-y, x, 0]]), atol=1e-14)


def test_the_plane_is_a_slice_of_space() -> None:
    angle = np.linspace(-4, 4, 41)[:, None]
    R = rotation_matrices(np.concatenate([0 * angle, 0 * angle, angle], axis=1))
    np.testing.assert_allclose(R[:, :2, :2], rotation_matrices(angle), atol=1e-15)
    np.testing.assert_allclose(R[:, 2], np.broadcast_to([0, 0, 1], (41, 3)), atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", ANGLES)
def test_vectors_to_matrices_and_back(d: int, angle: float, rng: np.random.Generator) -> None:
    theta = angle * directions(d, rng)
    np.testing.assert_allclose(rotation_vectors(rotation_matrices(theta)), theta, rtol=1e-10, atol=1e-14 * angle)


@pytest.mark.parametrize("d", [2, 3])
def test_matrices_to_vectors_and_back(d: int, rng: np.random.Generator) -> None:
    # Half turns, whose axis has two signs, among them.
    R = np.concatenate([random_rotation_matrices(d, 200, rng), rotation_matrices(np.pi * directions(d, rng))])
    theta = rotation_vectors(R)
    assert np.linalg.norm(theta, axis=1).max() <= np.pi + 1e-12
    np.testing.assert_allclose(rotation_matrices(theta), R, atol=1e-13)


def test_leading_dimensions_are_kept(rng: np.random.Generator) -> None:
    theta = rng.uniform(-1, 1, (2, 5, 3))
    R = rotation_matrices(theta)
    assert R.shape == (2, 5, 3, 3)
    np.testing.assert_array_equal(R[1, 3], rotation_matrices(theta[1, 3]))
    np.testing.assert_allclose(rotation_vectors(R), theta, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_transforms_turn_then_move(d: int, rng: np.random.Generator) -> None:
    R, t, x = random_rotation_matrices(d, 4, rng), rng.normal(size=(4, d)), rng.normal(size=(4, d))
    B = rigid_transforms(R, t)
    for i in range(4):
        np.testing.assert_allclose(B[i] @ [*x[i], 1], [*(R[i] @ x[i] + t[i]), 1], atol=1e-14)
    np.testing.assert_allclose(transform_points(B, x), [R[i] @ x[i] + t[i] for i in range(4)], atol=1e-14)
    np.testing.assert_allclose(transform_points(np.linalg.inv(B), transform_points(B, x)), x, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_one_rotation_goes_with_many_translations_and_many_points(d: int, rng: np.random.Generator) -> None:
    t, x = rng.normal(size=(3, 1, d)), rng.normal(size=(7, d))
    B = rigid_transforms(np.eye(d), t)
    assert B.shape == (3, 1, d + 1, d + 1)
    np.testing.assert_allclose(transform_points(B, x), x + t)


@pytest.mark.parametrize("d", [2, 3])
def test_the_rotation_of_a_stretched_rotation(d: int, rng: np.random.Generator) -> None:
    R, M = random_rotation_matrices(d, 50, rng), rng.normal(size=(50, d, d))
    stretch = M @ M.swapaxes(1, 2) + 0.1 * np.eye(d)
    np.testing.assert_allclose(nearest_rotations(R @ stretch), R, atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_no_other_rotation_is_nearer(d: int, rng: np.random.Generator) -> None:
    A = rng.normal(size=(30, d, d))  # half of them reflect
    R = nearest_rotations(A)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    others = random_rotation_matrices(d, 2000, rng)
    for i in range(30):
        assert np.linalg.norm(A[i] - R[i]) <= np.linalg.norm(A[i] - others, axis=(1, 2)).min() + 1e-12
    assert (np.linalg.det(A) < 0).any()


@pytest.mark.parametrize("d", [2, 3])
def test_even_a_matrix_of_zeros_has_a_rotation(d: int) -> None:
    R = nearest_rotations(np.zeros((d, d)))
    np.testing.assert_allclose(R @ R.T, np.eye(d), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1)


@pytest.mark.parametrize("d", [2, 3])
def test_slerp_has_constant_speed_on_the_shortest_way(d: int, rng: np.random.Generator) -> None:
    R0, R1 = random_rotation_matrices(d, 20, rng), random_rotation_matrices(d, 20, rng)
    np.testing.assert_allclose(slerp(R0, R1, 0.0), R0, atol=1e-14)
    np.testing.assert_allclose(slerp(R0, R1, 1.0), R1, atol=1e-12)
    whole = np.linalg.norm(rotation_vectors(R0.swapaxes(1, 2) @ R1), axis=1)
    for s in (0.1, 0.5, 0.9):
        part = rotation_vectors(R0.swapaxes(1, 2) @ slerp(R0, R1, s))
        np.testing.assert_allclose(np.linalg.norm(part, axis=1), s * whole, atol=1e-10)
        np.testing.assert_allclose(slerp(R1, R0, 1 - s), slerp(R0, R1, s), atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_slerp_moves_with_the_world(d: int, rng: np.random.Generator) -> None:
    world, R0, R1 = random_rotation_matrices(d, 3, rng)
    np.testing.assert_allclose(slerp(world @ R0, world @ R1, 0.3), world @ slerp(R0, R1, 0.3), atol=1e-12)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^theta must be \(\.\.\., 1\) in the plane or \(\.\.\., 3\) in space, got"):
        rotation_matrices([0.0, 1.0])
    with pytest.raises(ValueError, match=r"R has d = 4"):
        rotation_vectors(np.eye(4))
    with pytest.raises(ValueError, match=r"t must be \(\.\.\., d\) = \(\.\.\., 2\), got \(3,\)"):
        rigid_transforms(np.eye(2), np.zeros(3))
    with pytest.raises(ValueError, match=r"A must be"):
        nearest_rotations(np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"R1 must be"):
        slerp(np.eye(2), np.eye(3), 0.5)
    with pytest.raises(ValueError, match=r"B must be"):
        transform_points(np.eye(3), np.zeros((5, 3)))
