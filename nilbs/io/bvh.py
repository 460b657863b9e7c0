"""Biovision's `.bvh` files: a skeleton whose bones are joints, and one motion of it."""

import os
import re
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile
from pathlib import Path

import numpy as np

from nilbs.geometry.curves import LARGEST, curves_between
from nilbs.geometry.rotations import rotation_matrices
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.bounded import line_blocks
from nilbs.io.bundle import Bundle, Clip
from nilbs.io.bvh_positions import Channels, placed, written
from nilbs.io.errors import FileFormatError
from nilbs.io.joints import first_joints, skeleton_with_ends, written_ends
from nilbs.io.names import text_of, unique_names, written_names
from nilbs.io.words import finite_numbers, is_number

_CHANNEL = re.compile(rb"([xyz])(position|rotation)", re.IGNORECASE)
_SIZE = re.compile(rb"[0-6]")
_FRAMES = re.compile(rb"frames\s*:\s*(\d{1,9})", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"frame\s+time\s*:\s*(\S+)", re.IGNORECASE)
_BLOCK = 2**18  # numbers of a motion that are converted at a time
_POSES = 2**18  # bones times frames that any file may hold
_POSE_BYTES = 5  # of the file that allow one more, so that memory stays in proportion to the file
_UNFIT = r"[\t-\r{}]|^ +| +$|  +"  # what a name, read up to its brace, loses
_EVEN = 1e-3  # of a frame: times that float32 rounded still count as equally far apart
_RIGID = 1e-5  # how far a rotation in float32 may be from orthogonal
_APART = 4e-7  # of the skeleton's size: a joint that moves less has no positions of its own

Lines = Iterator[tuple[int, bytes]]


def read_bvh(path: str | os.PathLike, *, positions: str = "auto") -> Bundle:
    """Read a skeleton and its motion, with notes on what was decided.

    In the rest pose all rotations are zero and every joint stands at its OFFSET from its parent, a root at its OFFSET
    from the origin; an End Site is where a bone ends. Channels may come in any order, and there may be several roots
    and no frame.

    A joint's rotations act in the order listed, the last one first: `Zrotation Xrotation Yrotation` is Rz Rx Ry [1]_.
    Its position takes the place of its OFFSET, as in Blender, or is added to it, as some programs write it: `positions`
    is "replace", "add" or, by default, "auto", where the data decide, see `nilbs.io.bvh_positions.placed`. A coordinate
    without a channel stays.

    Rows after the frames that the file announces, and a last row that is cut off, are left out; if there are fewer
    rows, they are the motion. Notes report this, and how text that is not UTF-8 was read.

    References
    ----------
    .. [1] Meredith and Maddock, Motion capture file formats explained, University of Sheffield, CS-01-11, 2001.
    """
    notes: list[str] = []
    lines = ((number, line) for first, block in line_blocks(path, notes) for number, line in enumerate(block, first))
    joints = _hierarchy(path, lines)
    seconds, motion = _motion(path, lines, len(joints), sum(len(joint.channels) for joint in joints), notes)
    names, renamed = unique_names(joint.name for joint in joints)
    rest = np.zeros((len(joints), 3))
    ends = {}
    with np.errstate(all="ignore"):
        offset, decided = _place(joints, motion, positions)
        for j, joint in enumerate(joints):
            rest[j] = offset[j] if joint.parent < 0 else rest[joint.parent] + offset[j]
            if joint.end is not None:
                ends[j] = rest[j] + joint.end
        B = _transforms(joints, motion, offset, rest)
    if not all((np.abs(array) < LARGEST).all() for array in (rest, B, *ends.values())):
        raise FileFormatError(path, "the joints are farther apart than numbers go")
    skeleton = skeleton_with_ends(rest, np.array([joint.parent for joint in joints]), names, ends)
    s, times = skeleton, seconds * np.arange(len(motion))
    curves = curves_between(s.C, s.BE, s.P, times, B) if seconds and len(times) else None
    clip = Clip(Path(path).stem, skeleton, times, B, curves=curves)
    return Bundle(skeleton=skeleton, clips=(clip,), notes=(*renamed, *notes, *decided))


def write_bvh(path: str | os.PathLike, clip: Clip) -> tuple[str, ...]:
    """Write a motion and its skeleton; return notes on changed names and a start other than 0 s.

    Bones are joints, a parent's before its children's, with rotations about z, x and y; roots, and bones that come
    apart from their parent, with positions too. ValueError if a bone is scaled, sheared or mirrored, or times are
    uneven.
    """
    skeleton = clip.skeleton
    B, times = arrays(B=(clip.B, f"t {len(skeleton.P)} 4 4"), times=(clip.times, "t"))
    names, notes = written_names(skeleton.names, _UNFIT)
    if len(times) and times[0]:
        notes += (f"the motion starts at {times[0]:g} s, in the file at 0 s",)
    seconds = _frame_seconds(times)
    positions, degrees = _channels(skeleton, B)
    below = skeleton.P >= 0
    offset = first_joints(skeleton)
    offset[below] -= first_joints(skeleton)[skeleton.P[below]]
    size = np.linalg.norm(np.ptp(skeleton.C, axis=0))
    moved = ~below | (np.abs(positions - offset).max(axis=(0, 2), initial=0) > _APART * size)
    of, axis = np.repeat(np.flatnonzero(moved), 3), np.tile(np.arange(3), moved.sum())
    positions[:, of, axis], unclear = written(
        positions[:, of, axis], Channels(of, axis, offset, ~below, skeleton.names)
    )
    notes += unclear
    text, order = _hierarchy_text(skeleton, names, offset, moved)
    columns = [np.zeros((len(times), 0))]
    for bone in order:
        columns += [positions[:, bone], degrees[:, bone]] if moved[bone] else [degrees[:, bone]]
    with replacing(path, "w") as file:
        file.write(f"HIERARCHY\n{text}MOTION\nFrames: {len(times)}\nFrame Time: {seconds}\n")
        np.savetxt(file, np.concatenate(columns, axis=1), fmt="%.10g")
    return notes


class _Joint:
    def __init__(self, name: str, parent: int, line: int) -> None:
        self.name = name
        self.parent = parent
        self.line = line
        self.offset: np.ndarray | None = None
        self.channels: list[tuple[bool, int]] = []  # whether a rotation, and its axis
        self.end: np.ndarray | None = None


def _words(lines: Lines) -> Iterator[tuple[bytes, int]]:
    """The words before MOTION, with their lines."""
    for number, line in lines:
        words = line.replace(b"{", b" { ").replace(b"}", b" } ").split()
        if words and words[0].lower() == b"motion":
            return
        for word in words:
            yield word, number


def _hierarchy(path: str | os.PathLike, lines: Lines) -> list[_Joint]:
    """The joints of a file, every parent before its children."""
    joints: list[_Joint] = []
    opened: list[int] = []  # the joints around the word that is read, and -1 for an End Site
    words = _words(lines)
    number = 0

    def take(size: int) -> list[bytes]:
        return [word for word, _ in islice(words, size)]

    for word, number in words:
        kind = word.lower()
        inner = opened[-1] if opened else None
        if kind in (b"root", b"joint", b"end"):
            if (kind == b"root") != (inner is None) or inner == -1:
                raise FileFormatError(path, f"{text_of(word)} at the wrong place: is a brace missing?", number)
            before = list(takewhile(lambda found: found[0] != b"{", words))
            name = b" ".join(word for word, _ in before)
            if not name or before[-1][1] != number:
                message = f"{text_of(word)} needs a name in its line, and then a brace"
                raise FileFormatError(path, message, number)
            if kind == b"end":
                opened.append(-1)
            else:
                opened.append(len(joints))
                joints.append(_Joint(text_of(name), -1 if inner is None else inner, number))
        elif kind == b"offset" and inner is not None:
            numbers = take(3)
            if len(numbers) < 3:
                raise FileFormatError(path, "OFFSET needs three numbers", number)
            offset = finite_numbers(path, numbers, [number])[0]
            if inner == -1:
                joints[opened[-2]].end = offset
            else:
                joints[inner].offset = offset
        elif kind == b"channels" and inner is not None and inner >= 0:
            size = next(words, (b"", number))[0]
            found = [_CHANNEL.fullmatch(name) for name in take(int(size))] if _SIZE.fullmatch(size) else [None]
            if None in found or len(found) != int(size):
                message = "CHANNELS needs their number, up to 6, and as many of Xposition, Yrotation and the like"
                raise FileFormatError(path, message, number)
            joints[inner].channels = [(m[2].lower() == b"rotation", b"xyz".index(m[1].lower())) for m in found if m]
        elif kind == b"}" and inner is not None:
            opened.pop()
        elif kind != b"hierarchy" or joints:
            message = f"{text_of(word)[:40]!r} at the wrong place in the hierarchy"
            raise FileFormatError(path, message, number)
    if not joints or opened:
        message = "a brace is not closed before MOTION" if joints else "the hierarchy has no joint"
        raise FileFormatError(path, message, number or None)
    for joint in joints:
        if joint.offset is None:
            raise FileFormatError(path, f"joint {joint.name[:60]!r} has no OFFSET", joint.line)
    return joints


def _motion(
    path: str | os.PathLike, lines: Lines, joints: int, channels: int, notes: list[str]
) -> tuple[float, np.ndarray]:
    """Seconds a frame, and the motion's numbers (t, channels)."""
    full = ((number, line) for number, line in lines if line.strip())
    number, line = next(full, (None, b""))
    frames = _FRAMES.fullmatch(line.strip())
    if not frames:
        raise FileFormatError(path, 'a line "Frames: NUMBER" must follow MOTION', number)
    number, line = next(full, (number, b""))
    frame_time = _FRAME_TIME.fullmatch(line.strip())
    seconds = finite_numbers(path, [frame_time[1]], [number or 0])[0, 0] if frame_time else -1.0
    if seconds < 0:
        raise FileFormatError(path, 'a line "Frame Time: SECONDS" must follow the number of frames', number)
    t = int(frames[1])
    blocks = [np.zeros((0, channels))]
    words: list[bytes] = []
    at: list[int] = []  # lines of the words
    read = size = 0
    for number, line in islice(full, t):
        row = line.split(maxsplit=channels)
        if len(row) != channels or (row and not line.endswith(b"\n") and not is_number(row[-1])):
            if len(row) > channels or next(full, None):
                raise FileFormatError(path, f"a frame has {channels} numbers, one for every channel", number)
            notes.append(f"the last row, in line {number}, is cut off and left out")
            break
        words += row
        at.append(number)
        read += 1
        size += len(line.strip())
        if len(words) > _BLOCK:
            blocks.append(finite_numbers(path, words, at))
            words, at = [], []
    if read < t:
        notes.append(f"the file announces {t} frames, and ends after {read}, in line {number}")
    more = [number for number, _ in full]
    if more:
        rows = "1 row is" if len(more) == 1 else f"{len(more)} rows are"
        notes.append(f"{rows} left over after the {t} frames that the file announces, from line {more[0]} on")
    if words:
        blocks.append(finite_numbers(path, words, at))
    if read * joints > max(size / _POSE_BYTES, _POSES):
        raise FileFormatError(
            path, f"{read} frames of {joints} joints, in {size} bytes: hardly any joint has a channel", number
        )
    return float(seconds), np.concatenate(blocks)


def _place(joints: list[_Joint], motion: np.ndarray, how: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """The joints' OFFSETs (b, 3), and notes on them; the positions in the motion take their place from here on."""
    offset = np.array([joint.offset for joint in joints])
    listed = [(j, turns, axis) for j, joint in enumerate(joints) for turns, axis in joint.channels]
    of, turns, axis = np.array(listed, dtype=np.int64).reshape(-1, 3).T
    columns = np.flatnonzero(turns == 0)
    root = np.array([joint.parent < 0 for joint in joints])
    channels = Channels(of[columns], axis[columns], offset, root, [joint.name for joint in joints])
    found = placed(motion[:, columns], channels, how)
    motion[:, columns] = found.positions
    return found.offset, found.notes


def _transforms(joints: list[_Joint], motion: np.ndarray, offset: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Transforms (t, b, 4, 4) of joints, rest to posed."""
    t = len(motion)
    column = np.cumsum([0, *(len(joint.channels) for joint in joints)]).tolist()
    cos, sin = np.cos(np.radians(motion)), np.sin(np.radians(motion))
    B = np.zeros((t, len(joints), 4, 4))
    B[:, :, 3, 3] = 1
    world = np.broadcast_to(np.eye(4), (t, 4, 4))
    # First where every joint is in the world, G(t).
    for joint, G, local, start in zip(joints, B.swapaxes(0, 1), offset, column, strict=False):
        parent = B[:, joint.parent] if joint.parent >= 0 else world
        position = np.tile(local, (t, 1))
        R = parent[:, :3, :3].copy()
        for c, (turns, axis) in enumerate(joint.channels, start):
            if turns:  # R times a turn about the axis: two columns of R turn
                i, k = (axis + 1) % 3, (axis + 2) % 3
                turned = cos[:, c, None] * R[:, :, i] + sin[:, c, None] * R[:, :, k]
                R[:, :, k] = cos[:, c, None] * R[:, :, k] - sin[:, c, None] * R[:, :, i]
                R[:, :, i] = turned
            else:
                position[:, axis] = motion[:, c]
        G[:, :3, :3] = R
        G[:, :3, 3] = parent[:, :3, 3] + (parent[:, :3, :3] @ position[:, :, None])[:, :, 0]
    # Then G(t) inv(G(rest)), where G(rest) is a translation.
    B[:, :, :3, 3] -= (B[:, :, :3, :3] @ rest[:, :, None])[..., 0]
    return B


def _frame_seconds(times: np.ndarray) -> float:
    if len(times) < 2:
        return 1 / 30
    seconds = (times[-1] - times[0]) / (len(times) - 1)
    uneven = np.flatnonzero(np.abs(times - times[0] - seconds * np.arange(len(times))) > _EVEN * seconds)
    if len(uneven):
        message = f"frame {uneven[0]}, at {times[uneven[0]]:g} s, is not: give the motion at a constant rate"
        raise ValueError(f"the frames of a .bvh file are equally far apart, and {message}")
    return float(seconds)


def _channels(skeleton: Skeleton, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the parent's frame, and degrees about z, x and y: both (t, b, 3)."""
    R, start, P = B[:, :, :3, :3], first_joints(skeleton), skeleton.P
    rigid = (np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2)) < _RIGID) & (np.linalg.det(R) > 0)
    rigid &= (B[:, :, 3] == [0, 0, 0, 1]).all(axis=-1)
    if not rigid.all():
        frame, bone = np.argwhere(~rigid)[0]
        message = f"bone {skeleton.names[bone]!r} is scaled, sheared or mirrored in frame {frame}"
        raise ValueError(f"{message}: a .bvh file holds rotations and positions only")
    place = (R @ start[:, :, None])[..., 0] + B[:, :, :3, 3]
    root = P < 0
    to_parent = np.where(root[:, None, None], np.eye(3), R[:, P].swapaxes(-1, -2))
    positions = (to_parent @ (place - np.where(root[:, None], 0, place[:, P]))[..., None])[..., 0]
    A = to_parent @ R
    # A = Rz Rx Ry. Without Ry, taken from the last row, A would be Rz Rx: so no angle loses digits near x = 90 degrees.
    y = np.arctan2(-A[..., 2, 0], A[..., 2, 2])
    A = A @ rotation_matrices(np.stack([0 * y, -y, 0 * y], axis=-1))
    angles = [np.arctan2(A[..., 1, 0], A[..., 0, 0]), np.arctan2(A[..., 2, 1], A[..., 2, 2]), y]
    return positions, np.degrees(np.stack(angles, axis=-1)) + 0.0


def _hierarchy_text(
    skeleton: Skeleton, names: Sequence[str], offset: np.ndarray, moved: np.ndarray
) -> tuple[str, list[int]]:
    """The hierarchy, and the bones in the order of their joints there."""
    children: dict[int, list[int]] = {}
    for bone, parent in enumerate(skeleton.P.tolist()):
        children.setdefault(parent, []).append(bone)
    end, needed = written_ends(skeleton)
    end = end - first_joints(skeleton)
    lines: list[str] = []
    order: list[int] = []
    todo: list[tuple[int, str]] = [(bone, "") for bone in reversed(children[-1])]
    while todo:
        bone, tab = todo.pop()
        if bone < 0:
            lines.append(f"{tab}}}")
            continue
        order.append(bone)
        positions = "6 Xposition Yposition Zposition" if moved[bone] else "3"
        lines += [f"{tab}{'JOINT' if tab else 'ROOT'} {names[bone]}", f"{tab}{{", f"{tab}\tOFFSET {_xyz(offset[bone])}"]
        lines.append(f"{tab}\tCHANNELS {positions} Zrotation Xrotation Yrotation")
        if needed[bone] or bone not in children:
            lines += [f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\tOFFSET {_xyz(end[bone])}", f"{tab}\t}}"]
        todo.append((-1, tab))
        todo += [(child, tab + "\t") for child in reversed(children.get(bone, []))]
    return "\n".join(lines) + "\n", order


def _xyz(vector: np.ndarray) -> str:
    return " ".join(map(str, vector.tolist()))
