"""Skeletons: joints, the bones between them, their parents and names."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nilbs.geometry.kinematics import bone_order, bone_parents
from nilbs.geometry.plane import flattened, in_space, is_flat
from nilbs.geometry.validation import arrays, check_indices


@dataclass(frozen=True)
class Skeleton:
    """Bones of a character at rest.

    Attributes
    ----------
    C : (k, d) float array
        Joints at rest, in mesh units; d is 2 or 3.
    BE : (b, 2) int array
        First and second joint of every bone, indices into C; the same joint twice for a bone without length. A bone
        turns about its first joint.
    P : (b,) int array
        Parent bones, -1 at a root. The parent need not end where the bone starts.
    names : tuple of b str
        Each different.
    forks : (f, 2) int array
        A bone, and a joint that moves with it besides its two own: rigs whose bones are joints let a bone lead to
        several children at once. Only the weights' solver uses it.

    Raises
    ------
    ValueError
        If sizes disagree, an index does not exist, bones form a cycle or a name is used twice.

    Examples
    --------
    >>> Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("upper", "lower")).d
    2
    """

    C: np.ndarray
    BE: np.ndarray
    P: np.ndarray
    names: tuple[str, ...]
    forks: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    def __post_init__(self) -> None:
        checked = arrays(
            C=(self.C, "k d"), BE=(self.BE, "b 2", "C"), P=(self.P, "b", int), forks=(self.forks, "f 2", int)
        )
        for name, value in zip(("C", "BE", "P", "forks"), checked, strict=True):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "names", tuple(self.names))
        b = len(self.BE)
        if not b:
            raise ValueError("the rig has no bone")
        check_indices("forks[:, 0]", self.forks[:, :1], b, "bones")
        check_indices("forks[:, 1]", self.forks[:, 1:], len(self.C), "joints")
        bone_order(self.P)
        if len(self.names) != b:
            raise ValueError(f"names must be (b,) = ({b},), got ({len(self.names)},)")
        if len(set(self.names)) < b:
            twice = next(name for i, name in enumerate(self.names) if name in self.names[:i])
            raise ValueError(f"two bones have the name {twice!r}")

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.C.shape[1]

    def in_space(self) -> "Skeleton":
        """The skeleton in three dimensions; a planar one at z = 0."""
        return replace(self, C=in_space(self.C))

    def in_plane(self) -> "Skeleton":
        """A flat skeleton in two dimensions; ValueError if a joint leaves the plane z = 0."""
        if not is_flat(self.C):
            joint = int(np.abs(self.C[:, 2]).argmax())
            raise ValueError(f"the mesh is flat (z = 0) but joint {joint} of the rig is not")
        return replace(self, C=flattened(self.C))

    @property
    def points(self) -> np.ndarray:
        """The bones that are point handles: roots without length, children and forks."""
        holds = np.isin(np.arange(len(self.P)), [*self.P.tolist(), *self.forks[:, 0].tolist()])
        return np.flatnonzero((self.BE[:, 0] == self.BE[:, 1]) & (self.P < 0) & ~holds)

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Line segments that move with bones: joints (s, 2), and the bone (s,) of each.

        The first b are the bones' own, the others the forks.
        """
        forked = np.stack([self.BE[self.forks[:, 0], 0], self.forks[:, 1]], axis=1)
        return np.concatenate([self.BE, forked]), np.concatenate([np.arange(len(self.BE)), self.forks[:, 0]])


def skeleton_of_bones(C: np.ndarray, BE: np.ndarray) -> Skeleton:
    """Skeleton of a rig without names or parents, as TGF files hold them.

    Parameters
    ----------
    C : (k, d) float array
        Joints.
    BE : (b, 2) int array
        Bones; one follows another where it begins at the other's end. A joint of no other bone, twice, is a point
        handle.

    Returns
    -------
    skeleton : Skeleton
        Bones are called bone0, bone1, ..., point handles point0, point1, ...

    Raises
    ------
    ValueError
        As `Skeleton` and `nilbs.geometry.kinematics.bone_parents`.

    Examples
    --------
    >>> s = skeleton_of_bones([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]])
    >>> s.names, s.P.tolist()
    (('bone0', 'bone1'), [-1, 0])
    """
    (BE,) = arrays(BE=(BE, "b 2", int))
    ends, times = np.unique(BE, return_counts=True)
    # A joint that is a point handle stands in its own row, twice, and in no other.
    point = (BE[:, 0] == BE[:, 1]) & (times[np.searchsorted(ends, BE[:, 0])] == 2)
    bones = np.flatnonzero(~point)
    parents = bone_parents(BE[bones])
    P = np.full(len(BE), -1)
    P[bones] = np.where(parents >= 0, bones[parents], -1)
    number = np.where(point, np.cumsum(point), np.cumsum(~point)) - 1
    names = [f"{'point' if is_point else 'bone'}{k}" for is_point, k in zip(point, number.tolist(), strict=True)]
    return Skeleton(C, BE, P, tuple(names))


def skeleton_of_joints(
    positions: np.ndarray,
    parents: np.ndarray,
    names: Sequence[str],
    *,
    ends: dict[int, np.ndarray] | None = None,
) -> Skeleton:
    """Skeleton of a rig whose bones are its joints, as RigNet, glTF, BVH and SMPL write them.

    Parameters
    ----------
    positions : (b, d) float array
        Joints, each the first joint of one bone.
    parents : (b,) int array
        Parent of every joint, -1 at a root.
    names : sequence of b str
    ends : dict of int to (d,) float array, optional
        Where bones end that lead to no child, or that do not end at one; joint to position.

    Returns
    -------
    skeleton : Skeleton
        Bone j starts at joint j. It ends at its end, where one is given; else at the child with the longest chain of
        bones below it, the first of equals, and its other children are forks; else, without a child, where it starts.

    Raises
    ------
    ValueError
        As `Skeleton`.

    Examples
    --------
    >>> s = skeleton_of_joints([[0, 0], [1, 0], [0, 1], [0, 2]], [-1, 0, 0, 2], ["hip", "left", "up", "head"])
    >>> s.BE.tolist(), s.forks.tolist()
    ([[0, 2], [1, 1], [2, 3], [3, 3]], [[0, 1]])
    """
    positions, parents = arrays(positions=(positions, "b d"), parents=(parents, "b", int))
    ends = ends or {}
    order = bone_order(parents)
    chain = np.zeros(len(parents), dtype=np.int64)
    for joint in order[::-1]:
        if parents[joint] >= 0:
            chain[parents[joint]] = max(chain[parents[joint]], chain[joint] + 1)
    BE = np.repeat(np.arange(len(parents))[:, None], 2, axis=1)
    forks: list[tuple[int, int]] = []
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0:
            children.setdefault(parent, []).append(joint)
    C = [*positions]
    for joint, below in children.items():
        main = None if joint in ends else max(below, key=lambda child: chain[child])
        if main is not None:
            BE[joint, 1] = main
        forks += [(joint, child) for child in below if child != main]
    for joint, end in ends.items():
        BE[joint, 1] = len(C)
        C.append(np.asarray(end, dtype=np.float64))
    return Skeleton(
        np.array(C).reshape(-1, positions.shape[1]),
        BE,
        parents,
        tuple(names),
        np.array(forks, dtype=np.int64).reshape(-1, 2),
    )
