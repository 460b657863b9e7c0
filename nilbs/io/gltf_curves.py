"""The nodes and curves that motions of a skeleton are written as to a glTF file."""

from dataclasses import replace

import numpy as np

from nilbs.geometry.curves import LINEAR, SPLINE, Curve, Curves, channels_of
from nilbs.geometry.kinematics import bone_order, interpolate_poses
from nilbs.geometry.plane import transforms_in_space
from nilbs.geometry.quaternions import quaternions
from nilbs.geometry.rotations import linear_inverses
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays
from nilbs.io.bundle import Clip
from nilbs.io.gltf_pose import rest_rotations, track
from nilbs.io.joints import first_joints

_SAME = 1e-6  # of the size: joints and frames of nodes that differ less are the same
_OFF = 1e-5  # of the size: how far frames may be from the curves that they stand for
_CUTS = 12  # of the time between two frames until they are so near
_PLACE = 0.4  # of a cut between two frames; half-way, a motion that eases in and out is as if it were linear


def written_curves(
    skeleton: Skeleton, clips: list[Clip], offset: np.ndarray, size: float, notes: list[str]
) -> tuple[Curves, list[Curves]]:
    """A tree of nodes that stands at the offset, and curves of it for each clip.

    Clips that all have curves of the same nodes keep them. Else a node stands at each bone's first joint with the axes
    of the world, turned only where a motion stretches the bone along others, and is linear between frames: those of the
    clips, and more where they have curves that would differ.
    """
    for clip in clips:
        _check(clip, skeleton)
    kept = _kept(skeleton, clips, size)
    if kept:
        kept = [_moved(curves, offset) for curves in kept]
        return kept[0], kept
    C, P = first_joints(skeleton), skeleton.P
    frames = [_frames(clip, skeleton, size, notes) for clip in clips]
    motions = []
    for _, B in frames:
        B = B.copy()
        B[..., :3, 3] += (B[..., :3, :3] @ offset) - offset
        motions.append(B)
    joints, Q = C - offset, rest_rotations(P, motions)
    back, root = np.swapaxes(Q, 1, 2), (P < 0)[:, None]
    above = np.where(root[..., None], np.eye(3), back[P])
    inverse = np.tile(np.eye(4), (len(P), 1, 1))
    inverse[:, :3, :3] = back
    inverse[:, :3, 3] = -(back @ joints[:, :, None])[..., 0]
    tree = Curves(
        P,
        translation=(above @ (joints - np.where(root, 0.0, joints[P]))[..., None])[..., 0],
        rotation=quaternions(above @ Q),
        scale=np.ones((len(P), 3)),
        frame=np.tile(np.eye(4), (len(P), 1, 1)),
        bones=np.arange(len(P)),
        inverse=inverse,
    )
    least = {"translation": 1e-7 * size, "rotation": 1e-7, "scale": 1e-7}
    found = []
    for clip, (times, _), B in zip(clips, frames, motions, strict=True):
        move = track(joints, P, Q, B, size=size)
        worst = int(np.argmax(move.off.max(axis=0, initial=0)))
        off = float(move.off[:, worst].max(initial=0)) / size
        if off > 1e-5:
            notes.append(
                f"clip {clip.name!r} shears bones, which glTF cannot hold: {skeleton.names[worst]!r} is off by up to "
                f"{100 * off:.2g} % of the size"
            )
        curves = {
            (bone, part): Curve(times, values[:, bone], LINEAR)
            for part, values in move.parts.items()
            for bone in np.flatnonzero(move.moved[part] > least[part]).tolist()
        }
        found.append(replace(tree, channels=channels_of(curves)))
    return tree, found


def _check(clip: Clip, skeleton: Skeleton) -> None:
    """Refuse a clip of another skeleton, and transforms that are not affine."""
    _, B = arrays(times=(clip.times, "t"), B=(clip.B, f"t {len(skeleton.names)} 4 4"))
    theirs, ours = map(first_joints, (clip.skeleton, skeleton))
    if clip.skeleton.names != skeleton.names or not np.allclose(theirs, ours, rtol=1e-6, atol=1e-6 * np.ptp(ours)):
        raise ValueError(f"clip {clip.name!r} belongs to another skeleton: map it onto this one first")
    if not np.allclose(B[..., 3, :], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise ValueError(f"clip {clip.name!r}: the last row of every transform must be (0, 0, 0, 1)")


def _kept(skeleton: Skeleton, clips: list[Clip], size: float) -> list[Curves]:
    """The clips' own curves, where one tree holds them and is the skeleton's; else none."""
    found = [clip.curves for clip in clips if isinstance(clip.curves, Curves)]
    if not found or len(found) < len(clips):
        return []
    tree = found[0]
    for other in found[1:]:
        if not (np.array_equal(tree.P, other.P) and np.array_equal(tree.bones, other.bones)):
            return []
        for a, b in ((tree.frame, other.frame), (tree.inverse, other.inverse)):
            if not np.allclose(a, b, rtol=0, atol=_SAME * np.abs(a).max()):
                return []
    bone = np.full(len(tree.P), -1)
    bone[tree.bones] = np.arange(len(tree.bones))
    above = np.full(len(tree.P), -1)  # the nearest bone above each node
    for node in bone_order(tree.P).tolist():
        parent = tree.P[node]
        if parent >= 0:
            above[node] = bone[parent] if bone[parent] >= 0 else above[parent]
    inverse = tree.inverse
    joints = -(linear_inverses(inverse[:, :3, :3]) @ inverse[:, :3, 3:])[..., 0]
    # A reader places the character by its first root at rest.
    placed = replace(tree, channels=(), d=3).at(np.zeros(1))[0, int(np.argmax(skeleton.P < 0))]
    off = np.abs(joints - first_joints(skeleton)).max() + np.abs(placed[:3, 3]).max()
    off += size * np.abs(placed[:3, :3] - np.eye(3)).max()
    return found if np.array_equal(above[tree.bones], skeleton.P) and off <= _SAME * size else []


def _moved(curves: Curves, offset: np.ndarray) -> Curves:
    """Curves of a character that stands at the origin where it stood at the offset."""
    if not offset.any():
        return curves
    root = (curves.P < 0) & (curves.frame == np.eye(4)).all(axis=(1, 2))
    fixed = (curves.P < 0) & ~root
    frame, inverse = curves.frame.copy(), curves.inverse.copy()
    frame[fixed, :3, 3] -= offset
    inverse[:, :3, 3] += (inverse[:, :3, :3] @ offset[:, None])[..., 0]
    moved = curves.curves()
    for (node, part), (times, values, interpolation) in moved.items():
        if root[node] and part == "translation":
            away = np.outer([0, 1, 0], offset) if interpolation == SPLINE else offset
            moved[node, part] = Curve(times, values - away, interpolation)
    translation = curves.translation - np.where(root[:, None], offset, 0.0)
    return replace(curves, translation=translation, frame=frame, inverse=inverse, channels=channels_of(moved))


def _frames(clip: Clip, skeleton: Skeleton, size: float, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Times and transforms of a clip, with frames in between where it has curves that are not near to linear."""
    times, B = np.asarray(clip.times, dtype=np.float64), np.asarray(clip.B, dtype=np.float64)
    C, BE, P = first_joints(skeleton), np.repeat(np.arange(len(skeleton.P))[:, None], 2, axis=1), skeleton.P
    gaps = np.flatnonzero(np.diff(times) > 0) if clip.curves is not None else np.zeros(0, dtype=np.int64)
    for _ in range(_CUTS):
        if not len(gaps):
            break
        assert clip.curves is not None
        cut = (1 - _PLACE) * times[gaps] + _PLACE * times[gaps + 1]
        found = transforms_in_space(clip.curves.at(cut))
        D = interpolate_poses(C, BE, P, B[gaps], B[gaps + 1], _PLACE) - found
        at_joint = (D[..., :3, :3] @ C[:, :, None])[..., 0] + D[..., :3, 3]
        off = size * np.abs(D[..., :3, :3]).max(axis=(1, 2, 3)) + np.abs(at_joint).max(axis=(1, 2))
        far = off > _OFF * size
        times, B = np.insert(times, gaps[far] + 1, cut[far]), np.insert(B, gaps[far] + 1, found[far], axis=0)
        first = gaps[far] + np.arange(far.sum())  # each gap that was cut is two
        gaps = np.sort(np.concatenate([first, first + 1]))
    if len(times) > len(clip.times):
        jumps = f", and its jumps take {np.diff(times)[gaps].max():.2g} s" if len(gaps) else ""
        more = f"{len(times) - len(clip.times)} frames between its own, where it is not linear"
        notes.append(f"clip {clip.name!r} is written with {more}{jumps}")
    return times, B
