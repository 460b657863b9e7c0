"""A clip that was made on a skeleton in a T-pose, written with other rest poses, moves a character in the same way."""

import numpy as np
import pytest

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.reference_pose import nearest_rotation, procrustes_distance, reference_pose
from nilbs.geometry.retargeting import followed_bones, guess_bone_map, least_rotation, retarget
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

NAMES = ["Hips", "Spine", "Neck", "Head"]
NAMES += [f"{side}{part}" for side in ("Left", "Right") for part in ("Arm", "ForeArm", "Hand")]
NAMES += [f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Foot")]
PARENTS = np.array([-1, 0, 1, 2, 1, 4, 5, 1, 7, 8, 0, 10, 11, 0, 13, 14])
SAME = {name: name for name in NAMES}
FRAMES = 12


def person(*, arms: float = 0.0, size: float = 1.0, long: float = 1.0) -> Skeleton:
    """A person who faces z with y up, in a T-pose, or with arms that hang by an angle."""
    x = [[0, 1, 0], [0, 1.2, 0], [0, 1.6, 0], [0, 1.7, 0]]
    down = rotation_matrices([0, 0, -arms])
    for side in (1, -1):
        x += [(np.array([0.2, 1.5, 0]) + down @ [0.25 * k * long, 0, 0]) * [side, 1, 1] for k in range(3)]
    for side in (1, -1):
        x += [[0.1 * side, 0.95 - 0.44 * k * long, 0] for k in range(3)]
    return skeleton_of_joints(size * np.array(x), PARENTS, NAMES)


def starts(skeleton: Skeleton) -> np.ndarray:
    return skeleton.C[skeleton.BE[:, 0]]


def clip(skeleton: Skeleton, rng: np.random.Generator, *, t_pose: bool = True) -> np.ndarray:
    """A walk with arms down, the first frame in a T-pose."""
    theta = 0.1 * rng.normal(size=(FRAMES, len(NAMES), 3))
    swing = np.sin(np.linspace(0, 6, FRAMES))
    for side, sign in (("Left", 1), ("Right", -1)):
        theta[:, NAMES.index(f"{side}Arm"), 2] -= 1.2 * sign
        theta[:, NAMES.index(f"{side}UpLeg"), 0] += 0.5 * sign * swing
        theta[:, NAMES.index(f"{side}Leg"), 0] += 0.4
    move = np.stack([0.05 * swing + 0.15, 0.02 * swing, np.linspace(0.1, 0.9, FRAMES)], axis=1)
    if t_pose:
        theta[0] = 0
    return forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=move)


def with_rest(skeleton: Skeleton, B: np.ndarray, pose: np.ndarray) -> tuple[Skeleton, np.ndarray]:
    """The same motion with a pose as the skeleton's rest pose."""
    joints = transform_points(pose, starts(skeleton))
    return skeleton_of_joints(joints, PARENTS, NAMES), B @ np.linalg.inv(pose)


def bones_along(skeleton: Skeleton, axis: int) -> np.ndarray:
    """The pose in which every bone points along an axis."""
    x, R, at = starts(skeleton), np.tile(np.eye(3), (len(NAMES), 1, 1)), np.zeros((len(NAMES), 3))
    for bone, parent in enumerate(PARENTS):
        child = np.flatnonzero(bone == PARENTS)
        R[bone] = least_rotation(x[child[0]] - x[bone], np.eye(3)[axis]) if len(child) else R[parent]
        at[bone] = x[bone] if parent < 0 else at[parent] + R[parent] @ (x[bone] - x[parent])
    return rigid_transforms(R, at - (R @ x[..., None])[..., 0])


def turned(skeleton: Skeleton, **theta: list[float]) -> np.ndarray:
    """The pose in which some bones are turned."""
    turns = np.zeros((1, len(NAMES), 3))
    for name, turn in theta.items():
        turns[0, NAMES.index(name)] = turn
    return forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, turns)[0]


def rest_poses(skeleton: Skeleton) -> dict[str, np.ndarray]:
    return {
        **{f"bones along {'xyz'[axis]}": bones_along(skeleton, axis) for axis in range(3)},
        "A": turned(skeleton, LeftArm=[0, 0, -0.8], RightArm=[0, 0, 0.8]),
        "I": turned(skeleton, LeftArm=[0, 0, -1.5], RightArm=[0, 0, 1.5]),
        "root turned about y": turned(skeleton, Hips=[0, np.pi / 2, 0]),
        "root turned a little about y": turned(skeleton, Hips=[0, 0.6, 0]),
        "root turned about x": turned(skeleton, Hips=[-np.pi / 2, 0, 0]),
    }


@pytest.mark.parametrize("target", [person(), person(arms=0.7, size=3, long=1.2)], ids=["T", "A"])
@pytest.mark.parametrize("name", rest_poses(person()))
def test_the_rest_pose_of_the_file_does_not_matter(name: str, target: Skeleton, rng: np.random.Generator) -> None:
    source = person()
    B = clip(source, rng)
    expected = retarget(source, B, target, SAME)
    other, B_other = with_rest(source, B, rest_poses(source)[name])
    found = retarget(other, B_other, target, SAME)
    np.testing.assert_allclose(
        transform_points(found.B, starts(target)),
        transform_points(expected.B, starts(target)),
        atol=0.01 * np.ptp(target.C),
    )
    assert found.reference.frame == (None if name in ("A", "I") else 0)
    assert expected.reference.frame is None
    assert not found.reference.unlike


def with_end_sites(skeleton: Skeleton) -> Skeleton:
    """The same joints; the bones without length get ends, as in files that hold end sites."""
    ends = np.flatnonzero(skeleton.BE[:, 0] == skeleton.BE[:, 1])
    BE = skeleton.BE.copy()
    BE[ends, 1] = len(skeleton.C) + np.arange(len(ends))
    C = np.concatenate([skeleton.C, skeleton.C[skeleton.BE[ends, 0]] + [0.05, 0.1, 0.02]])
    return Skeleton(C, BE, skeleton.P, skeleton.names)


def below_a_root(skeleton: Skeleton, B: np.ndarray) -> tuple[Skeleton, np.ndarray]:
    """The same below one more joint, on the ground, that never moves."""
    joints = np.concatenate([np.zeros((1, 3)), starts(skeleton)])
    rooted = skeleton_of_joints(joints, np.append(-1, PARENTS + 1), ["Root", *NAMES])
    return rooted, np.concatenate([np.tile(np.eye(4), (len(B), 1, 1, 1)), B], axis=1)


@pytest.mark.parametrize("rooted", [False, True], ids=["", "root"])
@pytest.mark.parametrize("target", [person(), person(arms=0.7, size=3, long=1.2)], ids=["T", "A"])
@pytest.mark.parametrize("rest", ["T", "bones along x", "bones along y", "root turned about x", "A"])
@pytest.mark.parametrize("convention", ["end sites dropped", "hips below a still root"])
def test_other_joints_of_the_file_do_not_matter(
    convention: str, rest: str, target: Skeleton, rooted: bool, rng: np.random.Generator
) -> None:
    source = person()
    B, L = clip(source, rng), np.ptp(target.C, axis=0).max()
    if rooted:
        target, _ = below_a_root(target, B)
    expected = retarget(with_end_sites(source), B, target, SAME).B
    other, B_other = (source, B) if rest == "T" else with_rest(source, B, rest_poses(source)[rest])
    if convention == "hips below a still root":
        other, B_other = below_a_root(other, B_other)
    found = retarget(other, B_other, target, guess_bone_map(other, target)).B
    hips = target.names.index("Hips")
    x, x_expected = (transform_points(moved, starts(target))[:, hips:] for moved in (found, expected))
    path, path_expected = (joints[:, 0] - joints[:1, 0] for joints in (x, x_expected))
    np.testing.assert_allclose(path, path_expected, atol=0.01 * L)
    np.testing.assert_allclose(x[:, 0], x_expected[:, 0], atol=0.01 * L)
    np.testing.assert_allclose(np.ptp(path[:, 2]), 0.8 * retargeted_scale(source, target), rtol=0.1)
    for bone, parent in enumerate(PARENTS):
        if parent >= 0:
            a, b = (joints[:, bone] - joints[:, parent] for joints in (x, x_expected))
            cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
            assert cosine.min() > np.cos(np.radians(1))


def retargeted_scale(source: Skeleton, target: Skeleton) -> float:
    """The length of a leg of the target over that of the source."""
    legs = [
        np.linalg.norm(np.diff(starts(s)[[s.names.index(n) for n in ("LeftUpLeg", "LeftFoot")]], axis=0))
        for s in (target, source)
    ]
    return float(legs[0] / legs[1])


def test_axes_and_sizes_do_not_matter(rng: np.random.Generator) -> None:
    source, target = person(), person(arms=0.7)
    B = clip(source, rng)
    expected = retarget(source, B, target, SAME).B
    up = rigid_transforms(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), [0, 0, 0])
    # Bones along x in a world whose z is up, a hundred times as large.
    rested, B = with_rest(source, B, bones_along(source, 0))
    large = Skeleton(100 * rested.C @ up[:3, :3].T, rested.BE, rested.P, rested.names)
    B = up @ B @ up.T
    B[..., :3, 3] *= 100
    found = retarget(large, B, target, SAME)
    np.testing.assert_allclose(found.B, expected, atol=1e-9)
    np.testing.assert_array_equal(found.reference.axes, up[:3, :3].T)


def test_without_a_t_pose_the_frame_that_is_most_alike_keeps_the_body_upright(rng: np.random.Generator) -> None:
    source, target = person(), person(arms=0.7)
    B = clip(source, rng, t_pose=False)
    other, B_other = with_rest(source, B, bones_along(source, 0))
    found = retarget(other, B_other, target, SAME)
    assert found.reference.frame is not None
    x, x_source = transform_points(found.B, starts(target)), transform_points(B, starts(source))
    for bone, parent in ((5, 4), (6, 5), (8, 7), (9, 8), (11, 10), (12, 11), (14, 13), (15, 14)):
        a, b = x[:, bone] - x[:, parent], x_source[:, bone] - x_source[:, parent]
        cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        assert cosine.min() > 1 - 1e-9  # limbs point as in the file
    rises = x[:, NAMES.index("Head")] - x[:, 0]
    rises_source = x_source[:, NAMES.index("Head")] - x_source[:, 0]
    cosine = (rises * rises_source).sum(axis=1) / np.linalg.norm(rises, axis=1) / np.linalg.norm(rises_source, axis=1)
    assert cosine.min() > np.cos(np.radians(20))


@pytest.mark.parametrize("name", ["bones along x", "root turned about y"])
def test_a_t_pose_that_looks_elsewhere_keeps_where_it_looks(name: str, rng: np.random.Generator) -> None:
    source = person()
    turn = rotation_matrices([0, 0.9, 0])
    B = rigid_transforms(turn, [0, 0, 0]) @ clip(source, rng)
    other, B_other = with_rest(source, B, rest_poses(source)[name])
    found = retarget(other, B_other, person(), SAME)
    assert found.reference.frame == 0
    x, x_source = (transform_points(moved, starts(source)) for moved in (found.B, B))
    np.testing.assert_allclose(x - x[:, :1], x_source - x_source[:, :1], atol=1e-9)


def test_a_body_that_lies_at_rest_and_walks_is_upright(rng: np.random.Generator) -> None:
    source, target = person(), person(arms=0.7)
    B = clip(source, rng, t_pose=False)
    other, B_other = with_rest(source, B, rest_poses(source)["root turned about x"])
    found = retarget(other, B_other, target, SAME)
    x, expected = (transform_points(moved, starts(target)) for moved in (found.B, retarget(source, B, target, SAME).B))
    assert found.reference.frame is None
    np.testing.assert_allclose(x - x[:, :1], expected - expected[:, :1], atol=1e-9)


def test_a_frame_and_axes_can_be_named(rng: np.random.Generator) -> None:
    source, target = person(), person(arms=0.7)
    B = clip(source, rng)
    expected = retarget(source, B, target, SAME).B
    B = np.concatenate([B[1:], B[:1]])  # the T-pose comes last
    other, B_other = with_rest(source, B, bones_along(source, 1))
    follows = followed_bones(other, target, SAME)
    named = reference_pose(other, B_other, target, follows, rest_frame=FRAMES - 1)
    found = retarget(other, B_other, target, SAME, reference=named).B
    np.testing.assert_allclose(found, np.concatenate([expected[1:], expected[:1]]), atol=1e-9)
    assert reference_pose(other, B_other, target, follows, rest_frame=-1).frame is None
    axes = reference_pose(source, B, target, follows, up="x", forward="-z").axes
    np.testing.assert_array_equal(axes @ [1, 0, 0], [0, 1, 0])
    np.testing.assert_array_equal(axes @ [0, 0, -1], [0, 0, 1])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rest_frame": FRAMES}, "0 to 11"),
        ({"rest_frame": -2}, "got -2"),
        ({"up": "w"}, "'w'"),
        ({"up": "y", "forward": "-y"}, "perpendicular"),
    ],
)
def test_what_is_named_must_exist(wrong: dict, message: str, rng: np.random.Generator) -> None:
    source = person()
    with pytest.raises(ValueError, match=message):
        reference_pose(source, clip(source, rng), source, np.arange(len(NAMES)), **wrong)


def test_axes_are_of_motions_in_space() -> None:
    flat = skeleton_of_joints([[0, 0], [1, 0], [1, 1]], [-1, 0, 1], ["a", "b", "c"])
    with pytest.raises(ValueError, match="flat"):
        reference_pose(flat, np.tile(np.eye(3), (1, 3, 1, 1)), flat, np.arange(3), up="y")


def test_a_motion_that_is_unlike_in_all_frames_is_reported(rng: np.random.Generator) -> None:
    source, target = person(), person()
    other, _ = with_rest(source, clip(source, rng), bones_along(source, 0))
    still = np.tile(np.eye(4), (3, len(NAMES), 1, 1))
    reference = reference_pose(other, still, target, np.arange(len(NAMES)))
    assert reference.unlike
    assert reference.frame is None


@pytest.mark.parametrize("d", [2, 3])
def test_shapes_are_compared_up_to_similarity(d: int, rng: np.random.Generator) -> None:
    x, R = rng.normal(size=(9, d)), rotation_matrices(rng.normal(size=1 if d == 2 else 3))
    np.testing.assert_allclose(nearest_rotation(x, 3 * x @ R.T + 7), R, atol=1e-12)
    assert procrustes_distance(3 * x @ R.T + 7, x) < 1e-7
    assert procrustes_distance(rng.normal(size=(9, d)), x) > 0.2
