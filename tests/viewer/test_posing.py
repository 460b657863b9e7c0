import numpy as np
import pytest

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rotation_matrices
from nilbs.viewer.posing import joints, segments, turn_to, turned


@pytest.fixture
def skeleton(characters):
    return lambda d: characters[d].skeleton


@pytest.mark.parametrize("d", [2, 3])
def test_from_rest_it_is_forward_kinematics(skeleton, d, rng):
    s = skeleton(d)
    theta = rng.normal(size=(len(s.BE), 3 if d == 3 else 1))
    rest = np.tile(np.eye(d + 1), (len(s.BE), 1, 1))
    np.testing.assert_allclose(turned(s, rest, theta), forward_kinematics(s.C, s.BE, s.P, theta), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_a_turned_bone_keeps_its_joint_and_takes_its_children_along(models, d):
    s, B = models[d].character.skeleton, models[d].motion[2]
    theta = np.zeros((len(s.BE), 3 if d == 3 else 1))
    bone = int(s.P.max())  # which has a child
    theta[bone, -1] = 0.7
    after = turned(s, B, theta)
    np.testing.assert_allclose(joints(s, after)[bone], joints(s, B)[bone], atol=1e-12)
    below = {bone}
    for b in range(len(s.P)):
        chain = b
        while chain >= 0 and chain != bone:
            chain = s.P[chain]
        below |= {b} if chain == bone else set()
    moved = {b for b in range(len(B)) if np.abs(after[b] - B[b]).max() > 1e-9}
    assert moved == below


def test_no_turn_is_the_same_pose_even_where_bones_are_scaled(skeleton):
    s = skeleton(3)
    B = np.tile(np.diag([2.0, 1, 1, 1]), (len(s.BE), 1, 1))
    assert turned(s, B, np.zeros((len(s.BE), 3))) is B


@pytest.mark.parametrize("d", [2, 3])
def test_a_handle_turns_a_bone_to_where_it_stands(models, d, rng):
    s, B = models[d].character.skeleton, models[d].motion[2]
    theta = 0.3 * rng.normal(size=(len(s.BE), 3 if d == 3 else 1))
    R = rotation_matrices(rng.normal(size=theta.shape[1:]))
    theta[1] = turn_to(turned(s, B, theta), theta, 1, R)
    np.testing.assert_allclose(turned(s, B, theta)[1, :d, :d], R, atol=1e-9)


def test_lines_move_with_their_bones(models):
    s, B = models[3].character.skeleton, models[3].motion[2]
    ends = segments(s, B)
    for k, (one, bone) in enumerate(zip(*s.segments(), strict=True)):
        for e in range(2):
            np.testing.assert_allclose(ends[k, e], (B[bone] @ np.append(s.C[one[e]], 1))[:3], atol=1e-12)
