"""What the files share whose bones are their joints: circles of parents, and where bones end."""

from collections.abc import Mapping, Sequence

import numpy as np

from nilbs.geometry.plane import in_space
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints


def joint_in_circle(P: np.ndarray) -> int | None:
    """A joint that is its own ancestor, if there is one.

    Examples
    --------
    >>> joint_in_circle(np.array([1, 2, 1])), joint_in_circle(np.array([-1, 0]))
    (2, None)
    """
    # b steps up lead to no joint, or onto a circle; each round doubles the steps.
    above = np.append(P, -1)
    for _ in range(len(P).bit_length()):
        above = above[above]
    return next((int(joint) for joint in above if joint >= 0), None)


def first_joints(skeleton: Skeleton) -> np.ndarray:
    """Where bones start, in space: (b, 3) float array, with z = 0 for a skeleton of the plane."""
    return in_space(skeleton.C)[skeleton.BE[:, 0]]


def written_ends(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Where bones end (b, 3), and whether a file whose bones are joints has to hold it.

    It has not where `skeleton_of_joints` gives a bone the same end from the first joints and parents alone.
    """
    start = first_joints(skeleton)
    end = in_space(skeleton.C)[skeleton.BE[:, 1]]
    chosen = skeleton_of_joints(start, skeleton.P, skeleton.names)
    return end, (end != chosen.C[chosen.BE[:, 1]]).any(axis=1)


def skeleton_with_ends(
    positions: np.ndarray, parents: np.ndarray, names: Sequence[str], ends: Mapping[int, np.ndarray]
) -> Skeleton:
    """Skeleton of a rig whose bones are joints, some with an end that the file gives.

    An end at the place of a joint without children means only that the bone has no length.
    """
    inner = set(parents.tolist())
    given = {joint: end for joint, end in ends.items() if joint in inner or (end != positions[joint]).any()}
    return skeleton_of_joints(positions, parents, names, ends=given)
