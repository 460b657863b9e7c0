"""Meaning of bones' names: side, part of a body, number; and which bones of two rigs are therefore the same.

Rigs of people call one bone `upperarm01.L`, `UpArm_L`, `LeftArm`, `mixamorig:LeftArm`, `Bip01 L UpperArm`,
`lShldr` or `left_shoulder`. The words here are those of common programs. A word that is not known stands for itself, so
that two rigs of an animal that agree on `Tail_1` are matched too.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.skeleton import Skeleton

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_SYNONYMS = {
    "root": "root センター",
    "hips": "hips hip pelvis hipmaster lowertorso 下半身",
    "spine": "spine spinelower spineupper spinemid spinenavel spinechest lowerspine upperspine chest chestlower "
    "chestupper lowerchest upperchest torso uppertorso upperbody abdomen abdomenlower abdomenupper stomach waist "
    "thorax back lowerback upperback belly ribs ribcage 上半身",
    "neck": "neck necklower neckupper lowerneck upperneck 首",
    "head": "head skull 頭",
    "clavicle": "clavicle collar collarbone clav scapula",
    "shoulder": "shoulder shldr 肩",
    "upperarm": "upperarm uparm armupper armup humerus 腕",
    "forearm": "forearm lowerarm loarm lowarm armlower armlow elbow radius ひじ 肘",
    "hand": "hand 手首",
    "thigh": "thigh upperleg upleg legupper legup femur 足",
    "shin": "shin shank calf lowerleg loleg lowleg leglower leglow knee tibia ひざ 膝",
    "foot": "foot 足首",
    "toe": "toe toes ball つま先",
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
_PARTS["thumbmetacarpal"] = "thumb"  # the first of its three bones; of other fingers it is one more in the palm
# Words of which the other bones decide what they mean, see `_settled`.
_KNOWN = {*_PARTS, *_PARTS.values(), "arm", "leg", "wrist", "ankle", "toebase", "fingers", "finger", "hipjoint"}
_SIDES = {
    **dict.fromkeys(("l", "left", "lf", "lft", "lt"), "l"),
    **dict.fromkeys(("r", "right", "rt", "rgt", "rght"), "r"),
}
# Sides written in front of a word or behind it, without a seam; one letter only where the rest is a known word.
_GLUED = {"left": "l", "right": "r", "左": "l", "右": "r"}
# Words that mean no part of a body: of programs, of roles in a rig, of pieces of one bone.
_TWIST = ("twist", "roll")
_PHALANX = ("proximal", "intermediate", "distal")
_IDLE = {
    "bone", "joint", "jnt", "jt", "j", "b", "c", "m", "bip", "def", "deform", "org", "bind", "skin", "sk", "skel",
    "rig", "base", "bend", "segment", *_PHALANX, *_TWIST,
}  # fmt: skip
# Not bones of the body: marks of where a bone ends, and controls of others.
_ENDS = {"end", "nub", "tip", "site", "endsite"}
_NO_BONE = {*_ENDS, "ik", "fk", "mch", "pole", "ctrl", "control", "target", "goal", "helper", "tweak"}
# Program's prefixes may follow one another.
_PREFIX = re.compile(
    r"^.*[:|]|^(?i:bip\d*|mixamorig\d*|cc base|valvebiped|genesis\d*|character\d*|skeleton|armature)(?![a-z])"
)
_EDGES = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=\D)(?=\d)|(?<=\d)(?=\D)")
_SHARED = 0.8  # of all names: what so many start with is a prefix
_LONGEST = 64  # characters of a prefix
_MANY = 4  # names that show a prefix, though none of their words is known


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
    return _parsed(name)[0]


@lru_cache(2**15)
def _parsed(name: str) -> tuple[BoneName, str, bool]:
    """The parts of a name, its own word for the part, and whether it is of a piece that only twists."""
    bare = re.sub(r"[\W_]+", lambda gap: gap[0] if gap[0] in ":|" else " ", name.strip())
    while (shorter := _PREFIX.sub("", bare).strip()) != bare:
        bare = shorter
    side = ""
    kept, twists, phalanx = [], False, ""
    for word in map(str.lower, _EDGES.sub(" ", bare).split()):
        if word in _SIDES:
            side = _SIDES[word]
            continue
        twist = next((end for end in _TWIST if word.endswith(end) and word.removesuffix(end) in {"", *_KNOWN}), "")
        twists = twists or bool(twist)
        word = word.removesuffix(twist)
        phalanx = word if word in _PHALANX else phalanx
        own_side, word = _side_of_word(word)
        side = own_side or side
        if word and word not in _IDLE:
            kept.append(word)
    if _NO_BONE & set(kept):
        return BoneName(side, "", ()), "", twists
    numbers = tuple(int(word) for word in kept if word.isdecimal() and len(word) < 10)
    own = "".join(word for word in kept if not word.isdecimal())
    part = _PARTS.get(own, own)
    if part == "finger" and len(numbers) == 2 and 1 <= numbers[0] <= 5:
        part, numbers = _FINGERS[numbers[0] - 1], numbers[1:]
    elif part == "toe" and len(numbers) == 2:
        part, numbers = f"toe{numbers[0]}", numbers[1:]
    return BoneName(side, part, numbers), own + phalanx, twists


def _side_of_word(word: str) -> tuple[str, str]:
    """The side that is part of a word without a seam, as in `leftarm` or `lfemur`, and the rest of the word."""
    for mark, side in _GLUED.items():
        if word.startswith(mark):
            return side, word.removeprefix(mark)
        if word.endswith(mark) and word.removesuffix(mark) in _KNOWN:
            return side, word.removesuffix(mark)
    if word[:1] in ("l", "r") and word not in _KNOWN and word[1:] in _KNOWN:
        return word[0], word[1:]
    return "", word


def without_prefix(names: Sequence[str]) -> tuple[str, ...]:
    """Names without what all or nearly all start with, unless it is part of their meaning.

    Examples
    --------
    >>> without_prefix(["Model_Hips", "Model_Spine", "Model_LeftArm", "Model_RightArm", "Mesh"])
    ('Hips', 'Spine', 'LeftArm', 'RightArm', 'Mesh')
    >>> without_prefix(["LeftArm", "LeftForeArm", "LeftHand"])
    ('LeftArm', 'LeftForeArm', 'LeftHand')
    """
    names = tuple(names)
    least = max(2, math.ceil(_SHARED * len(names)))
    known, any_ = _meaning(names)
    best, chosen = (known, False), names
    for size in range(1, _LONGEST):
        starts = Counter(name[:size] for name in names if len(name) > size)
        start, count = max(starts.items(), key=lambda found: found[1], default=("", 0))
        if count < least:
            break
        seam, own = not start[-1].isalnum(), bone_name(start)
        if own.side or own.part in _KNOWN or not (seam or 2 * known < len(names)):
            continue
        shorter = tuple(name[size:] if name.startswith(start) and len(name) > size else name for name in names)
        now, left = _meaning(shorter)
        # A seam is the likelier end of a prefix, and of two cuts that do as well the later one.
        if left >= any_ and (now > known or (now == known and seam and len(names) >= _MANY)) and (now, seam) >= best:
            best, chosen = (now, seam), shorter
    return chosen


def _meaning(names: Sequence[str]) -> tuple[int, int]:
    """How many names have a known word, and how many have any."""
    parts = [bone_name(name).part for name in names]
    return sum(part in _KNOWN for part in parts), sum(map(bool, parts))


def marks_end(name: str) -> bool:
    """Whether a name is of a joint that only marks where a bone ends, as exporters add them.

    Examples
    --------
    >>> [marks_end(name) for name in ("LeftToe_End", "Bip01 HeadNub", "End Site", "tip_03", "Tendon")]
    [True, True, True, True, False]
    """
    return not _ENDS.isdisjoint(_EDGES.sub(" ", re.sub(r"[\W_]+", " ", name)).lower().split())


def matching_bones(source: Skeleton, target: Skeleton) -> dict[int, int]:
    """Pairs of bones, target to source: names of one meaning, in the order of their chains.

    Examples
    --------
    >>> one = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("UpArm_L", "LoArm_L"))
    >>> two = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upperarm01.L", "upperarm02.L"))
    >>> matching_bones(one, two)
    {0: 0, 1: 0}
    """
    forms = [(target.names, source.names), (without_prefix(target.names), without_prefix(source.names))]
    for names, source_names in forms:
        if set(names) <= set(source_names):
            return {bone: source_names.index(name) for bone, name in enumerate(names)}
    chains, source_chains = (_chains(rig, names) for rig, names in zip((target, source), forms[1], strict=True))
    pairs: dict[int, int] = {}
    for (side, part), chain in chains.items():
        led = source_chains.get((side, part))
        if led is None and part.startswith("toe"):
            toes = (source_chains.get((side, f"toe{number}"), [])[:1] for number in range(1, 6) if part == "toe")
            led = source_chains.get((side, "toe")) or next(filter(None, toes), None)
        if led is None and (side, part) in (("", "root"), ("", "hips")):
            other = ("", "hips" if part == "root" else "root")
            led = None if other in chains else source_chains.get(other)
        if led:
            # Of several bones called hips the first one carries the body.
            first = part == "hips" and len(led) != len(chain)
            pairs |= _along(target, chain, source, led[:1] if first else led)
    return dict(sorted(pairs.items()))


def _chains(skeleton: Skeleton, names: Sequence[str]) -> dict[tuple[str, str], list[int]]:
    """Bones by side and part, in each a path down the hierarchy."""
    parsed = [_parsed(name) for name in names]
    present: dict[str, set[str]] = {
        side: {name.part for name, *_ in parsed if name.side == side} for side in ("", "l", "r")
    }
    groups: dict[tuple[str, str], dict[tuple, int]] = {}
    for bone, ((side, part, numbers), own, twists) in enumerate(parsed):
        part = _settled(part, present[side]) if side else part
        if not part:
            continue
        group = groups.setdefault((side, part), {})
        # Of bones that differ in marks alone, `__Clavicle_L` and `Clavicle_L`, the plainest is meant.
        key = (twists, own, *numbers)
        if key not in group or len(names[bone]) < len(names[group[key]]):
            group[key] = bone
    place = np.empty(len(names), dtype=np.int64)
    place[bone_order(skeleton.P)] = np.arange(len(names))
    chains = {}
    for key, group in groups.items():
        # A piece that only twists stands for its bone where there is no other.
        plain = [bone for (twists, *_), bone in group.items() if not twists]
        members = set(plain or group.values())
        deepest = max(members, key=lambda b: (place[b], -b))
        chains[key] = [bone for bone in (deepest, *_above(skeleton.P, deepest)) if bone in members][::-1]
    return _with_roles(skeleton, chains)


def _above(P: np.ndarray, bone: int) -> Iterator[int]:
    while (bone := int(P[bone])) >= 0:
        yield bone


def _with_roles(skeleton: Skeleton, chains: dict[tuple[str, str], list[int]]) -> dict[tuple[str, str], list[int]]:
    """Chains of which one that has no bones called hips, neck or head lends its own, by what hangs on them.

    In Rigify the hips are the first bone of the spine, and neck and head its last ones; in MakeHuman they are the root.
    """
    spine = chains.get(("", "spine"), [])
    legs = [chains[side, "thigh"][0] for side in "lr" if (side, "thigh") in chains]
    arms = [chains[side, part][0] for side in "lr" for part in ("upperarm", "clavicle") if (side, part) in chains]
    if legs and ("", "hips") not in chains:
        central = [*chains.get(("", "root"), []), *spine]
        hold = {next((bone for bone in _above(skeleton.P, leg) if bone in central), -1) for leg in legs}
        if hold == set(chains.get(("", "root"), [])[-1:]):
            chains[("", "hips")] = chains.pop(("", "root"))
        elif len(spine) > 1 and hold == {spine[0]}:
            chains |= {("", "hips"): spine[:1], ("", "spine"): (spine := spine[1:])}
    if arms and not {("", "neck"), ("", "head")} & chains.keys():
        last = max((spine.index(bone) for arm in arms for bone in _above(skeleton.P, arm) if bone in spine), default=-1)
        if 0 <= last < len(spine) - 1:
            *neck, head = spine[last + 1 :]
            chains |= {("", "spine"): spine[: last + 1], ("", "head"): [head]} | ({("", "neck"): neck} if neck else {})
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
