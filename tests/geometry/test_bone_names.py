from itertools import permutations

import numpy as np
import pytest

from nilbs.geometry.bone_names import bone_name, matching_bones, without_prefix
from nilbs.geometry.retargeting import guess_bone_map
from nilbs.geometry.skeleton import Skeleton

from .conventions import CONVENTIONS, MAIN, person


def chain(*names: str, parents: list[int] | None = None, lengths: list[float] | None = None) -> Skeleton:
    """A skeleton of named bones, one after the other unless parents are given, each as long as its neighbours."""
    b = len(names)
    C = np.zeros((b + 1, 2))
    C[1:, 0] = np.cumsum(np.ones(b) if lengths is None else lengths)
    bones = np.arange(b)
    return Skeleton(C, np.stack([bones, bones + 1], 1), bones - 1 if parents is None else parents, names)


def matched(source: Skeleton, target: Skeleton) -> dict[str, str]:
    return {target.names[bone]: source.names[led] for bone, led in matching_bones(source, target).items()}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("upperarm01.L", ("l", "upperarm", (1,))),
        ("UpArm_L", ("l", "upperarm", ())),
        ("mixamorig:LeftForeArm", ("l", "forearm", ())),
        ("Character|mixamorig:RightUpLeg", ("r", "thigh", ())),
        ("Bip01 R Calf", ("r", "shin", ())),
        ("ValveBiped.Bip01_L_UpperArm", ("l", "upperarm", ())),
        ("mixamorigLeftArm", ("l", "arm", ())),
        ("Armature|Hero:mixamorig12:LeftArm", ("l", "arm", ())),
        ("Character1_LeftForeArm", ("l", "forearm", ())),
        ("rhumerus", ("r", "upperarm", ())),
        ("root", ("", "root", ())),
        ("ring_01_l", ("l", "ring", (1,))),
        ("ElbowLeft", ("l", "forearm", ())),
        ("kneeright", ("r", "shin", ())),
        ("Arm_Lft", ("l", "arm", ())),
        ("thigh_rt", ("r", "thigh", ())),
        ("l_upperarmtwist1", ("l", "upperarm", (1,))),
        ("左ひじ", ("l", "forearm", ())),
        ("lShldrBend", ("l", "shoulder", ())),
        ("DEF-upper_arm.L.001", ("l", "upperarm", (1,))),
        ("J_Bip_L_LowerLeg", ("l", "shin", ())),
        ("CC_Base_R_Thigh", ("r", "thigh", ())),
        ("l_hand", ("l", "hand", ())),
        ("leftfoot", ("l", "foot", ())),
        ("LThigh", ("l", "thigh", ())),
        ("LeftHandIndex3", ("l", "index", (3,))),
        ("leftMiddleProximal", ("l", "middle", ())),
        ("finger5-2.R", ("r", "pinky", (2,))),
        ("f_ring.02.L", ("l", "ring", (2,))),
        ("toe3-1.L", ("l", "toe3", (1,))),
        ("RightToeBase", ("r", "toe", ())),
        ("UpperChest", ("", "spine", ())),
        ("Pelvis", ("", "hips", ())),
        ("Tail_04", ("", "tail", (4,))),
        ("joint12", ("", "", (12,))),
        ("HeadTop_End", ("", "", ())),
        ("hand.IK.L", ("l", "", ())),
        ("尻尾_2", ("", "尻尾", (2,))),
        ("", ("", "", ())),
        ("left", ("l", "", ())),
        ("bone" + "9" * 4000, ("", "", ())),
    ],
)
def test_names_have_a_side_a_part_and_a_number(name: str, expected: tuple) -> None:
    assert tuple(bone_name(name)) == expected


@pytest.mark.parametrize(
    ("names", "arm"),
    [
        # Words of four programs for the same four bones.
        (("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"), "LeftArm"),
        (("L_Collar", "L_Shoulder", "L_Elbow", "L_Wrist"), "L_Shoulder"),
        (("lCollar", "lShldr", "lForeArm", "lHand"), "lShldr"),
        (("clavicle_l", "upperarm_l", "lowerarm_l", "hand_l"), "upperarm_l"),
    ],
)
def test_the_meaning_of_shoulder_depends_on_the_other_bones(names: tuple[str, ...], arm: str) -> None:
    target = chain("clavicle.L", "shoulder01.L", "upperarm01.L", "upperarm02.L", "lowerarm01.L", "wrist.L")
    expected = {
        "clavicle.L": names[0],
        "upperarm01.L": arm,
        "upperarm02.L": arm,
        "lowerarm01.L": names[2],
        "wrist.L": names[3],
    }
    assert matched(chain(*names), target) == expected


@pytest.mark.parametrize(
    "names",
    [
        ("RightUpLeg", "RightLeg", "RightFoot", "RightToeBase"),
        ("R_Hip", "R_Knee", "R_Ankle", "R_Foot"),
        ("rThigh", "rShin", "rFoot", "rToe"),
        ("leg.R", "calf.R", "foot.R", "toes.R"),
        ("hip.R", "leg.R", "foot.R", "ball.R"),
    ],
)
def test_the_meaning_of_leg_depends_on_the_other_bones(names: tuple[str, ...]) -> None:
    target = chain("upperleg01.R", "lowerleg01.R", "foot.R", "toe2-1.R")
    assert matched(chain(*names), target) == dict(zip(target.names, names, strict=True))


def test_unknown_words_match_themselves() -> None:
    assert matched(chain("leg.L", "thigh.L", "shin.L"), chain("upperleg.L", "lowerleg.L")) == {
        "upperleg.L": "thigh.L",
        "lowerleg.L": "shin.L",
    }
    assert matched(chain("ankle.L", "foot.L", "toe.L"), chain("Foot_L", "Toe_L")) == {
        "Foot_L": "ankle.L",
        "Toe_L": "toe.L",
    }
    assert matched(chain("arm.L", "upperarm.L"), chain("UpArm_L")) == {"UpArm_L": "upperarm.L"}


def test_sides_are_not_mixed() -> None:
    assert matched(chain("hand.L"), chain("hand.R")) == {}
    assert matched(chain("hand.L"), chain("Hand_l")) == {"Hand_l": "hand.L"}


def test_chains_are_matched_by_their_order_and_not_by_their_numbers() -> None:
    assert matched(chain("Spine1", "Spine2", "Spine3"), chain("spine03", "spine02", "spine01")) == {
        "spine03": "Spine1",
        "spine02": "Spine2",
        "spine01": "Spine3",
    }


def test_chains_of_other_lengths_are_matched_by_place() -> None:
    source = chain("Neck1", "Neck2", lengths=[3, 1])
    target = chain("neck01", "neck02", "neck03", "neck04")
    assert [matched(source, target)[name] for name in target.names] == ["Neck1", "Neck1", "Neck1", "Neck2"]
    # Bones of the shorter chain take the bone of the longer one at their middle.
    assert matched(target, chain("Neck")) == {"Neck": "neck03"}
    flat = Skeleton(np.zeros((1, 2)), np.zeros((3, 2)), [-1, 0, 1], ("neck1", "neck2", "neck3"))
    assert matched(chain("Neck1"), flat) == dict.fromkeys(flat.names, "Neck1")


def test_among_names_that_differ_in_marks_the_plainest_matches() -> None:
    assert matched(chain("__Hand_L", "Hand_L"), chain("hand.L")) == {"hand.L": "Hand_L"}
    assert matched(chain("Hand_L", "__Hand_L"), chain("hand.L")) == {"hand.L": "Hand_L"}


def test_a_chain_is_one_path_down_the_hierarchy() -> None:
    source = chain("Tail", "tail_fin1", "tail_1", "tail_2", parents=[-1, 0, 0, 2])
    assert matched(source, chain("tail.001", "tail.002", "tail.003")) == {
        "tail.001": "Tail",
        "tail.002": "tail_1",
        "tail.003": "tail_2",
    }


def test_a_root_is_hips_where_neither_has_both() -> None:
    assert matched(chain("Hips", "Spine"), chain("root", "spine05")) == {"root": "Hips", "spine05": "Spine"}
    assert matched(chain("Root", "Spine"), chain("pelvis", "chest")) == {"pelvis": "Root", "chest": "Spine"}
    assert matched(chain("Hips"), chain("root", "pelvis")) == {"pelvis": "Hips"}
    assert matched(chain("Root", "Hips"), chain("root", "chest")) == {"root": "Root"}


def test_all_toes_follow_one() -> None:
    target = chain("toe1-1.L", "toe1-2.L", "toe2-1.L", parents=[-1, 0, -1])
    assert matched(chain("LeftToe"), target) == dict.fromkeys(target.names, "LeftToe")


def test_equal_names_match_without_any_meaning() -> None:
    source = chain("joint2", "Hand_L", "joint0", "joint1")
    assert matched(source, chain("joint0", "joint1", "joint2")) == {
        name: name for name in ("joint0", "joint1", "joint2")
    }
    assert matched(source, chain("joint0", "joint7")) == {}


@pytest.mark.parametrize("target", CONVENTIONS)
def test_each_convention_is_mapped_on_every_other_and_no_bone_on_another_part(target: str) -> None:
    rig, parts = person(target)
    for other in CONVENTIONS:
        source, source_parts = person(other)
        pairs = guess_bone_map(source, rig)
        wrong = {(name, led) for name, led in pairs.items() if parts[name] != source_parts[led]}
        assert not wrong, other
        found = {parts[name] for name in pairs}
        assert found >= set(MAIN) & set(parts.values()) & set(source_parts.values()), other
        assert len(set(MAIN) & found) >= 15


def test_pieces_that_twist_lead_no_other_bone() -> None:
    for source, rig in permutations(("Unreal", "Daz", "HumanIK with rolls", "Mixamo", "Character Creator"), 2):
        led = guess_bone_map(person(source)[0], person(rig)[0]).values()
        assert not [name for name in led if "wist" in name.replace("NeckTwist", "") or "Roll" in name]


FINGERS = {
    "Mixamo": "LeftHandIndex1 LeftHandIndex2 LeftHandIndex3",
    "Unity": "LeftIndexProximal LeftIndexIntermediate LeftIndexDistal",
    "Unreal": "index_01_l index_02_l index_03_l",
    "Rigify": "DEF-f_index.01.L DEF-f_index.02.L DEF-f_index.03.L",
    "SMPL": "left_index1 left_index2 left_index3",
    "VRoid": "J_Bip_L_Index1 J_Bip_L_Index2 J_Bip_L_Index3",
    "Daz": "lIndex1 lIndex2 lIndex3",
    "MakeHuman": "finger2-1.L finger2-2.L finger2-3.L",
}


@pytest.mark.parametrize("target", FINGERS)
def test_joints_of_a_finger(target: str) -> None:
    for source in FINGERS:
        names, led = FINGERS[target].split(), FINGERS[source].split()
        assert matched(chain(*led), chain(*names)) == dict(zip(names, led, strict=True)), source


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["Model_Hips", "Model_Head", "Model_LeftArm"], ["Hips", "Head", "LeftArm"]),
        (["a:Rig_Hips", "a:Rig_Head", "a:Rig_Hand.L"], ["Hips", "Head", "Hand.L"]),
        # Nearly all.
        (["Fox_Hips", "Fox_Head", "Fox_Neck", "Fox_Spine", "Mesh"], ["Hips", "Head", "Neck", "Spine", "Mesh"]),
        (["Eel_Fin", "Eel_Gill", "Eel_Jaw", "Eel_Mouth"], ["Fin", "Gill", "Jaw", "Mouth"]),
        (["hunterhips", "hunterhead", "hunterneck"], ["hips", "head", "neck"]),
        # What belongs to the meaning stays.
        *[
            (names, names)
            for names in (
                ["LeftArm", "LeftForeArm", "LeftHand"],
                ["l_arm", "l_forearm", "l_hand", "l_clavicle"],
                ["hand_thumb", "hand_index", "hand_ring", "hand_pinky"],
                ["Tail_01", "Tail_02", "Tail_03", "Tail_04"],
                ["Spine", "Spine1", "Spine2"],
                ["arm_upper", "arm_lower"],
                ["Hips", "Head"],
                ["Tail_Tip", "Tail_End"],
                ["bone"],
                [],
            )
        ],
    ],
)
def test_a_prefix_of_nearly_all_names_is_left_out(names: list[str], expected: list[str]) -> None:
    found = without_prefix(names)
    assert [bone_name(name) for name in found] == [bone_name(name) for name in expected]


def test_a_prefix_of_one_rig_alone_hides_no_pair() -> None:
    names = ["Hips", "Spine", "LeftArm", "RightArm", "Antenna", "Wing1", "Wing2"]
    source = chain(*names)
    for prefix in ("Model_", "Model:", "Character1_", "Skeleton_", "mixamorig", "mixamorig1:", "Armature|", "A|B:c_"):
        target = chain(*(prefix + name for name in names))
        assert matched(source, target) == {prefix + name: name for name in names}
        assert matched(target, source) == {name: prefix + name for name in names}
