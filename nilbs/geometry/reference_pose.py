"""The pose of a motion's skeleton that corresponds to another skeleton's rest pose.

In many files that is the rest pose. In others bones lie along an axis at rest, or the root is turned; then a frame of
the motion takes its place, such as the T-pose in which captures begin.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from nilbs.geometry.bone_names import bone_name
from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.rotations import nearest_rotations, rigid_transforms, rotation_vectors, transform_points
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays

# Of two shapes the part of one that no rotation, scale and move explains by the other: 0 the same, 1 nothing alike.
# T, A and I-poses of people differ by up to a half.
_UNLIKE, _SAME = 0.6, 0.02
# A capture that begins with a T-pose does so in these frames; a later one must be so much more alike.
_FIRST, _MORE = 30, 0.5
# A body that is turned less in the reference frame stands as at rest; one tilted by more in most frames lies at rest.
_TURNED, _TILTED = np.radians(15), np.radians(60)
# The head is above the feet within this angle of the up that the joints' places show; else the bodies are not alike.
_ASKEW = np.radians(45)
_SLIDES = 1e-3  # of the size of the skeleton: a joint that moves more relative to the bone above is not fixed to it
_AXES = "xyz"


@dataclass(frozen=True)
class ReferencePose:
    """The pose of a source that corresponds to a target's rest pose.

    Attributes
    ----------
    frame : int or None
        The frame of the motion that it was taken from; None is the source's own rest pose.
    pose : (b', d+1, d+1) float array
        Rigid transforms of the source's bones, rest to reference: the frame's, turned upright, the joint of
        `travelling_bone` where it is at rest.
    axes : (d, d) float array
        Rotation by quarter turns from the source's axes to the target's.
    unlike : bool
        Whether neither the rest pose nor a frame is like the target's rest pose.
    travels : int
        The bone of the source whose joint shows where the body goes, see `travelling_bone`; -1 is the topmost one that
        is followed.
    """

    frame: int | None
    pose: np.ndarray
    axes: np.ndarray
    unlike: bool = False
    travels: int = -1

    def skeleton(self, source: Skeleton) -> Skeleton:
        """The source with this pose as its rest pose."""
        C = source.C.copy()
        for end in (1, 0):  # a joint at which bones begin goes with these
            joints = source.BE[:, end]
            C[joints] = transform_points(self.pose, source.C[joints])
        return Skeleton(C, source.BE, source.P, source.names)

    def from_it(self, B: np.ndarray) -> np.ndarray:
        """Transforms (..., b', d+1, d+1) from this pose, of such from the rest pose."""
        return B @ np.linalg.inv(self.pose)


def reference_pose(
    source: Skeleton,
    B: np.ndarray,
    target: Skeleton,
    follows: np.ndarray,
    *,
    rest_frame: int | None = None,
    up: str | None = None,
    forward: str | None = None,
) -> ReferencePose:
    """Find the pose of a motion's skeleton that corresponds to another skeleton's rest pose.

    Parameters
    ----------
    source, target : Skeleton
        Whose motion is known, and who is to follow it.
    B : (t, b', d+1, d+1) float array
        Transforms of the source's bones, rest to posed.
    follows : (b,) int array
        The bone of the source that each bone of the target follows, -1 for none.
    rest_frame : int, optional
        This frame is the reference, counted from 0; -1 is the source's rest pose. Found by default.
    up, forward : str, optional
        The axis of the source, such as "z" or "-y", that points up, and to where the body looks. Found by default.

    Returns
    -------
    reference : ReferencePose

    Raises
    ------
    ValueError
        If the motion has no such frame, an axis is none, or one is named for motion in the plane.

    Notes
    -----
    Shapes are compared by the Procrustes distance of the joints that follow each other, free of place, size and
    rotation. If the source's rest pose is unlike that of the target, the first frame is taken if it is alike, else the
    frame that is most. If one of the first frames holds the rest pose turned, as where an exporter turned the root,
    that frame is taken; if the body lies at rest and not in most frames, the rest pose is set upright. There, up is
    the axis nearest to where the body has its head, and where the body looks stays as in the file.

    Bodies of another kind, such as a person and a spider, may follow each other by a map, and places of joints then do
    not show what is up. Where the source's names show head, feet and sides, its head is above its feet: if the places
    contradict that, names decide up and forward. If its rest pose then does not stand and it is unlike the target, the
    first frame is taken.
    """
    d, mapped = target.d, np.flatnonzero(follows >= 0)
    led = follows[mapped]
    x_target, x_rest = _starts(target)[mapped], _starts(source)[led]
    x = transform_points(B[:, led], x_rest)
    if rest_frame is not None and not -1 <= rest_frame < len(B):
        raise ValueError(f"the rest frame must be one of 0 to {len(B) - 1}, or -1 for the rest pose, got {rest_frame}")
    rises, looks = up_and_forward(target)
    frame, unlike = _found(x, x_rest, x_target) if rest_frame is None else (rest_frame, False)
    turns = quarter_turns(d)
    for name, own in ((up, rises), (forward, looks)):
        if name is not None:
            if d == 2:
                raise ValueError("up and forward are axes of a motion in space, and the character is flat")
            axis = _axis(name)
            turns = [R for R in turns if (R @ axis == own).all()]
    if not turns:
        raise ValueError(f"up and forward must be two axes that are perpendicular, got {up!r} and {forward!r}")
    travels = travelling_bone(source, B, led)
    pose = np.tile(np.eye(d + 1), (len(source.BE), 1, 1))
    rest_axes = _named_axes(source, _starts(source))
    stands = rest_axes is None or rest_axes[:, 0] @ _usual_up(source, B) >= np.cos(_TILTED)
    Q = nearest_rotation(x_target, x_rest)
    contradicted = rest_axes is not None and (unlike or len(led) <= d or _askew(Q, rises, rest_axes))
    if rest_frame is None and frame < 0 and len(B) and not stands and contradicted:
        frame, unlike = 0, False
    if frame >= 0:
        pose[:] = B[frame]
    elif rest_frame is None and not unlike and not contradicted:
        pose[:, :d, :d] = _tilt(x, x_rest, Q @ rises)
    by_name = contradicted and frame < 0 and rest_frame is None and up is None and forward is None
    if frame < 0 and (pose == np.eye(d + 1)).all() and not by_name:
        axes = _best(turns, x_rest, x_target)
        if up is None and forward is None and rest_axes is not None and _askew(axes.T, rises, rest_axes):
            axes = _nearest_turn(turns, np.stack([rises, looks], axis=1) @ rest_axes.T)
        return ReferencePose(None, pose, axes, unlike, travels)
    reference = transform_points(pose[led], x_rest)
    Q = nearest_rotation(x_target, reference)
    named = _named_axes(source, transform_points(pose, _starts(source)))
    if named is not None and (by_name or _askew(Q, rises, named)):
        Q = _frame(named) @ _frame(np.stack([rises, looks], axis=1)).T
    if up is None and d == 3:
        turns = [R for R in turns if (R @ _nearest_axis(Q @ rises) == rises).all()] or turns
    axes = turns[0] if d == 3 else _best(turns, reference, x_target)
    leans = axes @ Q
    if np.linalg.norm(rotation_vectors(leans[None])) <= _TURNED:
        leans = np.eye(d)
    # In the source's axes.
    back = axes.T @ leans.T @ axes
    starts = _starts(source)
    turn = back @ nearest_rotations(pose[:, :d, :d])
    placed = transform_points(pose, starts)
    places = (placed - placed[travels]) @ back.T + starts[travels]
    upright = rigid_transforms(turn, places - (turn @ starts[..., None])[..., 0])
    return ReferencePose(frame if frame >= 0 else None, upright, axes, unlike, travels)


def travelling_bone(source: Skeleton, B: np.ndarray, led: np.ndarray) -> int:
    """The bone among those that are followed whose joint shows where the body goes.

    It is the topmost, unless one alone follows below it and slides there, as hips do below a root that stays behind.

    Examples
    --------
    >>> s = Skeleton([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [-1, 0], ("root", "hips"))
    >>> B = np.tile(np.eye(3), (2, 2, 1, 1))
    >>> B[1, 1, 0, 2] = 5
    >>> travelling_bone(s, B, np.array([0, 1])), travelling_bone(s, B[:1], np.array([0, 1]))
    (1, 0)
    """
    followed, starts = set(led.tolist()), _starts(source)
    below: dict[int, list[int]] = {}
    for bone in bone_order(source.P).tolist():
        if bone in followed:
            above = int(source.P[bone])
            while above >= 0 and above not in followed:
                above = int(source.P[above])
            below.setdefault(above, []).append(bone)
    top = bone = below[-1][0]
    while len(below.get(bone, [])) == 1:
        (next_,) = below[bone]
        with_it, own = (transform_points(B[:, which], starts[[next_]])[:, 0] for which in ([bone], [next_]))
        slides = np.linalg.norm(np.ptp(own - with_it, axis=0)) if len(B) else 0.0
        if slides > _SLIDES * np.linalg.norm(np.ptp(starts, axis=0)):
            top = next_
        bone = next_
    return top


def quarter_turns(d: int) -> list[np.ndarray]:
    """The rotations (d, d) by quarter turns, by angle."""
    turns = [np.eye(d)[list(order)] * signs for order in permutations(range(d)) for signs in product((1, -1), repeat=d)]
    return sorted((R for R in turns if np.linalg.det(R) > 0), key=lambda R: -np.trace(R))


def quarter_turns_between(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rotation R (d, d) by quarter turns that brings points x (n, d) nearest to y, whatever their sizes and places.

    Of equally good ones that of the least angle.
    """
    x, y = arrays(x=(x, "n d"), y=(y, "n d"))
    return _best(quarter_turns(x.shape[1]), x, y)


def procrustes_distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How unlike points x (..., n, d) are to points y (n, d) up to a similarity, from 0 to 1.

    Notes
    -----
    The full Procrustes distance [1]_: the root of the part of the summed squares that the best move, rotation and scale
    leave.

    References
    ----------
    .. [1] Kendall, Shape manifolds, Procrustean metrics, and complex projective spaces, 1984.

    Examples
    --------
    >>> x = np.array([[0.0, 0], [1, 0], [0, 2]])
    >>> procrustes_distance(3 * x @ [[0, 1], [-1, 0]] + 5, x).round(6)
    np.float64(0.0)
    """
    x, y = _centred(x), _centred(y)
    u, s, v = np.linalg.svd(np.swapaxes(x, -1, -2) @ y)
    s[..., -1] *= np.where(np.linalg.det(u @ v) < 0, -1, 1)
    return np.sqrt(np.maximum(1 - s.sum(axis=-1) ** 2, 0))


def nearest_rotation(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rotation (..., d, d) that takes points x (n, d) nearest to points y (..., n, d), whatever their sizes, places."""
    u, _, v = np.linalg.svd(np.swapaxes(_centred(y), -1, -2) @ _centred(x))
    u[..., -1] *= np.where(np.linalg.det(u @ v) < 0, -1, 1)[..., None]
    return u @ v


def _found(x: np.ndarray, x_rest: np.ndarray, x_target: np.ndarray) -> tuple[int, bool]:
    """The frame that is the reference, -1 for the rest pose, and whether nothing is alike."""
    rest = procrustes_distance(x_rest, x_target)
    if not len(x) or len(x_rest) <= x_rest.shape[1]:
        return -1, False  # so few points are like any others
    if rest <= _UNLIKE:
        return _turned_rest(x, x_rest), False
    unlike = procrustes_distance(x, x_target)
    best = int(unlike.argmin())
    if unlike[0] * _MORE <= unlike[best]:
        best = 0
    return (best, False) if unlike[best] <= _UNLIKE else (-1, True)


def _turned_rest(x: np.ndarray, x_rest: np.ndarray) -> int:
    """The first frame that holds the rest pose turned; -1 if there is none."""
    same = np.flatnonzero(procrustes_distance(x[:_FIRST], x_rest) <= _SAME)
    if not len(same):
        return -1
    turn = rotation_vectors(nearest_rotation(x_rest, x[same[0]])[None])
    return int(same[0]) if np.linalg.norm(turn) > _TURNED else -1


def _tilt(x: np.ndarray, x_rest: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The rotation by quarter turns that takes up at rest to up in the frames, where most differ by much."""
    turns = quarter_turns(len(up))
    rises = nearest_rotation(x_rest, x) @ up
    if len(up) == 2 or not len(x) or np.median(rises @ up) >= np.cos(_TILTED):
        return turns[0]
    there, here = _nearest_axis(np.median(rises, axis=0)), _nearest_axis(up)
    return next(R for R in turns if (R @ here == there).all())


def _named_axes(skeleton: Skeleton, x: np.ndarray) -> np.ndarray | None:
    """Up and forward (..., 3, 2) of a body with joints x (..., b, 3), where its names show head, feet and sides."""
    names = [bone_name(name) for name in skeleton.names]
    chosen = [[name.part in parts for name in names] for parts in (("head", "neck"), ("foot", "shin"))]
    chosen += [[name.side == side for name in names] for side in "lr"]
    if skeleton.d == 2 or not all(map(any, chosen)):
        return None
    head, foot, left, right = (x[..., those, :].mean(axis=-2) for those in chosen)
    axes = np.stack([head - foot, np.cross(left - right, head - foot)], axis=-1)
    length = np.linalg.norm(axes, axis=-2, keepdims=True)
    return axes / length if length.min() > 0 else None


def _usual_up(skeleton: Skeleton, B: np.ndarray) -> np.ndarray:
    """To where the head is from the feet in most frames."""
    axes = _named_axes(skeleton, transform_points(B, _starts(skeleton))) if len(B) else None
    return np.zeros(skeleton.d) if axes is None else np.median(axes[..., 0], axis=0)


def _askew(R: np.ndarray, rises: np.ndarray, named: np.ndarray) -> bool:
    """Whether R takes up to where the head is not."""
    return bool((R @ rises) @ named[:, 0] < np.cos(_ASKEW))


def _frame(axes: np.ndarray) -> np.ndarray:
    """Rotation whose first two columns are up and forward, which is turned until it is level."""
    up, forward = axes.T
    level = forward - up * (up @ forward)
    level = level / np.linalg.norm(level)
    return np.stack([up, level, np.cross(up, level)], axis=1)


def _nearest_turn(turns: list[np.ndarray], H: np.ndarray) -> np.ndarray:
    """The first of the turns that are nearest to H."""
    return max(turns, key=lambda R: round(float((R * H).sum()), 9))


def _starts(skeleton: Skeleton) -> np.ndarray:
    return skeleton.C[skeleton.BE[:, 0]]


def _centred(x: np.ndarray) -> np.ndarray:
    """Points around the origin, their squares summed to one."""
    x = x - x.mean(axis=-2, keepdims=True)
    return x / np.maximum(np.linalg.norm(x, axis=(-1, -2), keepdims=True), 1e-300)


def _best(turns: list[np.ndarray], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The first rotation that brings points x nearest to points y."""
    H = (y - y.mean(axis=0)).T @ (x - x.mean(axis=0))
    fit = np.array([(R * H).sum() for R in turns])
    return turns[int(np.flatnonzero(fit >= fit.max() - 1e-9 * np.abs(H).sum())[0])]


def up_and_forward(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Axes (d,) to where the head is from the feet, and to where the body looks; y and z where names do not show them.

    In the plane they are y and x.
    """
    if skeleton.d == 2:
        return np.array([0.0, 1.0]), np.array([1.0, 0.0])
    starts, names = _starts(skeleton), [bone_name(name) for name in skeleton.names]

    def middle(chosen: list[bool]) -> np.ndarray | None:
        return starts[chosen].mean(axis=0) if any(chosen) else None

    up, forward = _axis("y"), _axis("z")
    head, foot = (middle([name.part in parts for name in names]) for parts in (("head", "neck"), ("foot", "shin")))
    if head is not None and foot is not None:
        up = _nearest_axis(head - foot)
    left, right = (middle([name.side == side for name in names]) for side in "lr")
    if left is not None and right is not None:
        forward = np.cross(_nearest_axis(left - right), up)
    if not forward.any() or forward @ up:
        forward = np.cross(np.roll(up, -1), up)
    return up, forward


def _axis(name: str) -> np.ndarray:
    """The unit vector (3,) of "x", "-z" and the like."""
    letter = name.strip().lower().lstrip("+-")
    if letter not in (*_AXES,):
        raise ValueError(f"an axis is x, y or z, or -x, -y or -z, got {name!r}")
    return np.eye(3)[_AXES.index(letter)] * (-1 if name.strip().startswith("-") else 1)


def _nearest_axis(v: np.ndarray) -> np.ndarray:
    """The unit vector (3,) along the axis nearest to a direction."""
    axis = int(np.abs(v).argmax())
    return np.eye(3)[axis] * (-1 if v[axis] < 0 else 1)
