"""Motions of one skeleton on another: other proportions, another rest pose, other axes, more bones or fewer."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from nilbs.geometry.bone_names import matching_bones
from nilbs.geometry.kinematics import bone_order, forward_kinematics
from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.reference_pose import ReferencePose, reference_pose, up_and_forward
from nilbs.geometry.rotations import nearest_rotations, rotation_vectors, transform_points
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays, listed

# A bone is a limb if all that hangs from it lies in this cone, and it is so long that its direction depends on the pose
# and not on where in the flesh the joints were placed.
_CONE = np.cos(np.radians(60))
_LIMB = 1 / 8  # of the longest way along bones
_ASKEW = np.radians(60)  # bodies whose axes agree, and that still point so far apart, are of other kinds
_LEAN = np.radians(30)  # a leg that leans less is no reason to tilt its foot
_ASTRAY = 0.3  # of the longest way from the topmost joint: bones of like names that differ more are not the same
_FAR = 1 / 4  # of the longest way: a start that is farther from the rest pose is no part of the motion


@dataclass(frozen=True)
class Retargeted:
    """A motion on another skeleton.

    B (t, b, d+1, d+1) are the target's transforms, rest to posed; `reference` the source's pose that corresponds to the
    target's rest pose; `scale` a length of the target over that of the source. Along the target's axes `from_first`
    (d,) the first frame is so far from the source's rest pose that translation does not count from there: the lowest
    joint of that frame is put where the lowest joint at rest is.
    """

    B: np.ndarray
    reference: ReferencePose
    scale: float
    from_first: np.ndarray


def retarget(
    source: Skeleton,
    B: np.ndarray,
    target: Skeleton,
    bone_map: Mapping[str, str | None],
    *,
    reference: ReferencePose | None = None,
) -> Retargeted:
    """Move a skeleton as another one moves.

    Parameters
    ----------
    source : Skeleton
        Whose motion is known.
    B : (t, b', d+1, d+1) float array
        Transforms of its b' bones, rest to posed; what they scale is left out.
    target : Skeleton
        With b bones.
    bone_map : mapping of str to str or None
        For bones of the target, by name, the bones of the source that they follow; several may follow one. Bones
        without one keep their rest pose relative to the nearest bone above that has one; above all of these, they turn
        with one from which more than half of all bones hang, else not at all.
    reference : ReferencePose, optional
        The source's pose that corresponds to the target's rest pose; by default that of
        `nilbs.geometry.reference_pose.reference_pose`.

    Returns
    -------
    retargeted : Retargeted
        Its joints stay together: bones only turn, and the roots move.

    Raises
    ------
    ValueError
        If sizes disagree, a bone does not exist, or no bone follows another.

    Notes
    -----
    The source is first turned into the target's axes, and its reference pose becomes its rest pose. A mapped bone then
    has the rotation R = R_source A in the world. A
    reconciles the rest poses: it turns the bone from the target's rest pose to that of the source, without twist. It is
    the alignment of the bone above, followed, for a limb, by the least rotation that takes its direction, from its
    joint to the next mapped ones, to that of the source. Torso, hands, feet and head are no limbs: their joints' places
    vary more between rigs than their rest poses do. Below a leg, which hangs down at rest, that is aligned by less than
    30 degrees, a bone is aligned from its rest pose, so that legs that stand apart do not tilt the soles.

    The roots' translation is chosen such that the joints next to the topmost mapped bone, as legs and spine are next to
    the hips, move as far on average as those of the source, times the ratio of the summed lengths of mapped bones.
    Where there is but one, the bone's own joint does. A bone that the source's body slides away from, such as a root
    that stays where it is while the hips walk, is not the topmost here; see
    `nilbs.geometry.reference_pose.travelling_bone`.

    Examples
    --------
    >>> source = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))
    >>> target = Skeleton([[0, 0], [0, -3], [0, -6]], [[0, 1], [1, 2]], [-1, 0], ("a", "b"))
    >>> B = forward_kinematics(source.C, source.BE, source.P, [[[0.0], [np.pi / 2]]])
    >>> moved = retarget(source, B, target, {"a": "upper", "b": "lower"})
    >>> (moved.B[0, 1] @ [0, -6, 1]).round(6)  # turned into the source's axes by a quarter turn, the lower bone bends
    array([ 3., -3.,  1.])
    """
    (B,) = arrays(B=(B, f"t {len(source.BE)} d+1 d+1"))
    d = target.d
    if not source.d == B.shape[-1] - 1 == d:
        raise ValueError(f"the motion has {source.d} dimensions, but the skeleton that is to follow it has {d}")
    follows = followed_bones(source, target, bone_map)
    mapped = np.flatnonzero(follows >= 0)
    if reference is None:
        reference = reference_pose(source, B, target, follows)
    source, B, axes = reference.skeleton(source), reference.from_it(B), reference.axes
    start, source_start = target.C[target.BE[:, 0]], source.C[source.BE[:, 0]]
    tree = _MappedTree(target.P, follows, start, source_start @ axes.T, reference.travels)
    scale = tree.scale()
    A = tree.alignments(-up_and_forward(target)[0])

    R_source = axes @ nearest_rotations(B[:, follows[mapped], :d, :d]) @ axes.T
    R = np.empty((len(B), len(start), d, d))
    R[:, mapped] = R_source @ A[mapped]
    for bone in bone_order(target.P):
        if follows[bone] < 0:
            with_it = target.P[bone] if tree.above[bone] >= 0 else tree.body
            R[:, bone] = R[:, with_it] if with_it >= 0 else np.eye(d)
    parent_R = np.where((target.P >= 0)[:, None, None], R[:, target.P], np.eye(d))
    theta = rotation_vectors(np.swapaxes(parent_R, -1, -2) @ R)
    still = forward_kinematics(target.C, target.BE, target.P, theta)

    anchors = tree.below(tree.travels) if len(tree.below(tree.travels)) > 1 else [tree.travels]
    anchor = transform_points(still[:, anchors], start[anchors]).mean(axis=1) - start[anchors].mean(axis=0)
    led = follows[[tree.travels, *anchors]]
    went = scale * (transform_points(B[:, led], source_start[led]) - source_start[led]) @ axes.T
    from_first = np.abs(went[:1, 0]).max(axis=0, initial=0) > (_FAR * tree.longest() or np.inf)
    moved = went[:, 1:].mean(axis=1) - anchor
    if from_first.any():
        lowest = (transform_points(still[0], start) + moved[0]).min(axis=0)
        moved = moved + np.where(from_first, start.min(axis=0) - lowest, 0.0)
    posed = forward_kinematics(target.C, target.BE, target.P, theta, root_translation=moved)
    return Retargeted(posed, reference, scale, from_first)


def guess_bone_map(source: Skeleton, target: Skeleton) -> dict[str, str]:
    """Guess which bones of one skeleton follow which of another.

    Parameters
    ----------
    source : Skeleton
        Whose motion is known.
    target : Skeleton
        Which is to move.

    Returns
    -------
    bone_map : dict of str to str
        Bone of the target to bone of the source, for those that have one, in the order of the target.

    Raises
    ------
    ValueError
        If no names agree.

    Notes
    -----
    Bones are matched by their names, see `nilbs.geometry.bone_names`. Of those, a pair is left out where the
    two lie at other places in their bodies: where the ways along the bones from the topmost of them, at the median
    ratio of such ways, differ by more than 0.3 of the longest. So is a pair where the hierarchy is upside down: a bone
    would follow one above that which its own ancestor follows.

    Examples
    --------
    >>> source = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("UpArm_L", "LoArm_L"))
    >>> target = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upperarm.L", "lowerarm.L"))
    >>> guess_bone_map(source, target)
    {'upperarm.L': 'UpArm_L', 'lowerarm.L': 'LoArm_L'}
    """
    pairs = matching_bones(source, target)
    if pairs:
        mine, theirs = np.array(list(pairs)), np.array(list(pairs.values()))
        way, way_theirs = (w - w.min() for w in (_way_from_root(target)[mine], _way_from_root(source)[theirs]))
        away = (way > 0) & (way_theirs > 0)
        ratio = np.median(way[away] / way_theirs[away]) if away.any() else 1.0
        near = np.abs(way - ratio * way_theirs) <= _ASTRAY * way.max()
        pairs = {bone: led for (bone, led), is_near in zip(pairs.items(), near, strict=True) if is_near}
        above_led = {led: set(_ancestors(source.P, led)) for led in pairs.values()}
        pairs = {
            bone: led
            for bone, led in pairs.items()
            if not any(led in above_led[pairs[up]] for up in _ancestors(target.P, bone) if up in pairs)
        }
    if not pairs:
        raise ValueError(
            f"no bone of the motion has a name like one of the character: the motion moves {listed(source.names)}, the "
            f"character has {listed(target.names)}. Give the pairs in a bone map, a JSON file such as "
            f'{{"{target.names[0]}": "{source.names[0]}"}}'
        )
    return {target.names[bone]: source.names[led] for bone, led in pairs.items()}


def followed_bones(source: Skeleton, target: Skeleton, bone_map: Mapping[str, str | None]) -> np.ndarray:
    """The bone of the source that each bone (b,) of the target follows, -1 for none.

    Examples
    --------
    >>> arm = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower"))
    >>> followed_bones(arm, arm, {"lower": "upper", "upper": None})
    array([-1,  0])
    """
    follows = np.full(len(target.BE), -1)
    numbers = {name: bone for bone, name in enumerate(source.names)}
    own = {name: bone for bone, name in enumerate(target.names)}
    for name, led in bone_map.items():
        if name not in own:
            meant = nearest_name(name, own)
            raise ValueError(f"the bone map names {name!r}, but the character has no such bone{meant}")
        if led is not None and led not in numbers:
            meant = nearest_name(led, numbers)
            raise ValueError(f"the bone map lets {name!r} follow {led!r}, but the motion has no such bone{meant}")
        follows[own[name]] = -1 if led is None else numbers[led]
    if (follows < 0).all():
        raise ValueError("no bone of the character follows a bone of the motion")
    return follows


def least_rotation(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotation of the least angle that takes one direction (d,) to another; a half turn if they are opposite."""
    u, v = arrays(u=(u, "d"), v=(v, "d"))
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    half = u + v
    if np.linalg.norm(half) < 1e-9:
        half = np.eye(len(u))[np.abs(u).argmin()]
        half = half - u * (u @ half)
    half = half / np.linalg.norm(half)
    # Two reflections: u to -u, and on to v.
    return (np.eye(len(u)) - 2 * np.outer(half, half)) @ (np.eye(len(u)) - 2 * np.outer(u, u))


class _MappedTree:
    """The mapped bones of the target as a forest, where neighbours that follow one bone are one: the first of them."""

    def __init__(
        self, P: np.ndarray, follows: np.ndarray, start: np.ndarray, source_start: np.ndarray, travels: int
    ) -> None:
        self.follows, self.start, self.source_start = follows, start, source_start
        self.above = np.full(len(P), -1)  # the nearest mapped bone above
        self.head = np.arange(len(P))  # of the bones that follow one bone together
        self.heads: list[int] = []  # parents first
        for bone in bone_order(P).tolist():
            if P[bone] >= 0:
                self.above[bone] = P[bone] if follows[P[bone]] >= 0 else self.above[P[bone]]
            if follows[bone] < 0:
                continue
            above = self.above[bone]
            if above >= 0 and follows[above] == follows[bone]:
                self.head[bone] = self.head[above]
            else:
                self.heads.append(bone)
        # That the body moves with, and the bones above it, whose lengths the motion changes.
        self.travels = next((head for head in self.heads if follows[head] == travels), self.heads[0])
        self.sliding = {self.travels}
        self._below: dict[int, list[int]] = {}
        for bone in self.heads:
            if self.above[bone] >= 0:
                self._below.setdefault(self.parent(bone), []).append(bone)
        hang = np.ones(len(P), dtype=int)
        for bone in bone_order(P)[::-1]:
            if P[bone] >= 0:
                hang[P[bone]] += hang[bone]
        # The topmost mapped bone that carries the body; -1 where only limbs are mapped.
        tops = [head for head in self.heads if self.parent(head) < 0 and 2 * hang[head] > len(P)]
        self.body = tops[0] if tops else -1
        above = self.parent(self.travels)
        while above >= 0:
            self.sliding.add(above)
            above = self.parent(above)

    def parent(self, head: int) -> int:
        above = self.above[head]
        return int(self.head[above]) if above >= 0 else -1

    def below(self, head: int) -> list[int]:
        return self._below.get(head, [])

    def joints(self, heads: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Joints of the target and of the source, in the target's axes."""
        return self.start[heads], self.source_start[self.follows[heads]]

    def scale(self) -> float:
        """Summed lengths of the target over those of the source."""
        inner = [head for head in self.heads if self.parent(head) >= 0 and head not in self.sliding]
        x, x_source = self.joints(inner)
        y, y_source = self.joints([self.parent(head) for head in inner])
        length, length_source = np.linalg.norm(x - y, axis=1).sum(), np.linalg.norm(x_source - y_source, axis=1).sum()
        return float(length / length_source) if length > 0 and length_source > 0 else 1.0

    def longest(self) -> float:
        """Longest way along mapped bones of the target."""
        way: dict[int, float] = {}
        for head in self.heads:
            parent = self.parent(head)
            length = float(np.linalg.norm(self.start[head] - self.start[parent]))
            way[head] = way[parent] + length if parent >= 0 and head not in self.sliding else 0
        return max(way.values())

    def alignments(self, down: np.ndarray) -> np.ndarray:
        """Rotations (b, d, d) from the target's rest pose to that of the source."""
        d = self.start.shape[1]
        A = np.broadcast_to(np.eye(d), (len(self.start), d, d)).copy()
        limbs = self._limbs()
        for head in self.heads:
            parent = self.parent(head)
            is_leg = parent in limbs and _angle(limbs[parent][0], down) < _LEAN
            if parent >= 0 and not (is_leg and np.linalg.norm(rotation_vectors(A[parent])) <= _LEAN):
                A[head] = A[parent]
            if head in limbs:
                direction, direction_source = limbs[head]
                if head == self.body and _angle(direction, direction_source) > _ASKEW:
                    continue
                A[head] = least_rotation(A[head] @ direction, direction_source) @ A[head]
        return A[self.head]

    def _limbs(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """The limbs' directions in the target and in the source."""
        found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        hanging: dict[int, list[int]] = {head: [] for head in self.heads}
        for head in self.heads:
            parent = self.parent(head)
            while parent >= 0:
                hanging[parent].append(head)
                parent = self.parent(parent)
        scale, shortest = self.scale(), _LIMB * self.longest()
        for head in self.heads:
            if not self.below(head):
                continue
            origins = self.joints([head])
            ways, rays = [], []
            for next_, all_, origin in zip(
                self.joints(self.below(head)), self.joints(hanging[head]), origins, strict=True
            ):
                ways.append(next_.mean(axis=0) - origin[0])
                rays.append(all_ - origin)
            lengths = np.linalg.norm(ways[0]), scale * np.linalg.norm(ways[1])
            if min(lengths) < max(shortest, 1e-300):
                continue
            if all(_in_cone(way, ray) for way, ray in zip(ways, rays, strict=True)):
                found[head] = ways[0], ways[1]
        return found


def _angle(u: np.ndarray, v: np.ndarray) -> float:
    return float(np.arccos(np.clip(u @ v / (np.linalg.norm(u) * np.linalg.norm(v)), -1, 1)))


def _in_cone(axis: np.ndarray, rays: np.ndarray) -> bool:
    return bool((rays @ axis >= _CONE * np.linalg.norm(rays, axis=1) * np.linalg.norm(axis)).all())


def _way_from_root(skeleton: Skeleton) -> np.ndarray:
    """Length along the bones from the root to every bone's first joint."""
    start = skeleton.C[skeleton.BE[:, 0]]
    way = np.zeros(len(start))
    for bone in bone_order(skeleton.P):
        parent = skeleton.P[bone]
        if parent >= 0:
            way[bone] = way[parent] + np.linalg.norm(start[bone] - start[parent])
    return way


def _ancestors(P: np.ndarray, bone: int) -> Iterator[int]:
    while (bone := int(P[bone])) >= 0:
        yield bone
