"""When moving points first touch a body that moves from one pose to another."""

from typing import NamedTuple

import numpy as np

from nilbs.geometry.kinematics import bone_order, interpolate_poses, local_transforms
from nilbs.geometry.rotations import nearest_rotations, rotation_vectors
from nilbs.geometry.validation import arrays
from nilbs.models.model import Model


class Touches(NamedTuple):
    """When points first touch a body.

    Attributes
    ----------
    time : (n,) float array
        The share of the movement from the first pose to the second after which each point may touch; inf where it
        never does.
    point : (n, d) float array
        Where the point is then; nan where it does not touch.
    near : (n,) float array
        How near to the skin, in mesh units, a point comes at least, that counts as touching: no touch is missed.
    """

    time: np.ndarray
    point: np.ndarray
    near: np.ndarray


def first_touches(
    model: Model,
    start: np.ndarray,
    end: np.ndarray,
    pose_start: np.ndarray,
    pose_end: np.ndarray,
    *,
    radius: float | np.ndarray = 0.0,
    resolution: float = 1 / 1024,
) -> Touches:
    """When points that move on straight lines first touch a body that moves between two poses.

    Parameters
    ----------
    model : Model
    start, end : (n, d) float array
        Where points are in the first pose and in the second, in mesh units; between, they move evenly.
    pose_start, pose_end : (b, d+1, d+1) float array
        Bone transforms, rest to posed. Between, local rotations are slerped.
    radius : float or (n,) float array
        Of balls around the points, in mesh units, at least 0. Points on a segment whose balls cover it are a swept
        segment.
    resolution : float
        The shortest share of the movement that is evaluated. A time may be early: what is within `near` touches.

    Returns
    -------
    touches : Touches

    Raises
    ------
    ValueError
        As for all queries, if shapes disagree, a radius is negative, or resolution is not between 0 and 1.

    Notes
    -----
    Conservative advancement [1]_ on common times: the distance to the skin changes no faster than the point and the
    skin together move. So a point that is farther from the skin in the middle of an interval than both can move in half
    of it touches nothing there; where it is not, the halves are searched, the earlier first. The speed of the skin is
    bounded bone by bone, by the turns of all bones above it and the lengths of their arms.

    References
    ----------
    .. [1] Mirtich, Impulse-based dynamic simulation of rigid body systems, 1996, section 2.3.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(radius=0.2, d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> rest = np.tile(np.eye(3), (2, 1, 1))
    >>> first_touches(model, [[1.2, 0.0], [1.2, 0.9]], [[0.2, 0.0], [0.2, 0.9]], rest, rest).time.round(2).tolist()
    [1.0, inf]
    """
    d, skeleton = model.character.d, model.character.skeleton
    start, end = arrays(start=(start, f"n {d}"), end=(end, f"n {d}"))
    b = len(skeleton.BE)
    shape = f"{b} {d + 1} {d + 1}"
    pose_start, pose_end = arrays(pose_start=(pose_start, shape), pose_end=(pose_end, shape))
    if not 0 < resolution <= 1:
        raise ValueError(f"resolution must be above 0 and at most 1, got {resolution}")
    n = len(start)
    (radius,) = arrays(radius=(np.broadcast_to(radius, n) if np.ndim(radius) == 0 else radius, f"{n}"))
    if radius.min(initial=0) < 0:
        raise ValueError(f"radius[{int(radius.argmin())}] is negative")
    speed = np.linalg.norm(end - start, axis=1) + skin_speed(model, pose_start, pose_end)
    levels = int(np.ceil(np.log2(1 / resolution)))
    near = radius + speed * 0.5**levels / 2
    time = np.full(n, np.inf)
    waiting = [(0.0, 0, np.arange(n))]
    while waiting:
        begin, level, rows = waiting.pop()
        rows = rows[np.isinf(time[rows])]  # one that touched in an earlier interval is done
        if not len(rows):
            continue
        half = 0.5**level / 2
        middle = begin + half
        pose = interpolate_poses(skeleton.C, skeleton.BE, skeleton.P, pose_start, pose_end, middle)
        x = start[rows] + middle * (end - start)[rows]
        posed = model.posed(pose)
        distance = posed.surface.distance(x)
        far = np.flatnonzero(distance > radius[rows] + speed[rows] * half)
        close = np.ones(len(rows), dtype=bool)
        close[far] = posed.occupancy(x[far]) > 0.5  # what is deep inside is far from the skin, too
        if level == levels:
            time[rows[close]] = begin
        else:
            waiting += [(middle, level + 1, rows[close]), (begin, level + 1, rows[close])]
    touched = np.isfinite(time)
    point = np.full((n, d), np.nan)
    point[touched] = start[touched] + time[touched, None] * (end - start)[touched]
    return Touches(time, point, near)


def skin_speed(model: Model, pose_start: np.ndarray, pose_end: np.ndarray) -> float:
    """A bound on how far any place of the skin moves in unit time between two poses, in mesh units.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> rest = np.tile(np.eye(3), (2, 1, 1))
    >>> moved = rest.copy()
    >>> moved[:, 0, 2] = 0.25
    >>> round(skin_speed(model, rest, moved), 6)
    0.25
    """
    c, d = model.character, model.character.d
    skeleton = c.skeleton
    local = local_transforms(skeleton.C, skeleton.BE, skeleton.P, np.stack([pose_start, pose_end]))
    A, place = local[..., :d, :d], local[..., :d, d]
    R = nearest_rotations(A)
    S = np.swapaxes(R, -1, -2) @ A
    angle = np.linalg.norm(rotation_vectors(np.swapaxes(R[0], -1, -2) @ R[1]), axis=-1)
    stretch = np.linalg.norm(S, ord=2, axis=(-2, -1)).max(axis=0)
    stretching = np.linalg.norm(S[1] - S[0], ord=2, axis=(-2, -1))
    moved, arm = np.linalg.norm(place[1] - place[0], axis=-1), np.linalg.norm(place, axis=-1).max(axis=0)
    far = np.linalg.norm(c.V[:, None] - skeleton.C[skeleton.BE[:, 0]], axis=-1)
    reach = np.where(c.W > 0, far, 0.0).max(axis=0)
    speed = np.zeros(len(reach))
    # Of the farthest place of each bone, from the bone up to its root.
    for bone in bone_order(skeleton.P).tolist():
        at, fast = reach[bone], 0.0
        above = bone
        while above >= 0:
            fast = moved[above] + (angle[above] * stretch[above] + stretching[above]) * at + stretch[above] * fast
            at = arm[above] + stretch[above] * at
            above = int(skeleton.P[above])
        speed[bone] = fast
    return float((c.W @ speed).max())
