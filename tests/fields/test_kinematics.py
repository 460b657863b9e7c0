import numpy as np
import pytest
import torch

from nilbs.fields.kinematics import forward_kinematics
from nilbs.geometry import kinematics

BE = np.array([[0, 1], [1, 2], [1, 3], [4, 0]])
P = np.array([3, 0, 0, -1])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, 3.0])
def test_the_same_transforms_as_on_arrays(d: int, angle: float, rng: np.random.Generator) -> None:
    C, theta = rng.normal(size=(5, d)), angle * rng.uniform(-1, 1, (4, 1 if d == 2 else 3))
    B = forward_kinematics(torch.as_tensor(C), BE, P, torch.as_tensor(theta))
    np.testing.assert_allclose(B, kinematics.forward_kinematics(C, BE, P, theta), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 1.0])
def test_derivatives_by_the_angles(d: int, angle: float, rng: np.random.Generator) -> None:
    C = torch.as_tensor(rng.normal(size=(5, d)))
    theta = torch.as_tensor(angle * rng.uniform(-1, 1, (4, 1 if d == 2 else 3)), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda t: forward_kinematics(C, BE, P, t), theta.requires_grad_())


def test_angles_of_another_dimension_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^theta must be \(b, 1\) for 4 bones, got \(4, 3\)$"):
        forward_kinematics(torch.zeros((5, 2)), BE, P, torch.zeros((4, 3)))
