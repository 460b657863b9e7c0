import numpy as np
import pytest

from nilbs.geometry.rig_diagnosis import coincident_joints, frame_suggestion, rig_report
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
F = np.array([triangle for a, b, c, e in SIDES for triangle in ([a, b, c], [a, c, e])])
V = CUBE * [1, 4, 2] + [2, 0, 1]  # a box 4 high, away from the origin
C = np.array([[2.5, 0.5, 1.5], [2.4, 2, 2], [2.5, 3.5, 1.2], [2.6, 3.7, 2.8]])
OUTLINE, EDGES = np.array([[0.0, 0], [4, 0], [4, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


def rig(C, BE, P):
    return Skeleton(C, BE, P, tuple(f"bone{b}" for b in range(len(BE))))


def test_a_rig_that_fits():
    report = rig_report(V, F, rig(C, [[0, 1], [1, 2], [1, 3]], [-1, 0, 0]))
    assert report.outside.tolist() == []
    assert report.without_volume.tolist() == []
    assert report.suggestion is None


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_what_is_wrong_with_a_rig(scale):
    joints = [
        [2.5, 1, 2],
        [2.5, 2, 2],
        [2.5, 2 + 1e-9, 2],
        [2.5, 9, 2],
        [9, 9, 9],
        [9, 9, 8],
        [1.5, 3, 2],
        [3.5, 3, 2],
        [7, 7, 7],
    ]
    BE = [[0, 1], [1, 2], [2, 3], [4, 5], [4, 4], [6, 7]]
    report = rig_report(V * scale, F, rig(np.array(joints) * scale, BE, [-1, 0, 1, -1, 3, -1]))
    assert report.outside.tolist() == [3, 4, 5, 6, 7]
    assert report.without_volume.tolist() == [3, 4]  # the last bone runs through, from outside to outside


def test_a_rig_in_the_plane():
    report = rig_report(OUTLINE, EDGES, rig(np.array([[1, 0.5], [3, 0.5], [9, 0.5]]), [[0, 1], [1, 2]], [-1, 0]))
    assert report.outside.tolist() == [2]
    assert report.suggestion is None


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_coincident_joints(scale):
    # Bones of joints: the last two start where the second does.
    joints = np.concatenate([C, C[1:2] + 1e-8, C[1:2]]) * scale
    assert coincident_joints(skeleton_of_joints(joints[:4], [-1, 0, 1, 1], "abcd")).tolist() == []
    assert coincident_joints(skeleton_of_joints(joints, [-1, 0, 1, 1, 1, 0], "abcdef")).tolist() == [4, 5]
    # Bones with two joints each: every child starts at a joint of its own where its parent ends.
    ends = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0, 0], [1, 1, 0]]) * scale
    assert coincident_joints(rig(ends, [[0, 1], [2, 3], [4, 5]], [-1, 0, 0])).tolist() == []
    assert coincident_joints(rig(ends, [[0, 1], [2, 3], [4, 5]], [-1, 0, -1])).tolist() == [4]


@pytest.mark.parametrize("factor", [100, 0.01, 10, 1000, 2.54, 0.3048])
def test_another_unit_is_named(factor):
    suggestion = frame_suggestion(V, F, C / factor)
    by = f"times {factor:.6g}" if factor > 1 else f"divided by {1 / factor:.6g}"
    assert suggestion is not None
    assert suggestion.startswith("the rig is in another unit: with its joints ")
    if factor in (100, 0.01):
        assert (
            suggestion == f"the rig is in another unit: with its joints {by}, 4 of 4 lie inside the mesh instead of 0"
        )
    # The suggestion is true.
    word = suggestion.split("joints ")[1].split(",")[0]
    stated = float(word.split()[-1]) if word.startswith("times") else 1 / float(word.split()[-1])
    assert stated == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize("factor", [1, 100])
def test_another_up_axis_is_named(factor):
    # The rig's z is up: its (x, y, z) are the mesh's (x, -z, y).
    joints = np.stack([C[:, 0], -C[:, 2], C[:, 1]], axis=1) / factor
    suggestion = frame_suggestion(V, F, joints)
    start = "the rig is in another frame: with (x, y, z) of its joints taken as (x, z, -y)"
    assert suggestion == start + " and times 100" * (factor == 100) + ", 4 of 4 lie inside the mesh instead of 0"


def test_a_small_rig_that_lies_inside_is_in_doubt():
    around = CUBE * 4 - 2
    suggestion = frame_suggestion(around, F, (C - [2.5, 2, 2]) / 100)
    assert (
        suggestion == "the rig is in another unit: with its joints times 100, 4 of 4 lie inside the mesh instead of 4"
    )
    assert frame_suggestion(around, F, (C[:2] - [2.5, 2, 2]) / 100) is None  # one short bone is none too small


def test_a_factor_between_no_two_units():
    assert frame_suggestion(V, F, C / 5000 + 7) == "the rig's box is 6.25e+03 x smaller than the mesh's"
    assert frame_suggestion(V, F, C * 5000) == "the rig's box is 4e+03 x larger than the mesh's"
    assert frame_suggestion(V, F, C[:1] + 50) == "the rig is one point"
    suggestion = frame_suggestion(V, F, (C - C.mean(axis=0)) * [1, 1, 1.1] + [50, 50, 50])
    assert suggestion is not None
    assert suggestion.startswith("the rig's box lies beside the mesh's: moved by (-47.5, -4")


def test_joints_that_are_near_but_not_inside():
    assert frame_suggestion(V - [0.55, 0, 0], F, C) is None


def test_the_unit_of_a_rig_of_the_right_size_is_not_in_doubt():
    # A third of it would lie inside, but it is as large as the surface already.
    assert frame_suggestion(V - [2.5, 2, 2], F, C - [2.5, 2, 2] + [0, 0, 1.6]) is None


def test_no_surface_and_no_joints():
    assert frame_suggestion(V, np.zeros((0, 3), int), C) is None
    assert frame_suggestion(V, F, np.zeros((0, 3))) is None


def test_wrong_arguments():
    with pytest.raises(ValueError, match="C must be"):
        rig_report(OUTLINE, EDGES, rig(C, [[0, 1]], [-1]))
