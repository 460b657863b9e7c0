"""Meaning of bones' names: side, part of a body, number; and which bones of two rigs are therefore the same.

Rigs of people call one bone `upperarm01.L`, `UpArm_L`, `LeftArm`, `mixamorig:LeftArm`, `Bip01 L UpperArm`,
`lShldr` or `left_shoulder`. The words here are those of common programs. A word that is not known stands for itself, so
that two rigs of an animal that agree on `Tail_1` are matched too.
"""

import re
from typing import NamedTuple

import numpy as np

from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.skeleton import Skeleton

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_SYNONYMS = {
    "root": "root",
    "hips": "hips hip pelvis",
    "spine": "spine chest upperchest torso upperbody abdomen waist thorax back lowerback belly ribs ribcage",
    "neck": "neck",
    "head": "head skull",
    "clavicle": "clavicle collar collarbone clav",
    "shoulder": "shoulder shldr",
    "upperarm": "upperarm uparm armupper humerus",
    "forearm": "forearm lowerarm loarm lowarm armlower elbow",
    "thigh": "thigh upperleg upleg legupper femur",
    "shin": "shin calf lowerleg loleg lowleg leglower knee tibia",
    "toe": "toe toes ball",
    "eye": "eye eyeball",
    **{
        finger: " ".join(
            form.format(word)
            for word in {"middle": ("middle", "mid"), "pinky": ("pinky", "pinkie", "little")}.get(finger, (finger,))
            for form in ("{}", "hand{}", "finger{}", "{}finger", "f{}")
        )
        for finger in _FINGERS
    },
}
_PARTS = {word: part for part, words in _SYNONYMS.items() for word in words.split()}
_SIDES = {"l": "l", "left": "l", "r": "r", "right": "r"}
# Words that mean no part of a body: of programs, of roles in a rig, of pieces of one bone.
_IDLE = {
    "bone", "joint", "jnt", "j", "b", "c", "bip", "def", "org", "bind", "skin", "sk", "rig", "base",
    "twist", "bend", "roll", "segment", "proximal", "intermediate", "distal",
}  # fmt: skip
# Not bones of the body: marks of where a bone ends, and controls of others.
_NO_BONE = {"end", "nub", "tip", "site", "ik", "fk", "pole", "ctrl", "control", "target", "goal", "helper"}
_PREFIX = re.compile(r"^.*[:|]|^(?:bip\d*|mixamorig\d*|cc base|valvebiped|genesis\d*)(?![a-z])", re.IGNORECASE)
_EDGES = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=\D)(?=\d)|(?<=\d)(?=\D)")


class BoneName(NamedTuple):
    """Parts of a bone's name: side "l", "r" or ""; part of a body, or the name's own word, or ""; numbers."""

    side: str
    part: str
    numbers: tuple[int, ...]


def bone_name(name: str) -> BoneName:
    """Side, part and numbers of a bone's name.

    Examples
    --------
    >>> bone_name("mixamorig:LeftForeArm")
    BoneName(side='l', part='forearm', numbers=())
    >>> bone_name("finger2-1.R")
    BoneName(side='r', part='index', numbers=(1,))
    >>> bone_name("tail_03").part
    'tail'
    """
    bare = _PREFIX.sub("", re.sub(r"[\W_]+", lambda gap: gap[0] if gap[0] in ":|" else " ", name.strip()))
    words = [word.lower() for word in _EDGES.sub(" ", bare).split()]
    side = ""
    kept = []
    for word in words:
        if word in _SIDES:
            side = _SIDES[word]
        elif word not in _IDLE:
            # `leftarm`, written without a seam.
            seam = next((s for s in ("left", "right") if word.startswith(s)), "")
            side = seam[:1] or side
            kept.append(word.removeprefix(seam))
    if _NO_BONE & set(kept):
        return BoneName(side, "", ())
    numbers = tuple(int(word) for word in kept if word.isdecimal() and len(word) < 10)
    part = "".join(word for word in kept if not word.isdecimal())
    part = _PARTS.get(part, part)
    if part == "finger" and len(numbers) == 2 and 1 <= numbers[0] <= 5:
        part, numbers = _FINGERS[numbers[0] - 1], numbers[1:]
    elif part == "toe" and len(numbers) == 2:
        part, numbers = f"toe{numbers[0]}", numbers[1:]
    return BoneName(side, part, numbers)


def matching_bones(source: Skeleton, target: Skeleton) -> dict[int, int]:
    """Pairs of bones, target to source: names of one meaning, in the order of their chains.

    Examples
    --------
    >>> one = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("UpArm_L", "LoArm_L"))
    >>> two = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upperarm01.L", "upperarm02.L"))
    >>> matching_bones(one, two)
    {0: 0, 1: 0}
    """
    if set(target.names) <= set(source.names):
        return {bone: source.names.index(name) for bone, name in enumerate(target.names)}
    chains, source_chains = _chains(target), _chains(source)
    pairs: dict[int, int] = {}
    for (side, part), chain in chains.items():
        led = source_chains.get((side, part))
        if led is None and part.startswith("toe"):
            led = source_chains.get((side, "toe"))
        if led is None and part in ("root", "hips"):
            other = ("", "hips" if part == "root" else "root")
            led = None if other in chains else source_chains.get(other)
        if led:
            pairs |= _along(target, chain, source, led)
    return dict(sorted(pairs.items()))


def _chains(skeleton: Skeleton) -> dict[tuple[str, str], list[int]]:
    """Bones by side and part, in each a path down the hierarchy."""
    names = [bone_name(name) for name in skeleton.names]
    present: dict[str, set[str]] = {side: {name.part for name in names if name.side == side} for side in ("", "l", "r")}
    groups: dict[tuple[str, str], dict[tuple[int, ...], int]] = {}
    for bone, (side, part, numbers) in enumerate(names):
        part = _settled(part, present[side]) if side else part
        if not part:
            continue
        group = groups.setdefault((side, part), {})
        # Of bones that differ in marks alone, `__Clavicle_L` and `Clavicle_L`, the plainest is meant.
        if numbers not in group or len(skeleton.names[bone]) < len(skeleton.names[group[numbers]]):
            group[numbers] = bone
    place = np.empty(len(names), dtype=np.int64)
    place[bone_order(skeleton.P)] = np.arange(len(names))
    chains = {}
    for key, group in groups.items():
        members, bone, chain = set(group.values()), max(group.values(), key=lambda b: (place[b], -b)), []
        while bone >= 0:
            if bone in members:
                chain.append(bone)
            bone = int(skeleton.P[bone])
        chains[key] = chain[::-1]
    return chains


def _settled(part: str, present: set[str]) -> str:
    """Meaning of a word that programs use differently, given the other bones of the same side."""
    arm = "upperarm" if "arm" not in present or "upperarm" in present else "arm"
    thigh = next((word for word in ("thigh", "hips", "leg") if word in present), "")
    meaning = {
        "arm": "arm" if "upperarm" in present else "upperarm",
        "shoulder": "clavicle" if arm in present and "clavicle" not in present else
                    "upperarm" if arm not in present else "shoulder",
        "wrist": "hand",
        "hand": "palm" if "wrist" in present else "hand",
        "hips": "hips" if "thigh" in present else "thigh",
        "leg": "thigh" if thigh == "leg" and "shin" in present else "shin" if thigh != "leg" and "shin" not in present
               else "leg",
        "ankle": "foot",
        "foot": ("instep" if "toe" in present else "toe") if "ankle" in present else "foot",
        "toebase": "toe",
    }  # fmt: skip
    return meaning.get(part, part)


def _along(target: Skeleton, chain: list[int], source: Skeleton, led: list[int]) -> dict[int, int]:
    """Pairs of two chains: one by one if they are equally long, else each bone by the position of its middle."""
    if len(chain) == len(led):
        return dict(zip(chain, led, strict=True))
    ways, source_ways = _ways(target, chain), _ways(source, led)
    middles = (ways[:-1] + ways[1:]) / 2
    at = np.searchsorted(source_ways[1:-1], middles, side="right")
    return dict(zip(chain, np.array(led)[at].tolist(), strict=True))


def _ways(skeleton: Skeleton, chain: list[int]) -> np.ndarray:
    """How far along a chain its bones start, and where it ends, as fractions of its length."""
    points = skeleton.C[[*skeleton.BE[chain, 0], skeleton.BE[chain[-1], 1]]]
    ways = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum())
    return ways / ways[-1] if ways[-1] > 0 else np.arange(len(ways)) / (len(ways) - 1)
