import numpy as np
import pytest
import torch

from nilbs.fields.encoding import SOFT, DistanceEncoding, LocalEncoding, ParameterEncoding
from nilbs.fields.kinematics import forward_kinematics, local_angles
from nilbs.geometry.rotations import rotation_matrices, transform_points

C = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0.2, 0.1], [1.2, 0.5, 0.3]])
BE, P = np.array([[0, 1], [1, 2], [2, 3]]), np.array([-1, 0, 1])


def poses(d: int, theta: np.ndarray) -> torch.Tensor:
    return torch.stack([forward_kinematics(torch.as_tensor(C[:, :d]), BE, P, torch.as_tensor(t)) for t in theta])


def angles(d: int, size: float, rng: np.random.Generator) -> np.ndarray:
    theta = rng.normal(size=(4, 3, 3 if d == 3 else 1))
    return size * theta / np.linalg.norm(theta, axis=-1, keepdims=True)


def encoded(encoding: torch.nn.Module, x: np.ndarray, B: torch.Tensor) -> np.ndarray:
    linear, offset = encoding(B)
    assert linear.shape == (len(B), encoding.size, x.shape[-1])
    return (linear @ torch.as_tensor(x)[..., None])[..., 0].numpy() + offset.numpy()


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_that_moves_with_a_bone_keeps_its_local_coordinates(d: int, rng: np.random.Generator) -> None:
    encoding, B = LocalEncoding(torch.as_tensor(C[BE[:, 0], :d])), poses(d, angles(d, 0.9, rng))
    x_rest = rng.normal(size=d)
    for bone in range(3):
        x = np.stack([transform_points(pose[bone].numpy(), x_rest[None])[0] for pose in B])
        local = encoded(encoding, x, B).reshape(4, 3, d)[:, bone]
        np.testing.assert_allclose(local, np.broadcast_to(x_rest - C[bone, :d], (4, d)), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_distances_are_those_from_posed_bones(d: int, rng: np.random.Generator) -> None:
    encoding = DistanceEncoding(torch.as_tensor(C[BE[:, 0], :d]), torch.as_tensor(C[BE[:, 1], :d]))
    B, x = poses(d, angles(d, 0.9, rng)), rng.normal(size=(4, 50, d))
    found = encoding.features(torch.as_tensor(x), B).numpy()
    along = np.linspace(0, 1, 2001)[:, None]
    for p in range(4):
        for bone in range(3):
            ends = transform_points(B[p, bone].numpy(), C[BE[bone], :d])
            places = ends[0] + along * (ends[1] - ends[0])
            distance = np.linalg.norm(x[p, :, None] - places, axis=-1).min(axis=1)
            np.testing.assert_allclose(found[p, :, bone], 0.5 * np.log(distance**2 + SOFT), atol=1e-4)


def test_a_bone_without_length_is_a_point() -> None:
    joint = torch.tensor([[0.5, 0.0]])
    found = DistanceEncoding(joint, joint).features(torch.tensor([[[0.5, 2.0]]]), torch.eye(3)[None, None])
    torch.testing.assert_close(found, torch.log(torch.tensor([[[2.0]]])), atol=1e-3, rtol=0)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [0.0, 1e-7, 1.0, 3.1])
def test_pose_parameters_come_back_from_the_pose(d: int, size: float, rng: np.random.Generator) -> None:
    theta = angles(d, size, rng)
    B = poses(d, theta)
    np.testing.assert_allclose(local_angles(B, torch.as_tensor(P)).numpy(), theta, atol=1e-9)
    x = rng.normal(size=(4, d))
    expected = np.concatenate([x, theta.reshape(4, -1)], axis=1)
    np.testing.assert_allclose(encoded(ParameterEncoding(torch.as_tensor(P), d), x, B), expected, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [np.pi, np.pi - 1e-7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_half_turn_is_the_same_in_both_directions(
    d: int, size: float, dtype: torch.dtype, rng: np.random.Generator
) -> None:
    B = poses(d, angles(d, size, rng)).to(dtype)
    theta = local_angles(B, torch.as_tensor(P)).double().numpy()
    np.testing.assert_allclose(np.linalg.norm(theta, axis=-1), np.pi, atol=2e-3)
    np.testing.assert_allclose(rotation_matrices(theta), local_matrices(B.double().numpy(), d), atol=2e-3)


def local_matrices(B: np.ndarray, d: int) -> np.ndarray:
    R = B[..., :d, :d]
    return np.stack([R[:, b] if P[b] < 0 else np.linalg.inv(R[:, P[b]]) @ R[:, b] for b in range(3)], axis=1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [0.0, 1.0])
def test_pose_parameters_have_derivatives(d: int, size: float, rng: np.random.Generator) -> None:
    B = poses(d, angles(d, size, rng)).requires_grad_()
    assert torch.autograd.gradcheck(lambda B: local_angles(B, torch.as_tensor(P)), B, atol=1e-4)
