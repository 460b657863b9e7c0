import numpy as np
import pytest

from nilbs.geometry.kinematics import (
    bone_order,
    bone_parents,
    forward_kinematics,
    interpolate_poses,
    local_rotations,
    random_rotations,
    smooth_random_rotations,
)
from nilbs.geometry.rotations import (
    interpolate_transforms,
    rigid_transforms,
    rotation_matrices,
    rotation_vectors,
    transform_points,
)

# A trunk (0), a limb of three bones (1, 2, 4) and a limb of one (3); the child 1 comes before its parent 2.
BE = np.array([[0, 1], [2, 3], [1, 2], [1, 4], [3, 5]])
P = np.array([-1, 2, 0, 0, 1])


def joints(d: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(6, d))


def rotations(d: int, n: int, rng: np.random.Generator, *, size: float = 1.0) -> np.ndarray:
    return size * rng.uniform(-1, 1, (n, len(P), 3 if d == 3 else 1))


def climbed(C: np.ndarray, theta: np.ndarray, bone: int, x: np.ndarray) -> np.ndarray:
    """A point of a bone, turned about the bone's first joint and then about its ancestors'."""
    while bone >= 0:
        center = C[BE[bone, 0]]
        x = center + rotation_matrices(theta[bone]) @ (x - center)
        bone = P[bone]
    return x


def test_the_parent_ends_where_the_child_starts() -> None:
    np.testing.assert_array_equal(bone_parents(BE), P)
    np.testing.assert_array_equal(bone_parents([[0, 1]]), [-1])
    np.testing.assert_array_equal(bone_parents([[0, 1], [2, 3]]), [-1, -1])
    assert bone_parents(np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize(
    ("bones", "message"),
    [
        ([[0, 1], [2, 2]], "bone 1 starts and ends at joint 2"),
        ([[0, 2], [1, 2]], "bones 0 and 1 both end at joint 2; a joint has one parent bone"),
        ([[3, 4], [0, 1], [1, 2], [2, 0]], "bones [1, 2, 3] form a cycle; a skeleton is a tree"),
        ([[0, 1, 2]], "BE must be (b, 2) = (1, 2), got (1, 3)"),
    ],
)
def test_wrong_hierarchies_are_refused(bones: list[list[int]], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        bone_parents(bones)
    assert str(caught.value) == message


def test_parents_come_before_children() -> None:
    order = bone_order(P).tolist()
    assert sorted(order) == list(range(len(P)))
    for bone, parent in enumerate(P):
        assert parent < 0 or order.index(parent) < order.index(bone)
    assert bone_order(np.zeros(0)).shape == (0,)
    with pytest.raises(ValueError, match=r"^P\[1\] = 2 does not index the 2 bones$"):
        bone_order([-1, 2])
    with pytest.raises(ValueError, match="cycle"):
        bone_order([0])


@pytest.mark.parametrize("d", [2, 3])
def test_no_rotation_moves_nothing(d: int, rng: np.random.Generator) -> None:
    B = forward_kinematics(joints(d, rng), BE, P, rotations(d, 1, rng)[0] * 0)
    np.testing.assert_array_equal(B, np.broadcast_to(np.eye(d + 1), B.shape))


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_climbs_from_bone_to_bone(d: int, rng: np.random.Generator) -> None:
    C, theta, x = joints(d, rng), rotations(d, 1, rng, size=3.0)[0], rng.normal(size=d)
    B = forward_kinematics(C, BE, P, theta)
    for bone in range(len(P)):
        np.testing.assert_allclose(transform_points(B[bone], x), climbed(C, theta, bone, x), atol=1e-13)


@pytest.mark.parametrize("d", [2, 3])
def test_joints_stay_together_and_the_root_moves_by_its_translation(d: int, rng: np.random.Generator) -> None:
    C, move = joints(d, rng), rng.normal(size=(7, d))
    B = forward_kinematics(C, BE, P, rotations(d, 7, rng), root_translation=move)
    for bone, parent in enumerate(P):
        first = C[BE[bone, 0]]
        expected = first + move if parent < 0 else transform_points(B[:, parent], first)
        np.testing.assert_allclose(transform_points(B[:, bone], first), expected, atol=1e-13)


def test_the_plane_is_a_slice_of_space(rng: np.random.Generator) -> None:
    C, angle, move = joints(2, rng), rotations(2, 3, rng), rng.normal(size=(3, 2))
    B = forward_kinematics(C, BE, P, angle, root_translation=move)
    zeros = np.zeros_like(angle)
    in_space = forward_kinematics(
        np.pad(C, ((0, 0), (0, 1))),
        BE,
        P,
        np.concatenate([zeros, zeros, angle], axis=-1),
        root_translation=np.pad(move, ((0, 0), (0, 1))),
    )
    plane = [0, 1, 3]
    np.testing.assert_allclose(in_space[..., plane, :][..., plane], B, atol=1e-14)
    theta, root = local_rotations(np.pad(C, ((0, 0), (0, 1))), BE, P, in_space)
    np.testing.assert_allclose(theta[..., 2:], angle, atol=1e-12)
    np.testing.assert_allclose(root[..., :2], move, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [0.0, 1e-7, 1.0, (np.pi - 1e-7) / np.sqrt(3)])
def test_rotations_to_transforms_and_back(d: int, size: float, rng: np.random.Generator) -> None:
    C, move = joints(d, rng), rng.normal(size=(4, d))
    theta = rotations(d, 4, rng, size=size)
    theta[0] = size * np.sign(theta[0])  # in space the longest vector of all
    found, root = local_rotations(C, BE, P, forward_kinematics(C, BE, P, theta, root_translation=move))
    np.testing.assert_allclose(found, theta, atol=1e-10)
    np.testing.assert_allclose(root, move, atol=1e-10)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("axes", [1, None])
def test_bones_move_and_grow_with_all_that_hangs_from_them(d: int, axes: int | None, rng: np.random.Generator) -> None:
    C, theta, x = joints(d, rng), rotations(d, 7, rng), rng.normal(size=d)
    move, scale = rng.normal(size=(7, len(P), d)), rng.uniform(0.5, 2, (7, len(P), axes or d))
    root = rng.normal(size=(7, d))
    B = forward_kinematics(C, BE, P, theta, root_translation=root, translation=move, scale=scale)
    for frame in range(7):
        for bone in range(len(P)):
            y, at = x, bone
            while at >= 0:  # T(c + t) R S T(-c), from bone to bone
                center = C[BE[at, 0]]
                y = rotation_matrices(theta[frame, at]) @ (scale[frame, at] * (y - center)) + center + move[frame, at]
                y, at = y + (P[at] < 0) * root[frame], P[at]
            np.testing.assert_allclose(transform_points(B[frame, bone], x), y, atol=1e-12)
    still = forward_kinematics(C, BE, P, theta, translation=np.zeros_like(move), scale=np.ones_like(scale))
    np.testing.assert_allclose(still, forward_kinematics(C, BE, P, theta), atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_a_parent_need_not_end_where_its_child_starts(d: int, rng: np.random.Generator) -> None:
    """Bones without length, and bones apart: only first joints count."""
    C, parents = joints(d, rng), np.array([-1, 0, 1, 1])
    apart = np.array([[0, 0], [2, 1], [3, 3], [4, 0]])
    theta, move = rng.uniform(-1, 1, (3, 4, 3 if d == 3 else 1)), rng.normal(size=(3, d))
    B = forward_kinematics(C, apart, parents, theta, root_translation=move)
    for bone, parent in ((1, 0), (2, 1), (3, 1)):
        first = C[apart[bone, 0]]
        np.testing.assert_allclose(
            transform_points(B[:, bone], first), transform_points(B[:, parent], first), atol=1e-12
        )
    found, root = local_rotations(C, apart, parents, B)
    np.testing.assert_allclose(found, theta, atol=1e-12)
    np.testing.assert_allclose(root, move, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_a_skeleton_of_one_joint_without_size(d: int, rng: np.random.Generator) -> None:
    C, theta = 1e3 + rng.normal(size=(1, d)), rng.uniform(-1, 1, (5, 1, 3 if d == 3 else 1))
    found, root = local_rotations(C, [[0, 0]], [-1], forward_kinematics(C, [[0, 0]], [-1], theta))
    np.testing.assert_allclose(found, theta, atol=1e-12)
    np.testing.assert_allclose(root, 0, atol=1e-9)


def test_deep_skeletons_are_ordered() -> None:
    P = np.arange(-1, 200_000)[::-1].copy()  # the last bone is the root
    P = np.where(P < 0, -1, len(P) - 1 - P)
    np.testing.assert_array_equal(bone_order(P), np.arange(len(P))[::-1])
    P[-1] = 0
    with pytest.raises(ValueError, match="cycle"):
        bone_order(P[:1000] % 1000)


@pytest.mark.parametrize("d", [2, 3])
def test_a_single_bone_that_is_a_root(d: int, rng: np.random.Generator) -> None:
    C, theta = rng.normal(size=(2, d)), rng.normal(size=(1, 3 if d == 3 else 1))
    B = forward_kinematics(C, [[0, 1]], [-1], theta, root_translation=np.ones(d))
    np.testing.assert_allclose(transform_points(B[0], C[0]), C[0] + 1, atol=1e-14)
    np.testing.assert_allclose(local_rotations(C, [[0, 1]], [-1], B)[0], theta, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_no_frames(d: int, rng: np.random.Generator) -> None:
    C = joints(d, rng)
    B = forward_kinematics(C, BE, P, rotations(d, 0, rng), root_translation=np.zeros((0, d)))
    assert B.shape == (0, 5, d + 1, d + 1)
    theta, root = local_rotations(C, BE, P, B)
    assert theta.shape == (0, 5, 3 if d == 3 else 1)
    assert root.shape == (0, d)


@pytest.mark.parametrize("d", [2, 3])
def test_impossible_transforms_are_refused_and_the_bone_is_named(d: int, rng: np.random.Generator) -> None:
    C = joints(d, rng)
    B = forward_kinematics(C, BE, P, rotations(d, 2, rng))
    scaled, mirrored, apart = B.copy(), B.copy(), B.copy()
    scaled[1, 3, :d] *= 1.01
    mirrored[0, 2, :d] *= -1 if d == 3 else [[-1], [1]]
    apart[1, 4, 0, d] += 0.01
    for broken, message in (
        (scaled, "bone 3 is scaled or sheared; local rotations need rigid bones"),
        (mirrored, "bone 2 is scaled or sheared"),
        (apart, "bone 4 comes apart from its parent's joint"),
    ):
        with pytest.raises(ValueError, match=message):
            local_rotations(C, BE, P, broken)


def test_sizes_that_disagree_are_refused() -> None:
    C, bones, theta = np.zeros((3, 2)), [[0, 1], [1, 2]], np.zeros((2, 1))
    with pytest.raises(ValueError, match=r"theta must be \(\.\.\., 2, 1\), got \(2, 3\)"):
        forward_kinematics(C, bones, [-1, 0], np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"^BE\[1\] = \[1, 2\] does not index the 2 joints$"):
        forward_kinematics(C[:2], bones, [-1, 0], theta)
    with pytest.raises(ValueError, match=r"P must be \(b,\) = \(2,\), got \(1,\)"):
        forward_kinematics(C, bones, [-1], theta)
    with pytest.raises(ValueError, match=r"root_translation must be \(\.\.\., 2\), got \(3,\)"):
        forward_kinematics(C, bones, [-1, 0], theta, root_translation=np.zeros(3))
    with pytest.raises(ValueError, match=r"scale must be \(\.\.\., 2, 2\), got \(2, 3\)"):
        forward_kinematics(C, bones, [-1, 0], theta, scale=np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"translation must be \(\.\.\., 2, 2\), got \(1, 2\)"):
        forward_kinematics(C, bones, [-1, 0], theta, translation=np.ones((1, 2)))
    with pytest.raises(ValueError, match=r"^P\[1\] = 7 does not index the 2 bones$"):
        local_rotations(C, bones, [-1, 7], np.stack([np.eye(3)] * 2))
    with pytest.raises(ValueError, match=r"^P\[1\] = 7 does not index the 2 bones$"):
        interpolate_poses(C, bones, [-1, 7], *np.stack([[np.eye(3)] * 2] * 2), 0.5)
    with pytest.raises(ValueError, match=r"^B1 must be \(\.\.\., 2, 3, 3\), got \(1, 3, 3\)$"):
        interpolate_poses(C, bones, [-1, 0], np.stack([np.eye(3)] * 2), np.eye(3)[None], 0.5)


@pytest.mark.parametrize("d", [2, 3])
def test_poses_between_turn_at_constant_speed_and_hold_together(d: int, rng: np.random.Generator) -> None:
    C, move = joints(d, rng), rng.normal(size=(2, d))
    theta = rotations(d, 2, rng)
    B0, B1 = forward_kinematics(C, BE, P, theta, root_translation=move)
    for s in (0.0, 0.25, 1.0):
        found, root = local_rotations(C, BE, P, interpolate_poses(C, BE, P, B0, B1, s))
        np.testing.assert_allclose(root, (1 - s) * move[0] + s * move[1], atol=1e-12)
        for bone in range(len(P)):
            R0, R1, R = (rotation_matrices(angles[bone]) for angles in (*theta, found))
            cosine = [np.clip((np.trace(A.T @ R) - (d - 2)) / 2, -1, 1) for A in (R0, R1)]
            whole = np.arccos(np.clip((np.trace(R0.T @ R1) - (d - 2)) / 2, -1, 1))
            np.testing.assert_allclose(np.arccos(cosine), [s * whole, (1 - s) * whole], atol=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_poses_between_are_local_as_in_loops(d: int, rng: np.random.Generator) -> None:
    """Bones that are turned, stretched and moved from their parents, at several fractions at once."""
    C = joints(d, rng)
    parts = {
        "theta": rotations(d, 8, rng).reshape(2, 4, len(P), -1),
        "translation": rng.normal(size=(2, 4, len(P), d)),
        "scale": rng.uniform(0.5, 2, (2, 4, len(P), d)),
    }
    B0, B1 = (forward_kinematics(C, BE, P, **{name: part[k] for name, part in parts.items()}) for k in (0, 1))
    s = rng.random(4)
    found = interpolate_poses(C, BE, P, B0, B1, s)
    for frame in range(4):
        expected: dict[int, np.ndarray] = {}
        for bone in bone_order(P).tolist():
            theta, move, scale = (
                (1 - s[frame]) * p[0, frame, bone] + s[frame] * p[1, frame, bone] for p in parts.values()
            )
            R0, R1 = (rotation_matrices(parts["theta"][k, frame, bone]) for k in (0, 1))
            if d == 3:
                theta = rotation_vectors(R0 @ rotation_matrices(s[frame] * rotation_vectors(R0.T @ R1)))
            c = C[BE[bone, 0]]
            A = rotation_matrices(theta) @ np.diag(scale)
            local = rigid_transforms(A, c + move - A @ c)
            expected[bone] = local if P[bone] < 0 else expected[P[bone]] @ local
        np.testing.assert_allclose(found[frame], [expected[bone] for bone in range(len(P))], atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_poses_in_single_precision_stay_together(d: int, rng: np.random.Generator) -> None:
    C = joints(d, rng)
    B0, B1 = forward_kinematics(C, BE, P, rotations(d, 2, rng)).astype(np.float32).astype(float)
    B0[:, :d, :d] *= 1 + 3e-6
    B = interpolate_poses(C, BE, P, B0, B1, 0.5)
    below = np.flatnonzero(P >= 0)
    joint = C[BE[below, 0]]
    apart = transform_points(B[below], joint) - transform_points(B[P[below]], joint)
    assert np.abs(apart).max() < 1e-5


@pytest.mark.parametrize("left", [[0, 0, 0], [0, 2, 0.5]])
def test_a_parent_that_shrinks_to_nothing_takes_its_children_along(left: list[float], rng: np.random.Generator) -> None:
    C, scale = joints(3, rng), np.ones((2, len(P), 3))
    scale[1, 0] = left
    B0, B1 = forward_kinematics(C, BE, P, rotations(3, 2, rng), scale=scale)
    np.testing.assert_allclose(interpolate_poses(C, BE, P, B0, B1, 1.0), B1, atol=1e-12)
    assert np.isfinite(interpolate_poses(C, BE, P, B0, B1, 0.5)).all()


@pytest.mark.parametrize("d", [2, 3])
def test_transforms_without_a_hierarchy_go_one_by_one(d: int, rng: np.random.Generator) -> None:
    theta, stretch = 0.3 * rotations(d, 1, rng)[0], np.diag([1.5, 0.5, 2.0][:d])
    t = rng.normal(size=(2, len(P), d))
    B0, B1 = (rigid_transforms(rotation_matrices(k * theta) @ stretch, t[k // 3]) for k in (1, 3))
    half = rigid_transforms(rotation_matrices(2 * theta) @ stretch, t.mean(axis=0))
    np.testing.assert_allclose(interpolate_transforms(B0, B1, 0.5), half, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_random_rotations_have_the_given_spread_and_leave_roots_alone(d: int, rng: np.random.Generator) -> None:
    theta = random_rotations(P, d, 4000, std=0.3, rng=rng)
    assert theta.shape == (4000, len(P), 3 if d == 3 else 1)
    assert (theta[:, 0] == 0).all()
    angle = np.linalg.norm(theta[:, 1:], axis=-1)
    np.testing.assert_allclose(np.sqrt((angle**2).mean(axis=0)), 0.3, rtol=0.05)
    # No direction is preferred.
    np.testing.assert_allclose(theta[:, 1:].mean(axis=0), 0, atol=0.03)
    np.testing.assert_allclose((theta[:, 1:] ** 2).mean(axis=(0, 1)), 0.09 / theta.shape[-1], rtol=0.05)
    assert (random_rotations(P, d, 3, std=0.0, rng=rng) == 0).all()
    with pytest.raises(ValueError, match=r"^std must not be negative, got -1$"):
        random_rotations(P, d, 3, std=-1, rng=rng)


@pytest.mark.parametrize("d", [2, 3])
def test_a_smooth_motion_has_its_amplitude_and_loops(d: int) -> None:
    theta = smooth_random_rotations(P, d, 100, amplitude=0.4, rng=np.random.default_rng(1))
    assert (theta[:, 0] == 0).all()
    rms = np.sqrt((theta[:, 1:] ** 2).sum(axis=-1).mean(axis=0))
    np.testing.assert_allclose(rms, 0.4, atol=1e-12)
    # The fastest wave has four periods: no step, also that back to the start, exceeds its steepest slope.
    step = np.linalg.norm(theta - np.roll(theta, 1, axis=0), axis=-1)[:, 1:]
    assert step.max() < 2 * np.pi * 4 / 100 * 0.4 * np.sqrt(2)
    again = smooth_random_rotations(P, d, 100, amplitude=0.4, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(again, theta)
    # More frames sample the same motion.
    finer = smooth_random_rotations(P, d, 200, amplitude=0.4, rng=np.random.default_rng(1))
    np.testing.assert_allclose(finer[::2], theta, atol=1e-12)


def test_a_motion_of_no_frames_no_amplitude_or_a_negative_one(rng: np.random.Generator) -> None:
    assert smooth_random_rotations(P, 3, 0, amplitude=0.4, rng=rng).shape == (0, 5, 3)
    assert (smooth_random_rotations(P, 3, 4, amplitude=0.0, rng=rng) == 0).all()
    with pytest.raises(ValueError, match=r"^amplitude must not be negative, got -0.1$"):
        smooth_random_rotations(P, 3, 4, amplitude=-0.1, rng=rng)
