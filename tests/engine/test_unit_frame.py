from dataclasses import replace

import numpy as np
import pytest
import torch

from nilbs.engine.unit_frame import UnitFrame, at_rest, root_bone
from nilbs.geometry.rotations import rigid_transforms
from nilbs.geometry.skinning import linear_blend_skinning


def in_unit_frame(c, x: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    frame = UnitFrame(c, torch.as_tensor(B))
    return frame.points(torch.as_tensor(x)).numpy(), frame.B.numpy()


DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


@DIMENSIONS
def test_a_character_in_another_unit_is_the_same_to_the_field(
    d: int, characters, rng: np.random.Generator, rigid
) -> None:
    c, s, shift = characters[d], 250.0, 31.0
    large = replace(c, V=s * c.V + shift, skeleton=replace(c.skeleton, C=s * c.skeleton.C + shift))
    to = rigid_transforms(s * np.eye(d), np.full(d, shift))
    back = np.linalg.inv(to)
    x, B = rng.normal(size=(20, d)), np.stack([rigid(d) for _ in c.skeleton.BE])
    for given, scaled in zip(in_unit_frame(c, x, B), in_unit_frame(large, s * x + shift, to @ B @ back), strict=True):
        np.testing.assert_allclose(scaled, given, atol=1e-10)
    np.testing.assert_allclose(
        in_unit_frame(c, x, B)[1][np.flatnonzero(c.skeleton.P < 0)[0]], np.eye(d + 1), atol=1e-12
    )


@DIMENSIONS
def test_the_body_at_rest_fills_the_unit_cube_along_its_longest_edge(d: int, characters) -> None:
    unit = at_rest(characters[d], characters[d].V)
    extent = unit.max(axis=0) - unit.min(axis=0)
    assert extent.max() == pytest.approx(1)
    np.testing.assert_allclose(unit.max(axis=0), extent / 2, atol=1e-12)
    np.testing.assert_allclose(at_rest(characters[d], characters[d].center[None]), 0, atol=1e-12)


@DIMENSIONS
def test_posing_in_the_unit_frame_is_posing_in_the_world(d: int, characters, rigid) -> None:
    c = characters[d]
    B = np.stack([rigid(d) for _ in c.skeleton.BE])
    x_unit, B_unit = in_unit_frame(c, linear_blend_skinning(c.V, c.W, B), B)
    np.testing.assert_allclose(linear_blend_skinning(at_rest(c, c.V), c.W, B_unit), x_unit, atol=1e-9)


@DIMENSIONS
def test_points_and_poses_in_the_unit_frame_have_derivatives(d: int, characters, rigid, rng) -> None:
    c = characters[d]
    x, B = torch.as_tensor(rng.normal(size=(3, d))), torch.as_tensor(np.stack([rigid(d) for _ in c.skeleton.BE]))

    def unit(x: torch.Tensor, B: torch.Tensor) -> tuple[torch.Tensor, ...]:
        frame = UnitFrame(c, B)
        return frame.points(x), frame.B, frame.points_back(x), frame.turn_back

    assert torch.autograd.gradcheck(unit, (x.requires_grad_(), B.requires_grad_()))


@DIMENSIONS
def test_points_go_to_the_unit_frame_and_back(d: int, characters, rigid, rng) -> None:
    c = characters[d]
    x, B = torch.as_tensor(rng.normal(size=(9, d))), torch.as_tensor(np.stack([rigid(d) for _ in c.skeleton.BE]))
    frame = UnitFrame(c, B)
    torch.testing.assert_close(frame.points_back(frame.points(x)), x)


def test_the_root_is_the_first_bone_without_a_parent(characters) -> None:
    skeleton = characters[2].skeleton
    turned = replace(characters[2], skeleton=replace(skeleton, P=np.array([1, -1, *skeleton.P[2:]])))
    assert root_bone(turned) == 1
    singular = np.repeat(np.eye(3)[None], len(skeleton.BE), axis=0)
    singular[1, :2, :2] = 0
    with pytest.raises(ValueError, match=r"^bone 1 has a singular transform; fields take its inverse$"):
        in_unit_frame(turned, np.zeros((1, 2)), singular)


@DIMENSIONS
def test_bones_that_no_field_can_follow_are_named(d: int, characters) -> None:
    c = characters[d]
    B = np.tile(np.eye(d + 1), (3, len(c.skeleton.BE), 1, 1))
    B[2, 1, :d, :d] = 0
    with pytest.raises(ValueError, match=r"^bone 1 in pose 2 has a singular transform; fields take its inverse$"):
        in_unit_frame(c, np.zeros((3, 1, d)), B)
    B[2, 1] = np.eye(d + 1)
    for offset in (1e39, 2e6 * c.L, np.inf):
        B[1, 2, 0, d] = offset
        with pytest.raises(ValueError, match=r"^bone 2 in pose 1 is moved or stretched by 1e\+06 times"):
            in_unit_frame(c, np.zeros((3, 1, d)), B)
    # Together with the root it may go anywhere.
    B[1, :, 0, d] = 2e6 * c.L
    x, _ = in_unit_frame(c, np.zeros((3, 1, d)), B)
    assert np.isfinite(x).all()
