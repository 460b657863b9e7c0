"""Recorded motions of bodies of the SMPL family as `.npz` files, as AMASS holds them."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints
from nilbs.io.bundle import Bundle, Clip
from nilbs.io.errors import FileFormatError
from nilbs.io.npz import NpzFile
from nilbs.io.smpl import JOINTS, joint_parents

_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_FPS = 30.0  # where the file names no rate
_POSES = 2**22  # joints times frames: their transforms take half a gigabyte
_LARGEST = 1e100  # of an angle and a coordinate
_LEFT_OUT = ("betas", "dmpls")
# Joints of a person of 1.7 m in centimetres, rounded: left ones, and those in the middle. y is up, z forward.
_PLACES = {
    "pelvis": (0, -23, 2), "spine1": (0, -11, 0), "spine2": (0, 3, 1), "spine3": (0, 8, 2), "neck": (0, 29, -1),
    "head": (0, 38, 3), "jaw": (0, 36, 4), "hip": (7, -32, 1), "knee": (11, -70, 0), "ankle": (9, -111, -3),
    "foot": (12, -117, 9), "collar": (8, 20, -1), "shoulder": (18, 23, -2), "elbow": (44, 22, -4),
    "wrist": (69, 23, -4), "hand": (78, 22, -5), "eye": (3, 42, 9), "index": (79, 23, 0), "middle": (80, 23, -2),
    "ring": (79, 23, -5), "pinky": (76, 22, -7), "thumb": (72, 21, 0),
}  # fmt: skip
_PHALANX = (3, 0, 0)  # from one joint of a finger to the next


def read_amass(path: str | os.PathLike, *, rig: Skeleton | None = None) -> Bundle:
    """Read the motion of a body: rotation vectors of its joints, and where it goes.

    A `.npz` file has `poses` (t, 3 k), of k = 22 joints, or the 24 of SMPL, the 52 of SMPL+H or the 55 of SMPL-X; and
    as a rule `trans` (t, 3) and `mocap_framerate` or `mocap_frame_rate`. No pickle is read. The file holds no rest
    pose: its rotations start from the T-pose of the body model, with y up, and that of the pelvis brings it to where z
    is up. If `rig` has the body's joints by name and parent, as `nilbs.io.smpl.read_smpl` reads them, they are the ones
    that move, exactly; else those of a mean person in T-pose, from which motions are retargeted. The shape of the
    recorded person is left out.

    References
    ----------
    .. [1] Mahmood et al., AMASS: Archive of Motion Capture as Surface Shapes, ICCV 2019, doi:10.1109/ICCV.2019.00554.
    """
    file = NpzFile(path)
    poses = file.array("poses")
    if poses.ndim == 2 and poses.shape[1] % 3 == 0:
        poses = poses.reshape(len(poses), poses.shape[1] // 3, 3)
    t, k, size = poses.shape if poses.ndim == 3 else (0, 0, 0)
    if k not in JOINTS or size != 3 or not t:
        wanted = ", ".join(str(3 * size) for size in JOINTS)
        raise FileFormatError(path, f"poses must be a row of {wanted} numbers a frame, this file holds {poses.shape}")
    if t * k > _POSES:
        raise FileFormatError(path, f"{t} frames of {k} joints are too many")
    notes = []
    trans = file.array("trans") if "trans" in file.names else np.zeros((t, 3))
    if trans.shape != (t, 3):
        raise FileFormatError(path, f"trans must be ({t}, 3), this file holds {trans.shape}")
    if "trans" not in file.names:
        notes.append("it holds no trans: the body stays in its place")
    rate = next((name for name in _RATES if name in file.names), None)
    fps = _FPS if rate is None else file.number(rate)
    if not fps > 1e-9:
        raise FileFormatError(path, f"{rate} must be above zero, this file holds {fps:g}")
    if rate is None:
        notes.append(f"it holds no frame rate: {_FPS:g} frames a second are assumed")
    left_out = [name for name in _LEFT_OUT if name in file.names]
    if left_out:
        notes.append(f"{' and '.join(left_out)}, the shape of the recorded person, are left out")
    skeleton = rig if rig is not None and _is_body(rig) else _mean_person(k)
    place = {name: joint for joint, name in enumerate(JOINTS[k])}
    moved = [bone for bone, name in enumerate(skeleton.names) if name in place]
    theta = np.zeros((t, len(skeleton.names), 3))
    theta[:, moved] = poses[:, [place[skeleton.names[bone]] for bone in moved]]
    unused = k - len(moved)
    if unused:
        notes.append(f"{unused} of {k} joints are none of the rig's")
    largest = max(np.abs(poses).max(), np.abs(trans).max(), np.abs(skeleton.C).max())
    if largest > _LARGEST:
        raise FileFormatError(path, "the body turns or moves farther than numbers go")
    B = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=trans)
    clip = Clip(Path(path).stem, skeleton, np.arange(t) / fps, B)
    return Bundle(skeleton=skeleton, clips=(clip,), notes=tuple(notes))


def _is_body(rig: Skeleton) -> bool:
    """Whether a rig has the joints of a body, at least the 22 that all have, and in their tree."""
    k = min(JOINTS)
    number = {name: bone for bone, name in enumerate(rig.names)}
    if rig.d != 3 or not set(JOINTS[k]) <= number.keys():
        return False
    bones = [number[name] for name in JOINTS[k]]
    return rig.P[bones].tolist() == [bones[parent] if parent >= 0 else -1 for parent in joint_parents(k)]


def _mean_person(k: int) -> Skeleton:
    """The skeleton of a person of usual proportions in T-pose, with the k joints of a body, in metres."""
    return skeleton_of_joints(np.array([*_places(k)]) / 100, np.array(joint_parents(k)), JOINTS[k])


def _places(k: int) -> Iterator[np.ndarray]:
    for name in JOINTS[k]:
        side, _, part = name.removesuffix("_smplhf").rpartition("_")
        finger = part.rstrip("0123")
        place = np.array(_PLACES[part if part in _PLACES else finger])
        if part not in _PLACES:
            place = place + (int(part[-1]) - 1) * np.array(_PHALANX)
        yield place * [-1 if side == "right" else 1, 1, 1]
