"""Motions: bone transforms as `.dmat`, and local motions in degrees as a short JSON that a person can write."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nilbs.geometry.nearest_names import nearest_name
from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.dmat import read_dmat, write_dmat
from nilbs.io.errors import FileFormatError
from nilbs.io.strict_json import finite_vector, read_json

_ROOT, _TIME = "root_translation", "time"
_POSES = 2**22  # bones times frames that a file may move: their transforms take half a gigabyte


def read_transforms(path: str | os.PathLike) -> np.ndarray:
    """Read the bone transforms of a motion.

    Parameters
    ----------
    path : str or path
        A `.dmat` file, one column a frame: the top three rows of every bone's transform, where row r of bone b stands
        from 4 (r b_total + b) on.

    Returns
    -------
    B : (t, b, 4, 4) float array
        Transforms, rest to posed, in the file's units.

    Raises
    ------
    FileFormatError
        If the file holds no finite matrix with 12 rows a bone.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/motion.dmat"
    >>> write_transforms(path, np.tile(np.eye(4), (5, 2, 1, 1)))
    >>> read_transforms(path).shape
    (5, 2, 4, 4)
    """
    A = read_dmat(path)
    if len(A) % 12 or A.size == 0:
        raise FileFormatError(path, f"transforms take 12 rows a bone and a column a frame, this file has {A.shape}")
    b = len(A) // 12
    B = np.zeros((A.shape[1], b, 4, 4))
    B[:, :, :3] = A.T.reshape(-1, 3, b, 4).transpose(0, 2, 1, 3)
    B[:, :, 3, 3] = 1
    return B


def write_transforms(path: str | os.PathLike, B: np.ndarray) -> None:
    """Write the bone transforms of a motion as a `.dmat` file.

    Parameters
    ----------
    path : str or path
        The file.
    B : (t, b, d+1, d+1) float array
        Transforms, rest to posed; in 2D they are written as motions of the plane z = 0.

    Raises
    ------
    ValueError
        If B has another shape, or a last row other than (0, ..., 0, 1), which the file could not hold.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/motion.dmat"
    >>> write_transforms(path, np.eye(3)[None, None])
    >>> read_transforms(path)[0, 0].tolist() == np.eye(4).tolist()
    True
    """
    (B,) = arrays(B=(B, "t b d+1 d+1"))
    t, b, d = B.shape[0], B.shape[1], B.shape[2] - 1
    if not (B[:, :, d] == np.eye(d + 1)[d]).all():
        raise ValueError(f"the last row of every transform in B must be {np.eye(d + 1)[d].tolist()}")
    A = np.zeros((t, b, 3, 4))
    A[:] = np.eye(4)[:3]
    A[:, :, :d, :d] = B[:, :, :d, :d]
    A[:, :, :d, 3] = B[:, :, :d, d]
    write_dmat(path, A.transpose(0, 2, 1, 3).reshape(t, 12 * b).T)


@dataclass(frozen=True)
class LocalMotion:
    """How bones move relative to their parents, as `nilbs.geometry.kinematics.forward_kinematics` takes it.

    Attributes
    ----------
    names : tuple of b str
    theta : (t, b, 1) or (t, b, 3) float array
        Local rotation vectors, in radians.
    root_translation : (t, d) float array
        How far the roots move, in the character's units.
    translation, scale : (t, b, d) float array or None
        How far bones move from their parents, and factors of size; None where none does.
    given : (t, b, d+1, d+1) float array or None
        Transforms of bones that are placed in the world instead; NaN for all others.
    times : (t,) float array or None
        Seconds, not decreasing; None where the file has none.
    """

    names: tuple[str, ...]
    theta: np.ndarray
    root_translation: np.ndarray
    translation: np.ndarray | None = None
    scale: np.ndarray | None = None
    given: np.ndarray | None = None
    times: np.ndarray | None = None


def read_motion_json(path: str | os.PathLike, names: Sequence[str] | None = None, d: int | None = None) -> LocalMotion:
    """Read a motion that a person can write.

    Parameters
    ----------
    path : str or path
        A file such as `{"frames": [{"bone0": [0, 0, 30], "root_translation": [0, 0, 1]}, {}]}`: for every frame, the
        rotation vectors of the bones that are turned, in degrees (in 2D one angle, 30 or [30]); every bone left out is
        not. A bone may also hold `{"rotation": [0, 0, 30], "translation": [1, 0, 0], "scale": 1.2}` or some of these,
        the scale being one number or one for each axis, or `{"matrix": [[...], ...]}`, d + 1 rows of its transform in
        the world, rest to posed; bones that hang from it follow. Times are those of "time", seconds, in every frame, or
        else count frames at the rate of "fps" beside "frames".
    names : sequence of b str, optional
        The names of the bones. By default those that the file names, in their order.
    d : 2 or 3, optional
        The dimension. By default that of the first rotation, translation or matrix.

    Returns
    -------
    motion : LocalMotion

    Raises
    ------
    FileFormatError
        Naming the frame and the bone, or the line where the text is no JSON.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "wave.json"
    >>> _ = path.write_text('{"fps": 10, "frames": [{}, {"bone1": 90}]}')
    >>> motion = read_motion_json(path, ("bone0", "bone1"), 2)
    >>> motion.theta.squeeze(-1).round(4).tolist(), motion.times.tolist()
    ([[0.0, 0.0], [0.0, 1.5708]], [0.0, 0.1])
    """
    frames, fps = _frames(path)
    entries = [(name, value) for frame in frames for name, value in frame.items() if name != _TIME]
    if names is None:
        names = list(dict.fromkeys(name for name, _ in entries if name != _ROOT))
    d = d or next(filter(None, (_dimension(name, value) for name, value in entries)), 3)
    bones = {name: b for b, name in enumerate(names)}
    if len(frames) * len(bones) > _POSES:
        raise FileFormatError(path, f"{len(frames)} frames of {len(bones)} bones are too many")
    filled = _Arrays(len(frames), len(bones), d)
    for t, frame in enumerate(frames):
        for name, value in frame.items():
            if name == _TIME:
                continue
            if name != _ROOT and name not in bones:
                meant = nearest_name(name, [*bones, _ROOT, _TIME])
                raise FileFormatError(path, f"frame {t}: the rig has no bone {name[:80]!r}{meant}")
            wrong = filled.put_root(t, value) if name == _ROOT else filled.put(t, bones[name], value)
            if wrong:
                raise FileFormatError(path, f"frame {t}, {name[:80]}: {wrong}")
    made = filled.made
    return LocalMotion(
        tuple(names), np.radians(made["rotation"]), filled.root, made.get("translation"), made.get("scale"),
        made.get("matrix"), _times(path, frames, fps),
    )  # fmt: skip


def write_motion_json(
    path: str | os.PathLike,
    names: Sequence[str],
    theta: np.ndarray,
    root_translation: np.ndarray,
    *,
    translation: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    given: np.ndarray | None = None,
    times: np.ndarray | None = None,
) -> None:
    """Write a motion as JSON, one frame a line.

    Parameters
    ----------
    path : str or path
        The file.
    names : sequence of b str
        The names of the bones.
    theta : (t, b, 1) or (t, b, 3) float array
        Local rotation vectors, in radians; written in degrees.
    root_translation : (t, d) float array
        In the character's units.
    translation, scale, given, times : float arrays, optional
        As in `LocalMotion`.

    Raises
    ------
    ValueError
        If the shapes or the number of names disagree.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/wave.json"
    >>> write_motion_json(path, ["bone0"], np.full((1, 1, 1), np.pi), np.zeros((1, 2)))
    >>> with open(path) as file:
    ...     print(file.read().strip())
    {"frames": [
    {"bone0": [180.0], "root_translation": [0.0, 0.0]}
    ]}
    """
    theta, root_translation = arrays(theta=(theta, "t b r"), root_translation=(root_translation, "t d"))
    t, b = theta.shape[:2]
    d = root_translation.shape[1]
    r = 1 if d == 2 else 3
    if theta.shape[2] != r or len(set(names)) != b or len(names) != b:
        raise ValueError(f"theta must be (t, b, {r}) with b = {len(names)} different names, got {theta.shape}")
    rows: list[dict] = [dict(zip(names, angles, strict=True)) for angles in np.degrees(theta).tolist()]
    for key, value, none in (("translation", translation, 0), ("scale", scale, 1)):
        if value is None:
            continue
        (value,) = arrays(**{key: (value, f"{t} {b} {d}")})
        for frame, bone in np.argwhere((value != none).any(axis=-1)).tolist():
            entry = rows[frame][names[bone]]
            entry = entry if isinstance(entry, dict) else {"rotation": entry}
            rows[frame][names[bone]] = {**entry, key: value[frame, bone].tolist()}
    if given is not None:
        placed = np.isfinite(given).all(axis=(-1, -2))
        (given,) = arrays(given=(np.where(placed[..., None, None], given, 0.0), f"{t} {b} {d + 1} {d + 1}"))
        for frame, bone in np.argwhere(placed).tolist():
            rows[frame][names[bone]] = {"matrix": given[frame, bone].tolist()}
    if times is not None:
        (times,) = arrays(times=(times, f"{t}"))
        rows = [{_TIME: seconds, **row} for seconds, row in zip(times.tolist(), rows, strict=True)]
    for row, move in zip(rows, root_translation.tolist(), strict=True):
        row[_ROOT] = move
    with replacing(path, "w") as file:
        file.write('{"frames": [\n' + ",\n".join(map(json.dumps, rows)) + "\n]}\n")


class _Arrays:
    """The arrays of a motion, filled entry by entry; those that no entry needs are never made."""

    def __init__(self, t: int, b: int, d: int) -> None:
        self.t, self.b, self.d, self.r = t, b, d, 1 if d == 2 else 3
        self.root = np.zeros((t, d))
        self.made = {"rotation": np.zeros((t, b, self.r))}

    def of(self, key: str) -> np.ndarray:
        """The array of a kind of entries, all at rest at first."""
        if key not in self.made:
            d = self.d
            shape = (self.t, self.b, d + 1, d + 1) if key == "matrix" else (self.t, self.b, d)
            self.made[key] = np.full(shape, {"translation": 0.0, "scale": 1.0, "matrix": np.nan}[key])
        return self.made[key]

    def put_root(self, t: int, value: object) -> str | None:
        """Set the roots' translation in a frame; what is wrong with the value, if anything is."""
        numbers = finite_vector(value, self.d)
        if not numbers:
            return f"expected {self.d} finite numbers, got {_shown(value)}"
        self.root[t] = numbers
        return None

    def put(self, t: int, bone: int, value: object) -> str | None:
        """Set what a frame does to a bone; what is wrong with the value, if anything is."""
        parts = value if isinstance(value, dict) else {"rotation": value}
        unknown = sorted(set(parts) - {"rotation", "translation", "scale", "matrix"})
        if unknown:
            return f'unknown entry {unknown[0][:80]!r} beside "rotation", "translation", "scale" and "matrix"'
        if "matrix" in parts:
            if len(parts) > 1:
                return '"matrix" is the whole transform: nothing can stand beside it'
            return self._put_matrix(t, bone, parts["matrix"])
        for key, part in parts.items():
            sizes = {"rotation": (self.r,), "translation": (self.d,), "scale": (1, self.d)}[key]
            numbers = finite_vector(part, *sizes)
            if not numbers:
                angles = "one angle" if self.r == 1 else "three angles"
                wanted = {"rotation": angles, "translation": f"{self.d} finite numbers as translation"}
                return f"expected {wanted.get(key, f'1 or {self.d} finite numbers as scale')}, got {_shown(part)}"
            self.of(key)[t, bone] = numbers
        return None

    def _put_matrix(self, t: int, bone: int, value: object) -> str | None:
        size = self.d + 1
        rows = [finite_vector(row, size) for row in value] if isinstance(value, list) else []
        if len(rows) != size or None in rows or rows[-1] != [0.0] * self.d + [1.0]:
            last = [0] * self.d + [1]
            return f"a matrix takes {size} rows of {size} finite numbers, the last {last}, got {_shown(value)}"
        self.of("matrix")[t, bone] = rows
        return None


def _frames(path: str | os.PathLike) -> tuple[list[dict], float | None]:
    """The frames of a motion, not yet read, and how many there are in a second."""
    motion = read_json(path)
    if not isinstance(motion, dict) or not isinstance(motion.get("frames"), list):
        raise FileFormatError(path, 'the file must hold one object with a list "frames"')
    unknown = sorted(set(motion) - {"frames", "fps"})
    if unknown:
        raise FileFormatError(path, f'unknown entry {unknown[0][:80]!r} beside "frames" and "fps"')
    fps = finite_vector(motion["fps"], 1) if "fps" in motion else None
    if "fps" in motion and not (fps and fps[0] > 1e-9):
        raise FileFormatError(path, '"fps" must be a number above zero')
    if not motion["frames"]:
        raise FileFormatError(path, "the motion has no frame")
    for t, frame in enumerate(motion["frames"]):
        if not isinstance(frame, dict):
            raise FileFormatError(path, f"frame {t} must be an object of bone names and rotations")
    return motion["frames"], fps[0] if fps else None


def _times(path: str | os.PathLike, frames: list[dict], fps: float | None) -> np.ndarray | None:
    if not any(_TIME in frame for frame in frames):
        return None if fps is None else np.arange(len(frames)) / fps
    times = np.zeros(len(frames))
    for t, frame in enumerate(frames):
        number = finite_vector(frame.get(_TIME), 1)
        if not number:
            raise FileFormatError(path, f'frame {t}: "time" must be a number of seconds, here as in every other frame')
        times[t] = number[0]
        if t and times[t] < times[t - 1]:
            raise FileFormatError(path, f"frame {t}: its time {times[t]:g} is before that of the frame before it")
    return times


def _dimension(name: str, value: object) -> int | None:
    """The dimension that an entry is written for, if it shows."""
    if isinstance(value, dict):
        if isinstance(value.get("matrix"), list):
            return 2 if len(value["matrix"]) == 3 else 3
        parts = [_dimension(_ROOT if key == "translation" else name, value[key]) for key in ("rotation", "translation")
                 if key in value]  # fmt: skip
        return next(filter(None, parts), None)
    size = len(value) if isinstance(value, list) else 1
    return 2 if size == (2 if name == _ROOT else 1) else 3


def _shown(value: object) -> str:
    try:
        return json.dumps(value)[:80]
    except RecursionError:
        return "lists in lists without end"
