"""A person's clip on a spider, whose names do not fit, by a map."""

import numpy as np
import pytest

from nilbs.characters.clips import Retargeting, on_skeleton
from nilbs.geometry.kinematics import local_rotations
from nilbs.geometry.reference_pose import reference_pose
from nilbs.geometry.retargeting import followed_bones, guess_bone_map
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints
from nilbs.io.bundle import Clip

from .test_reference_pose import FRAMES, clip, person, rest_poses, with_rest


def spider() -> Skeleton:
    """A spider with eight legs of three joints, whose head points along z and whose back points along y."""
    names, parents, x = ["root", "hips", "thorax", "jaw", "tail"], [-1, 0, 1, 2, 1], [[0.0, 0, 0], [0, 0.5, 0]]
    x += [[0, 0.5, 0.3], [0, 0.5, 0.7], [0, 0.6, -0.6]]
    for side, sign in (("l", 1), ("r", -1)):
        for k, leg in enumerate("abcd"):
            along = 0.25 - 0.15 * k
            names += [f"leg_{leg}_{joint}_{side}" for joint in (1, 2, 3)]
            parents += [2, len(names) - 3, len(names) - 2]
            x += [[sign * out, up, along + 0.4 * along * out] for out, up in ((0.2, 0.5), (0.8, 0.9), (1.4, 0.0))]
    return skeleton_of_joints(x, parents, names)


LEGS = {f"leg_{leg}_{k}_{side[0].lower()}": f"{side}{part}" for side in ("Left", "Right") for leg, k, part in (
    ("a", 1, "Arm"), ("a", 2, "ForeArm"), ("d", 1, "UpLeg"), ("d", 2, "Leg"))}  # fmt: skip
MAPS = {
    "body": {"hips": "Hips", "thorax": "Spine", "jaw": "Head"},
    "body and legs": {"hips": "Hips", "jaw": "Head"} | LEGS,
    "hips and legs": {"hips": "Hips"} | LEGS,
    "legs": LEGS,
    "hips": {"hips": "Hips"},
}
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def person_s_clip(rest: str, rng: np.random.Generator) -> Clip:
    source = person()
    B = clip(source, rng)
    if rest == "z up":
        turn = np.eye(4)
        turn[:3, :3] = Z_UP
        source, B = Skeleton(source.C @ Z_UP.T, source.BE, source.P, source.names), turn @ B @ turn.T
    elif rest != "T":
        source, B = with_rest(source, B, rest_poses(source)[rest])
    return Clip("walk", source, np.arange(FRAMES) / 10, B, "walk.bvh")


@pytest.mark.parametrize("bone_map", MAPS.values(), ids=MAPS)
@pytest.mark.parametrize("rest", ["T", "z up", *rest_poses(person())])
def test_a_spider_follows_by_a_map(rest: str, bone_map: dict[str, str], rng: np.random.Generator) -> None:
    found, target, notes = person_s_clip(rest, rng), spider(), []
    source, B = found.skeleton, found.B
    (moved,) = on_skeleton([found], target, how=Retargeting(bone_map), report=notes.append)
    # The mapped bones turn from the first frame on as those of the clip, in the spider's axes.
    Q = reference_pose(source, B, target, followed_bones(source, target, bone_map)).axes
    for name, led in bone_map.items():
        R, R_source = moved.B[:, target.names.index(name), :3, :3], B[:, source.names.index(led), :3, :3]
        np.testing.assert_allclose(R @ R[0].T, Q @ (R_source @ R_source[0].T) @ Q.T, atol=1e-6)
    # All others keep their rest pose, and a line says so.
    theta = local_rotations(target.C, target.BE, target.P, moved.B)[0]
    still = [bone for bone, name in enumerate(target.names) if name not in bone_map and name != "root"]
    np.testing.assert_allclose(theta[:, still], 0, atol=1e-6)
    lines = [note for note in notes if f"and {len(target.names) - len(bone_map)} keep the rest pose" in note]
    assert len(lines) == 1
    # It stands in the first frame, and walks on the ground to where it looks.
    hips = moved.B[:, target.names.index("hips")]
    assert hips[0, 1, 1] > np.cos(np.radians(15))
    assert hips[:, 1, 1].min() > np.cos(np.radians(45))
    path = np.diff((hips @ [0, 0.5, 0, 1])[[0, -1], :3], axis=0)[0]
    assert path @ hips[0, :3, 2] > np.cos(np.radians(20)) * np.linalg.norm(path)


def test_where_no_name_fits_a_map_is_asked_for() -> None:
    s = spider()
    with pytest.raises(ValueError, match="Give the pairs in a bone map"):
        guess_bone_map(person(), Skeleton(s.C, s.BE, s.P, [f"x{k}" for k in range(len(s.BE))]))
