"""How programs call the joints of one person, as skeletons that all stand in the same place."""

import numpy as np

from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

# Where joints lie, in centimetres: the left ones, and those in the middle.
PLACES = {
    "root": (0, 0), "hips": (0, 95), "hips2": (0, 94), "spine": (0, 103), "spine2": (0, 113), "spine3": (0, 123),
    "spine4": (0, 130), "neck": (0, 146), "neck2": (0, 150), "head": (0, 155), "head end": (0, 175),
    "clavicle": (4, 141), "shoulder": (10, 142), "upperarm": (18, 142), "upperarm twist": (30, 142),
    "forearm": (44, 142), "forearm twist": (56, 142), "hand": (68, 142), "hand end": (86, 142), "hip": (5, 95),
    "thigh": (9, 91), "thigh twist": (9, 70), "shin": (9, 50), "shin twist": (9, 30), "foot": (9, 9),
    "instep": (9, 5), "toe": (9, 2), "toe end": (9, 1),
}  # fmt: skip
# What a joint may hang on, the likeliest first.
ABOVE = {
    "hips": "root", "hips2": "hips", "spine": "hips root", "spine2": "spine", "spine3": "spine2", "spine4": "spine3",
    "neck": "spine4 spine3 spine2 spine", "neck2": "neck", "head": "neck2 neck spine4", "head end": "head",
    "clavicle": "spine4 spine3 spine2 spine", "shoulder": "clavicle", "upperarm": "shoulder clavicle spine3",
    "upperarm twist": "upperarm", "forearm": "upperarm", "forearm twist": "forearm", "hand": "forearm",
    "hand end": "hand", "hip": "hips2 hips spine root", "thigh": "hip hips2 hips spine root", "thigh twist": "thigh",
    "shin": "thigh", "shin twist": "shin", "foot": "shin", "instep": "foot", "toe": "instep foot", "toe end": "toe",
}  # fmt: skip
MAIN = ("hips", "spine", "neck", "head", *(f"{part} {side}" for side in "lr" for part in (
    "clavicle", "upperarm", "forearm", "hand", "thigh", "shin", "foot", "toe")))  # fmt: skip

MIXAMO = {
    "hips": "Hips", "spine": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    "head end": "HeadTop_End", "clavicle": "{Left}Shoulder", "upperarm": "{Left}Arm", "forearm": "{Left}ForeArm",
    "hand": "{Left}Hand", "thigh": "{Left}UpLeg", "shin": "{Left}Leg", "foot": "{Left}Foot", "toe": "{Left}ToeBase",
    "toe end": "{Left}Toe_End",
}  # fmt: skip
UNITY = {
    "hips": "Hips", "spine": "Spine", "spine2": "Chest", "spine3": "UpperChest", "neck": "Neck", "head": "Head",
    "clavicle": "{Left}Shoulder", "upperarm": "{Left}UpperArm", "forearm": "{Left}LowerArm", "hand": "{Left}Hand",
    "thigh": "{Left}UpperLeg", "shin": "{Left}LowerLeg", "foot": "{Left}Foot", "toe": "{Left}Toes",
}  # fmt: skip
SMPL = {
    "hips": "Pelvis", "spine": "Spine1", "spine2": "Spine2", "spine3": "Spine3", "neck": "Neck", "head": "Head",
    "clavicle": "{L}_Collar", "upperarm": "{L}_Shoulder", "forearm": "{L}_Elbow", "hand": "{L}_Wrist",
    "hand end": "{L}_Hand", "thigh": "{L}_Hip", "shin": "{L}_Knee", "foot": "{L}_Ankle", "toe": "{L}_Foot",
}  # fmt: skip
RIGIFY = {
    "hips": "spine", "spine": "spine.001", "spine2": "spine.002", "spine3": "spine.003", "neck": "spine.004",
    "neck2": "spine.005", "head": "spine.006", "hip": "pelvis.{L}", "clavicle": "shoulder.{L}",
    "upperarm": "upper_arm.{L}", "upperarm twist": "upper_arm.{L}.001", "forearm": "forearm.{L}",
    "forearm twist": "forearm.{L}.001", "hand": "hand.{L}", "thigh": "thigh.{L}", "thigh twist": "thigh.{L}.001",
    "shin": "shin.{L}", "shin twist": "shin.{L}.001", "foot": "foot.{L}", "toe": "toe.{L}",
}  # fmt: skip
CONVENTIONS = {
    "Mixamo": {role: f"mixamorig:{name}" for role, name in MIXAMO.items()},
    "Mixamo numbered": {role: f"mixamorig12:{name}" for role, name in MIXAMO.items()},
    "Mixamo of three.js": {role: f"mixamorig{name}" for role, name in MIXAMO.items()},
    "Mixamo nested": {role: f"Armature|Model:mixamorig1:{name}" for role, name in MIXAMO.items()},
    "HumanIK": {"root": "Character1_Reference", **{role: f"Character1_{name}" for role, name in MIXAMO.items()}},
    "HumanIK with rolls": {**MIXAMO, "upperarm twist": "{Left}ArmRoll", "thigh twist": "{Left}UpLegRoll"},
    "a prefix": {role: f"Model_{name}" for role, name in MIXAMO.items()},
    "a prefix without a seam": {role: f"hero{name.lower()}" for role, name in UNITY.items()},
    "LAFAN1": MIXAMO | {"toe": "{Left}Toe"},
    "CMU": MIXAMO | {"spine": "LowerBack", "spine2": "Spine", "spine3": "Spine1", "neck2": "Neck1",
                     "hip": "{L}HipJoint"},
    "Rigify": {role: f"DEF-{name}" for role, name in RIGIFY.items()},
    "Rigify of three.js": {role: f"DEF-{name.replace('.', '')}" for role, name in RIGIFY.items()},
    "Rigify's metarig": RIGIFY,
    "Rigify of Blender 2.7": {
        "root": "root", "hips": "DEF-hips", "spine": "DEF-spine", "spine2": "DEF-chest", "neck": "DEF-neck",
        "head": "DEF-head", "clavicle": "DEF-shoulder.{L}", "upperarm": "DEF-upper_arm.01.{L}",
        "upperarm twist": "DEF-upper_arm.02.{L}", "forearm": "DEF-forearm.01.{L}",
        "forearm twist": "DEF-forearm.02.{L}", "hand": "DEF-hand.{L}", "thigh": "DEF-thigh.01.{L}",
        "thigh twist": "DEF-thigh.02.{L}", "shin": "DEF-shin.01.{L}", "shin twist": "DEF-shin.02.{L}",
        "foot": "DEF-foot.{L}", "toe": "DEF-toe.{L}",
    },
    "Daz": {
        "hips": "hip", "hips2": "pelvis", "spine": "abdomenLower", "spine2": "abdomenUpper", "spine3": "chestLower",
        "spine4": "chestUpper", "neck": "neckLower", "neck2": "neckUpper", "head": "head", "clavicle": "{l}Collar",
        "upperarm": "{l}ShldrBend", "upperarm twist": "{l}ShldrTwist", "forearm": "{l}ForearmBend",
        "forearm twist": "{l}ForearmTwist", "hand": "{l}Hand", "thigh": "{l}ThighBend",
        "thigh twist": "{l}ThighTwist", "shin": "{l}Shin", "foot": "{l}Foot", "instep": "{l}Metatarsals",
        "toe": "{l}Toe",
    },
    "Daz Genesis 9": {
        "hips": "hip", "hips2": "pelvis", "spine": "spine1", "spine2": "spine2", "spine3": "spine3",
        "spine4": "spine4", "neck": "neck1", "neck2": "neck2", "head": "head", "clavicle": "{l}_shoulder",
        "upperarm": "{l}_upperarm", "upperarm twist": "{l}_upperarmtwist1", "forearm": "{l}_forearm",
        "forearm twist": "{l}_forearmtwist1", "hand": "{l}_hand", "thigh": "{l}_thigh",
        "thigh twist": "{l}_thightwist1", "shin": "{l}_shin", "foot": "{l}_foot", "instep": "{l}_metatarsals",
        "toe": "{l}_toes",
    },
    "VRM": UNITY | {"toe": "{Left}ToeBase"},
    "VRM of VRoid": {"root": "Root"} | {
        role: f"J_Bip_{'{L}' if '{' in name else 'C'}_{name.removeprefix('{Left}')}" for role, name in UNITY.items()
    } | {"toe": "J_Bip_{L}_ToeBase"},
    "VRM's humanoid": {role: name.replace("{Left}", "{left}") if "{" in name else name[0].lower() + name[1:]
                       for role, name in UNITY.items()},
    "Unity": UNITY,
    "Unity with spaces": {role: name.replace("Upper", "Upper ").replace("Lower", "Lower ").replace("}", "} ")
                          for role, name in UNITY.items()},
    "Unreal": {
        "root": "root", "hips": "pelvis", "spine": "spine_01", "spine2": "spine_02", "spine3": "spine_03",
        "neck": "neck_01", "head": "head", "clavicle": "clavicle_{l}", "upperarm": "upperarm_{l}",
        "upperarm twist": "upperarm_twist_01_{l}", "forearm": "lowerarm_{l}",
        "forearm twist": "lowerarm_twist_01_{l}", "hand": "hand_{l}", "hand end": "ik_hand_{l}", "thigh": "thigh_{l}",
        "thigh twist": "thigh_twist_01_{l}", "shin": "calf_{l}", "shin twist": "calf_twist_01_{l}",
        "foot": "foot_{l}", "toe": "ball_{l}",
    },
    "SMPL": SMPL,
    "SMPL of a model file": {role: name.replace("{L}", "{left}").lower() for role, name in SMPL.items()},
    "SMPL of Maya": {"root": "m_avg_root"} | {role: f"m_avg_{name}" for role, name in SMPL.items()},
    "SMPL numbered": {role: f"{name}_{number:02}" for number, (role, name) in enumerate(SMPL.items())},
    "Bandai Namco": {"root": "joint_Root"} | {
        role: f"{name.removeprefix('{Left}')}_{{L}}" if "{" in name else name for role, name in UNITY.items()
        if role != "spine3"
    },
    "3ds Max": {
        "root": "Bip01", "hips": "Bip01 Pelvis", "spine": "Bip01 Spine", "spine2": "Bip01 Spine1",
        "neck": "Bip01 Neck", "head": "Bip01 Head", "head end": "Bip01 HeadNub", "clavicle": "Bip01 {L} Clavicle",
        "upperarm": "Bip01 {L} UpperArm", "forearm": "Bip01 {L} Forearm", "hand": "Bip01 {L} Hand",
        "thigh": "Bip01 {L} Thigh", "shin": "Bip01 {L} Calf", "foot": "Bip01 {L} Foot", "toe": "Bip01 {L} Toe0",
        "toe end": "Bip01 {L} Toe0Nub",
    },
    "MakeHuman": {
        "hips": "root", "spine": "spine05", "spine2": "spine03", "spine3": "spine02", "spine4": "spine01",
        "neck": "neck01", "neck2": "neck02", "head": "head", "hip": "pelvis.{L}", "clavicle": "clavicle.{L}",
        "shoulder": "shoulder01.{L}", "upperarm": "upperarm01.{L}", "upperarm twist": "upperarm02.{L}",
        "forearm": "lowerarm01.{L}", "forearm twist": "lowerarm02.{L}", "hand": "wrist.{L}", "thigh": "upperleg01.{L}",
        "thigh twist": "upperleg02.{L}", "shin": "lowerleg01.{L}", "shin twist": "lowerleg02.{L}",
        "foot": "foot.{L}", "toe": "toe1-1.{L}",
    },
    "Cascadeur": {
        "root": "root", "hips": "pelvis", "spine": "stomach", "spine2": "chest", "neck": "neck", "head": "head",
        "clavicle": "clavicle_{l}", "upperarm": "arm_{l}", "forearm": "forearm_{l}", "hand": "hand_{l}",
        "thigh": "thigh_{l}", "shin": "calf_{l}", "foot": "foot_{l}", "toe": "toe_{l}",
    },
    "Xsens": {
        "hips": "Hips", "spine": "Chest", "spine2": "Chest2", "spine3": "Chest3", "spine4": "Chest4", "neck": "Neck",
        "head": "Head", "clavicle": "{Left}Collar", "upperarm": "{Left}Shoulder", "forearm": "{Left}Elbow",
        "hand": "{Left}Wrist", "thigh": "{Left}Hip", "shin": "{Left}Knee", "foot": "{Left}Ankle", "toe": "{Left}Toe",
    },
    "Acclaim": {
        "hips": "root", "spine": "lowerback", "spine2": "upperback", "spine3": "thorax", "neck": "lowerneck",
        "neck2": "upperneck", "head": "head", "hip": "{l}hipjoint", "clavicle": "{l}clavicle",
        "upperarm": "{l}humerus", "forearm": "{l}radius", "hand": "{l}wrist", "hand end": "{l}hand",
        "thigh": "{l}femur", "shin": "{l}tibia", "foot": "{l}foot", "toe": "{l}toes",
    },
    "Character Creator": {
        "hips": "CC_Base_Hip", "hips2": "CC_Base_Pelvis", "spine": "CC_Base_Waist", "spine2": "CC_Base_Spine01",
        "spine3": "CC_Base_Spine02", "neck": "CC_Base_NeckTwist01", "neck2": "CC_Base_NeckTwist02",
        "head": "CC_Base_Head", "clavicle": "CC_Base_{L}_Clavicle", "upperarm": "CC_Base_{L}_Upperarm",
        "upperarm twist": "CC_Base_{L}_UpperarmTwist01", "forearm": "CC_Base_{L}_Forearm",
        "forearm twist": "CC_Base_{L}_ForearmTwist01", "hand": "CC_Base_{L}_Hand", "thigh": "CC_Base_{L}_Thigh",
        "thigh twist": "CC_Base_{L}_ThighTwist01", "shin": "CC_Base_{L}_Calf", "foot": "CC_Base_{L}_Foot",
        "toe": "CC_Base_{L}_ToeBase",
    },
    "Azure Kinect": {
        "hips": "Pelvis", "spine": "SpineNavel", "spine2": "SpineChest", "neck": "Neck", "head": "Head",
        "clavicle": "Clavicle{Left}", "upperarm": "Shoulder{Left}", "forearm": "Elbow{Left}", "hand": "Wrist{Left}",
        "hand end": "HandTip{Left}", "thigh": "Hip{Left}", "shin": "Knee{Left}", "foot": "Ankle{Left}",
        "toe": "Foot{Left}",
    },
    "Maya's advanced skeleton": {
        "hips": "Root_M", "spine": "Spine1_M", "spine2": "Chest_M", "neck": "Neck_M", "head": "Head_M",
        "clavicle": "Scapula_{L}", "upperarm": "Shoulder_{L}", "forearm": "Elbow_{L}", "hand": "Wrist_{L}",
        "thigh": "Hip_{L}", "shin": "Knee_{L}", "foot": "Ankle_{L}", "toe": "Toes_{L}",
    },
    "sides behind": {role: f"{name.removeprefix('{Left}')}_{{left}}" if "{" in name else name
                     for role, name in UNITY.items()},
    "MikuMikuDance": {
        "root": "センター", "hips": "下半身", "spine": "上半身", "spine2": "上半身2", "neck": "首", "head": "頭",
        "clavicle": "{左}肩", "upperarm": "{左}腕", "forearm": "{左}ひじ", "hand": "{左}手首", "thigh": "{左}足",
        "shin": "{左}ひざ", "foot": "{左}足首", "toe": "{左}つま先",
    },
}  # fmt: skip
SIDES = {
    "l": {"Left": "Left", "left": "left", "L": "L", "l": "l", "左": "左"},
    "r": {"Left": "Right", "left": "right", "L": "R", "l": "r", "左": "右"},
}


def person(convention: str) -> tuple[Skeleton, dict[str, str]]:
    """The skeleton of a convention, and the part of the body, with its side, of each of its names."""
    roles: dict[str, tuple[str, str]] = {}
    for role, name in CONVENTIONS[convention].items():
        for side, words in SIDES.items() if "{" in name else [("", {})]:
            roles[name.format(**words)] = role, side
    names = {value: name for name, value in roles.items()}
    number = {name: joint for joint, name in enumerate(roles)}
    parents, places = [], []
    for role, side in roles.values():
        above = (names.get((word, side), names.get((word, ""))) for word in ABOVE.get(role, "").split())
        parents.append(next((number[name] for name in above if name is not None), -1))
        x, y = PLACES[role]
        places.append([-x if side == "r" else x, y, 0.0])
    skeleton = skeleton_of_joints(np.array(places), np.array(parents), list(roles))
    parts = {name: f"{role.split()[0].rstrip('234')} {side}".strip() for name, (role, side) in roles.items()}
    ends = {name: "end" for name, (role, _) in roles.items() if role.endswith("end")}
    return skeleton, parts | ends
