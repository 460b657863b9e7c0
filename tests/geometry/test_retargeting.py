import numpy as np
import pytest

from nilbs.geometry.kinematics import forward_kinematics, local_rotations
from nilbs.geometry.reference_pose import quarter_turns_between
from nilbs.geometry.retargeting import (
    guess_bone_map,
    least_rotation,
    retarget,
)
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

NAMES = ["hips", "spine", "head"] + [f"{part}.{side}" for side in "LR" for part in ("arm", "fore", "hand")]
NAMES += [f"{part}.{side}" for side in "LR" for part in ("thigh", "shin", "foot", "toe")]
PARENTS = np.array([-1, 0, 1, 1, 3, 4, 1, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15])
SAME = {name: name for name in NAMES}


def person(*, arms: float = 0.0, legs: float = 0.0, size: float = 1.0, long: float = 1.0) -> Skeleton:
    """A person who faces +z with y up; arms hang by an angle and legs stand apart by one, in radians."""
    down, apart = rotation_matrices([0, 0, -arms]), rotation_matrices([0, 0, legs])
    shoulder, hip = np.array([0.2, 0.5, 0]), np.array([0.1, 0, 0])
    x = [np.zeros(3), np.array([0, 0.2, 0]), np.array([0, 0.6, 0])]
    for side in (1, -1):
        x += [(shoulder + down @ [length * long, 0, 0]) * [side, 1, 1] for length in (0, 0.3, 0.6)]
    for side in (1, -1):
        leg = [hip + apart @ [0, -length * long, 0] for length in (0, 0.45, 0.9)]
        x += [joint * [side, 1, 1] for joint in (*leg, leg[-1] + np.array([0, -0.05, 0.15]))]
    return skeleton_of_joints(size * np.array(x), PARENTS, NAMES)


def moved(skeleton: Skeleton, rng: np.random.Generator, frames: int = 5) -> np.ndarray:
    theta = rng.uniform(-1, 1, (frames, len(skeleton.BE), 3 if skeleton.d == 3 else 1))
    move = 0.1 * rng.normal(size=(frames, skeleton.d))
    return forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=move)


def posed(skeleton: Skeleton, B: np.ndarray) -> np.ndarray:
    """First joints of all bones."""
    return transform_points(B, skeleton.C[skeleton.BE[:, 0]])


def directions(skeleton: Skeleton, B: np.ndarray, *, of: str) -> np.ndarray:
    """Directions of the named bones in a pose: arms to hands, thighs to feet."""
    ends = {"arm": ("fore", "hand"), "leg": ("shin", "foot")}[of]
    first = {"arm": "arm", "leg": "thigh"}[of]
    x, found = posed(skeleton, B), []
    for side in "LR":
        at = [skeleton.names.index(f"{part}.{side}") for part in (first, *ends)]
        way = np.diff(x[..., at, :], axis=-2)
        found.append(way / np.linalg.norm(way, axis=-1, keepdims=True))
    return np.stack(found)


def test_a_skeleton_that_follows_itself_moves_as_before(rng: np.random.Generator) -> None:
    skeleton = person(arms=0.7, legs=0.2)
    B = moved(skeleton, rng)
    found = retarget(skeleton, B, skeleton, SAME)
    np.testing.assert_allclose(found.B, B, atol=1e-12)
    assert found.scale == pytest.approx(1)
    assert (found.reference.axes == np.eye(3)).all()
    assert not found.from_first.any()


@pytest.mark.parametrize("d", [2, 3])
def test_any_tree_that_follows_itself_moves_as_before(d: int, rng: np.random.Generator) -> None:
    parents = np.array([-1, 0, 1, 1, 0, 4, 5])
    skeleton = skeleton_of_joints(rng.normal(size=(7, d)), parents, [f"b{i}" for i in range(7)])
    B = moved(skeleton, rng)
    found = retarget(skeleton, B, skeleton, {name: name for name in skeleton.names})
    np.testing.assert_allclose(found.B, B, atol=1e-11)


def test_arms_of_a_t_pose_clip_hang_on_an_a_pose_rig_as_in_the_clip() -> None:
    """The clip lets arms hang by 1.2 rad from a T; the rig's hang by 0.8 at rest: they turn by 0.4 more, not by 1.2."""
    source, target = person(), person(arms=0.8)
    theta = np.zeros((2, len(NAMES), 3))
    theta[1, NAMES.index("arm.L")] = [0, 0, -1.2]
    theta[1, NAMES.index("arm.R")] = [0, 0, 1.2]
    B = forward_kinematics(source.C, source.BE, source.P, theta)
    found = retarget(source, B, target, SAME)
    turned, _ = local_rotations(target.C, target.BE, target.P, found.B)
    expected = np.zeros_like(theta)
    # In the clip's rest pose the rig stands in a T too.
    expected[:, NAMES.index("arm.L"), 2] = [0.8, -0.4]
    expected[:, NAMES.index("arm.R"), 2] = [-0.8, 0.4]
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    np.testing.assert_allclose(
        posed(target, found.B[0]), posed(source, np.broadcast_to(np.eye(4), (17, 4, 4))), atol=1e-12
    )


def test_limbs_point_where_those_of_the_source_point(rng: np.random.Generator) -> None:
    source, target = person(legs=0.1), person(arms=0.8, legs=0.3, size=2, long=1.2)
    B = moved(source, rng)
    found = retarget(source, B, target, SAME)
    for of in ("arm", "leg"):
        np.testing.assert_allclose(directions(target, found.B, of=of), directions(source, B, of=of), atol=1e-12)
    # Torso, head and feet turn as those of the source: that legs stand apart does not tilt the soles.
    for name in ("hips", "spine", "head", "foot.L", "toe.R"):
        bone = NAMES.index(name)
        np.testing.assert_allclose(found.B[:, bone, :3, :3], B[:, bone, :3, :3], atol=1e-12)
    # And joints stay together.
    local_rotations(target.C, target.BE, target.P, found.B)


def test_elbows_that_are_bent_at_rest_are_straightened_without_twist() -> None:
    source = person()
    target = person(arms=0.8)
    C, elbow = target.C.copy(), NAMES.index("fore.L")
    # The forearm comes forward about the elbow's hinge, which lies across the upper arm.
    hinge = rotation_matrices([0, 0, -0.8]) @ [0, -1, 0]
    hand = NAMES.index("hand.L")
    C[hand] = C[elbow] + rotation_matrices(0.9 * hinge) @ (C[hand] - C[elbow])
    bent = Skeleton(C, target.BE, target.P, target.names)
    rest = np.broadcast_to(np.eye(4), (1, 17, 4, 4))
    theta, _ = local_rotations(bent.C, bent.BE, bent.P, retarget(source, rest, bent, SAME).B)
    np.testing.assert_allclose(theta[0, elbow], -0.9 * hinge, atol=1e-12)
    np.testing.assert_allclose(theta[0, hand], 0, atol=1e-12)


def test_larger_bodies_move_farther(rng: np.random.Generator) -> None:
    source, target = person(), person(size=3)
    theta = np.zeros((4, len(NAMES), 3))
    move = np.array([[0, 0, 0], [0, 0.01, 0.5], [0, -0.02, 1.0], [0.1, 0, 7.0]])
    B = forward_kinematics(source.C, source.BE, source.P, theta, root_translation=move)
    found = retarget(source, B, target, SAME)
    assert found.scale == pytest.approx(3)
    np.testing.assert_allclose(found.B, rigid_transforms(np.eye(3), 3 * move[:, None] * np.ones((17, 1))), atol=1e-12)


def test_z_up_to_y_up(rng: np.random.Generator) -> None:
    target = person(arms=0.8)
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up, facing z, to z up, facing -y
    source = Skeleton(target.C @ up.T, target.BE, target.P, target.names)
    B = moved(target, rng)
    turned = rigid_transforms(up, [0, 0, 0]) @ B @ rigid_transforms(up.T, [0, 0, 0])
    found = retarget(source, turned, target, SAME)
    assert (found.reference.axes == up.T).all()
    np.testing.assert_allclose(found.B, B, atol=1e-12)


def test_chains_share_what_one_bone_does(rng: np.random.Generator) -> None:
    source = skeleton_of_joints([[0, 0, 0], [2, 0, 0], [4, 0, 0]], [-1, 0, 1], ["upper", "lower", "hand"])
    joints = [[0, 0, 0], [1, 0.2, 0], [2, 0, 0], [3, -0.1, 0.3], [4, 0, 0]]
    target = skeleton_of_joints(joints, np.arange(5) - 1, ["upper1", "upper2", "lower1", "twist", "hand"])
    B = moved(source, rng)
    follows = {"upper1": "upper", "upper2": "upper", "lower1": "lower", "hand": "hand"}
    found = retarget(source, B, target, follows).B
    # The whole chain has the source's direction, not its first bone: here they agree at rest.
    for bone, led in ((0, 0), (1, 0), (2, 1), (3, 1), (4, 2)):  # a bone without a partner follows its parent
        np.testing.assert_allclose(found[:, bone, :3, :3], B[:, led, :3, :3], atol=1e-12)
    np.testing.assert_allclose(posed(target, found)[:, [0, 2, 4]], posed(source, B), atol=1e-12)


def test_chains_are_aligned_as_one() -> None:
    source = skeleton_of_joints([[0, 0], [2, 0], [4, 0]], np.arange(3) - 1, ["upper", "lower", "hand"])
    joints = [[0, 0], [0.1, -1], [0, -2], [0, -4]]
    target = skeleton_of_joints(joints, np.arange(4) - 1, ["upper1", "upper2", "lower", "hand"])
    # A second arm points the other way, so that no turn of the whole helps.
    both = [
        Skeleton(
            np.concatenate([s.C, s.C * [-1, 1]]),
            np.concatenate([s.BE, s.BE + len(s.C)]),
            np.concatenate([s.P, np.where(s.P < 0, -1, s.P + len(s.P))]),
            (*s.names, *(f"{name}'" for name in s.names)),
        )
        for s in (source, target)
    ]
    follows = {"upper1": "upper", "upper2": "upper", "lower": "lower", "hand": "hand"}
    follows |= {f"{name}'": f"{led}'" for name, led in follows.items()}
    found = retarget(both[0], np.broadcast_to(np.eye(3), (1, 6, 3, 3)), both[1], follows)
    assert (found.reference.axes == np.eye(2)).all()
    up = rotation_matrices([np.pi / 2])
    np.testing.assert_allclose(found.B[0, :4, :2, :2], np.tile(up, (4, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(found.B[0, 4:, :2, :2], np.tile(up.T, (4, 1, 1)), atol=1e-12)


def test_a_back_is_not_bent_like_that_of_the_source(rng: np.random.Generator) -> None:
    """Rigs have the joints of the back in different places, and limbs do not continue the back."""
    source, target = person(), person()
    C = target.C.copy()
    C[NAMES.index("spine"), 2] -= 0.1
    crooked = Skeleton(C, target.BE, target.P, target.names)
    B = moved(source, rng)
    found = retarget(source, B, crooked, SAME).B
    for bone in range(len(NAMES)):
        np.testing.assert_allclose(found[:, bone, :3, :3], B[:, bone, :3, :3], atol=1e-12)


def test_short_bones_keep_their_direction_relative_to_the_bone_above(rng: np.random.Generator) -> None:
    names = ["upper", "lower", "finger1", "finger2"]
    source = skeleton_of_joints([[0, 0], [2, 0], [4, 0], [4.3, 0]], np.arange(4) - 1, names)
    target = skeleton_of_joints([[0, 0], [2, 0], [4, 0], [4.2, 0.2]], np.arange(4) - 1, names)
    B = moved(source, rng)
    found = retarget(source, B, target, {name: name for name in names}).B
    np.testing.assert_allclose(found[..., :2, :2], B[..., :2, :2], atol=1e-12)


def test_bones_above_all_mapped_ones_turn_along(rng: np.random.Generator) -> None:
    source = person()
    target = Skeleton(
        np.concatenate([source.C, [[0, -1, 0]]]),
        np.concatenate([source.BE, [[17, 0]]]),
        np.concatenate([np.where(source.P < 0, 17, source.P), [-1]]),
        (*source.names, "ground"),
    )
    B = moved(source, rng)
    found = retarget(source, B, target, SAME).B
    np.testing.assert_allclose(found[:, :17], B, atol=1e-12)
    np.testing.assert_allclose(found[:, 17], B[:, 0], atol=1e-12)


@pytest.mark.parametrize("at", [[0, 5.0, 0], [7.0, 0, -9.0]])
def test_a_start_far_from_rest_is_removed(at: list[float]) -> None:
    skeleton = person(arms=0.8)
    theta = np.zeros((3, len(NAMES), 3))
    steps = np.array([[0, 0, 0], [0, 0.01, 0.3], [0, 0, 0.6]])
    B = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=steps + at)
    found = retarget(skeleton, B, skeleton, SAME)
    assert found.from_first.tolist() == (np.abs(at) > 0).tolist()
    np.testing.assert_allclose(found.B[:, 0, :3, 3], steps, atol=1e-12)


def test_feet_that_start_far_from_rest_are_put_on_the_ground() -> None:
    skeleton = person()
    theta = np.zeros((1, len(NAMES), 3))
    for side in "LR":  # sitting on a chair: the root is lower than at rest
        theta[0, NAMES.index(f"thigh.{side}")] = [-np.pi / 2, 0, 0]
        theta[0, NAMES.index(f"shin.{side}")] = [np.pi / 2, 0, 0]
    B = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=np.array([0, -9.0, 0]))
    found = retarget(skeleton, B, skeleton, SAME).B
    assert posed(skeleton, found)[0, :, 1].min() == pytest.approx(skeleton.C[:, 1].min())
    assert found[0, 0, 1, 3] == pytest.approx(-0.45)


def test_scales_of_the_source_are_left_out(rng: np.random.Generator) -> None:
    skeleton = person()
    theta, scale = rng.uniform(-1, 1, (2, 17, 3)), np.ones((2, 17, 1))
    scale[:, NAMES.index("head")] = 2.0
    B = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, scale=scale)
    found = retarget(skeleton, B, skeleton, SAME).B
    np.testing.assert_allclose(found, forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta), atol=1e-12)


def test_one_bone_and_no_frame(rng: np.random.Generator) -> None:
    source = Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ("a",))
    target = Skeleton([[5, 5]], [[0, 0]], [-1], ("b",))  # without length
    B = moved(source, rng)
    found = retarget(source, B, target, {"b": "a"})
    assert found.scale == 1
    np.testing.assert_allclose(found.B[..., :2, :2], B[..., :2, :2], atol=1e-12)
    np.testing.assert_allclose(posed(target, found.B) - [5, 5], posed(source, B), atol=1e-12)
    assert retarget(source, B[:0], target, {"b": "a"}).B.shape == (0, 1, 3, 3)


def test_wrong_bone_maps_are_refused() -> None:
    flat, solid = Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ("a",)), person()
    rest = np.broadcast_to(np.eye(4), (1, 17, 4, 4))
    for bone_map, message in (
        ({"tail": "hips"}, "the bone map names 'tail', but the character has no such bone"),
        ({"hips": "tail"}, "lets 'hips' follow 'tail', but the motion has no such bone"),
        ({"hips": None}, "no bone of the character follows a bone of the motion"),
        ({}, "no bone of the character follows a bone of the motion"),
    ):
        with pytest.raises(ValueError, match=message):
            retarget(solid, rest, solid, bone_map)
    with pytest.raises(ValueError, match="the motion has 3 dimensions, but the skeleton that is to follow it has 2"):
        retarget(solid, rest, flat, {"a": "hips"})
    with pytest.raises(ValueError, match=r"B must be \(t, 17, d\+1, d\+1\)"):
        retarget(solid, rest[:, :3], solid, SAME)


@pytest.mark.parametrize("d", [2, 3])
def test_the_least_rotation_turns_in_the_plane_of_both(d: int, rng: np.random.Generator) -> None:
    for _ in range(5):
        u, v = rng.normal(size=(2, d))
        R = least_rotation(u, v)
        np.testing.assert_allclose(R @ R.T, np.eye(d), atol=1e-14)
        np.testing.assert_allclose(R @ u / np.linalg.norm(u), v / np.linalg.norm(v), atol=1e-14)
        cosine = u @ v / np.linalg.norm(u) / np.linalg.norm(v)
        assert np.trace(R) == pytest.approx(2 * cosine + d - 2)
        np.testing.assert_allclose(least_rotation(u, 3 * u), np.eye(d), atol=1e-14)
        opposite = least_rotation(u, -u)
        assert np.linalg.det(opposite) == pytest.approx(1)
        np.testing.assert_allclose(opposite @ u, -u, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_quarter_turns_are_found_again(d: int, rng: np.random.Generator) -> None:
    x = rng.normal(size=(9, d))
    seen = set()
    for angles in np.ndindex(*(4,) * (1 if d == 2 else 3)):
        R = np.eye(d)
        for axis, angle in enumerate(angles):
            theta = [np.pi / 2 * angle] if d == 2 else np.pi / 2 * angle * np.eye(3)[axis]
            R = R @ rotation_matrices(theta).round()
        found = quarter_turns_between(x, 5 * x @ R.T + 7 + 0.1 * rng.normal(size=(9, d)))
        np.testing.assert_array_equal(found, R)
        seen.add(found.tobytes())
    assert len(seen) == (4 if d == 2 else 24)


def test_of_equally_good_turns_the_least_is_taken() -> None:
    assert (quarter_turns_between([[1, 2, 3]], [[4, 5, 6]]) == np.eye(3)).all()
    # Points on a line do not determine a turn about it.
    line = np.arange(3)[:, None] * [0, 0, 1]
    assert (quarter_turns_between(line, line) == np.eye(3)).all()


def test_a_map_is_found_by_names_places_and_hierarchy() -> None:
    source, target = person(), person(arms=0.8, size=3)
    words = {"arm": "UpArm", "fore": "LoArm", "thigh": "UpLeg", "shin": "LoLeg"}
    renamed = [name.split(".") for name in NAMES]
    names = [f"{words.get(part[0], part[0].title())}{'_' + part[1] if len(part) > 1 else ''}" for part in renamed]
    source = Skeleton(source.C, source.BE, source.P, names)
    target = Skeleton(target.C, target.BE, target.P, [name.replace("fore", "forearm") for name in NAMES])
    assert guess_bone_map(source, target) == dict(zip(target.names, names, strict=True))


def test_bones_of_like_names_at_other_places_do_not_match() -> None:
    place = np.array([0, 1, 2, 3])[:, None] * [1, 0]
    source = skeleton_of_joints(place, np.arange(4) - 1, ["Hips", "Spine", "Neck", "Jaw"])
    place = np.array([0, 0.5, 1.2, 2.2])[:, None] * [1, 0]
    target = skeleton_of_joints(place, np.arange(4) - 1, ["hips", "jaw", "spine", "neck"])
    assert guess_bone_map(source, target) == {"hips": "Hips", "spine": "Spine", "neck": "Neck"}
    assert guess_bone_map(target, source) == {"Hips": "hips", "Spine": "spine", "Neck": "neck"}
    assert guess_bone_map(source, skeleton_of_joints([[0, 0]], [-1], ["jaw"])) == {"jaw": "Jaw"}


def test_a_hierarchy_upside_down_does_not_match() -> None:
    joints = [[0, 0], [1, 0], [1.1, 0], [2, 0]]
    source = skeleton_of_joints(joints, np.arange(4) - 1, ["Hips", "Neck", "Spine", "Head"])
    target = skeleton_of_joints(joints, np.arange(4) - 1, ["hips", "spine", "neck", "head"])
    assert guess_bone_map(source, target) == {"hips": "Hips", "spine": "Spine", "head": "Head"}


def test_without_like_names_the_error_shows_a_bone_map() -> None:
    source = skeleton_of_joints(np.eye(6, 3), np.arange(6) - 1, [f"joint{i}" for i in range(6)])
    with pytest.raises(ValueError) as caught:
        guess_bone_map(source, person())
    assert "joint0, joint1, joint2, joint3, joint4 and 1 more" in str(caught.value)
    assert '{"hips": "joint0"}' in str(caught.value)
