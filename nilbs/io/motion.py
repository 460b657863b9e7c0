"""Motions: bone transforms as `.dmat`, and local rotations in degrees as a short JSON that a person can write."""

import json
import os

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.bounded import file_bytes
from nilbs.io.dmat import read_dmat, write_dmat
from nilbs.io.errors import FileFormatError

_ROOT = "root_translation"
_LARGEST = 1e300  # of a number in JSON, which may be written with any exponent


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


def read_motion_json(
    path: str | os.PathLike, names: tuple[str, ...] | list[str], d: int
) -> tuple[np.ndarray, np.ndarray]:
    """Read local rotations that a person can write.

    Parameters
    ----------
    path : str or path
        A file such as `{"frames": [{"bone0": [0, 0, 30], "root_translation": [0, 0, 1]}, {}]}`: for every frame, the
        rotation vectors of the bones that are turned, in degrees (in 2D one angle, 30 or [30]); every bone left out is
        not. "fps", frames a second, may stand beside "frames" and is not used.
    names : sequence of b str
        The names of the bones.
    d : 2 or 3
        The dimension.

    Returns
    -------
    theta : (t, b, 1) or (t, b, 3) float array
        Local rotation vectors, in radians.
    root_translation : (t, d) float array
        In the character's units.

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
    >>> _ = path.write_text('{"frames": [{}, {"bone1": 90}]}')
    >>> read_motion_json(path, ("bone0", "bone1"), 2)[0].squeeze(-1).round(4).tolist()
    [[0.0, 0.0], [0.0, 1.5708]]
    """
    return _rotations(path, _frames(path), names, d)


def read_any_motion_json(path: str | os.PathLike) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Read local rotations where the rig is not known: names and dimension are those that the file uses.

    Parameters
    ----------
    path : str or path
        As for `read_motion_json`.

    Returns
    -------
    names : tuple of b str
        The bones that the file turns, in the order in which it names them.
    theta : (t, b, 1) or (t, b, 3) float array
        Their local rotation vectors, in radians; (t, b, 1) where the first rotation or translation is one of the plane.
    root_translation : (t, 2) or (t, 3) float array
        In the character's units.

    Raises
    ------
    FileFormatError
        As for `read_motion_json`.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "wave.json"
    >>> _ = path.write_text('{"frames": [{"arm": 90}]}')
    >>> read_any_motion_json(path)[0]
    ('arm',)
    """
    frames = _frames(path)
    entries = [entry for frame in frames if isinstance(frame, dict) for entry in frame.items()]
    names = tuple(dict.fromkeys(name for name, _ in entries if name != _ROOT))
    flat = {1, 2}  # numbers of one angle, of one translation in the plane
    sizes = [len(value) if isinstance(value, list) else 1 for _, value in entries]
    theta, root_translation = _rotations(path, frames, names, 2 if sizes and sizes[0] in flat else 3)
    return names, theta, root_translation


def write_motion_json(
    path: str | os.PathLike, names: tuple[str, ...] | list[str], theta: np.ndarray, root_translation: np.ndarray
) -> None:
    """Write local rotations as JSON, one frame a line.

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
    r = 1 if root_translation.shape[1] == 2 else 3
    if theta.shape[2] != r or len(set(names)) != theta.shape[1] or len(names) != theta.shape[1]:
        raise ValueError(f"theta must be (t, b, {r}) with b = {len(names)} different names, got {theta.shape}")
    rows = []
    for angles, translation in zip(np.degrees(theta).tolist(), root_translation.tolist(), strict=True):
        rows.append(json.dumps({**dict(zip(names, angles, strict=True)), _ROOT: translation}))
    with replacing(path, "w") as file:
        file.write('{"frames": [\n' + ",\n".join(rows) + "\n]}\n")


def _frames(path: str | os.PathLike) -> list:
    """The list of frames of a motion, not yet read."""
    motion = _json(path)
    if not isinstance(motion, dict) or not isinstance(motion.get("frames"), list):
        raise FileFormatError(path, 'the file must hold one object with a list "frames"')
    unknown = sorted(set(motion) - {"frames", "fps"})
    if unknown:
        raise FileFormatError(path, f'unknown entry {unknown[0]!r} beside "frames" and "fps"')
    if "fps" in motion and not _vector(motion["fps"], 1):
        raise FileFormatError(path, '"fps" must be a number')
    if not motion["frames"]:
        raise FileFormatError(path, "the motion has no frame")
    return motion["frames"]


def _rotations(
    path: str | os.PathLike, frames: list, names: tuple[str, ...] | list[str], d: int
) -> tuple[np.ndarray, np.ndarray]:
    bones = {name: b for b, name in enumerate(names)}
    r = 1 if d == 2 else 3
    degrees = np.zeros((len(frames), len(bones), r))
    root_translation = np.zeros((len(frames), d))
    for t, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise FileFormatError(path, f"frame {t} must be an object of bone names and rotations")
        for name, value in frame.items():
            if name != _ROOT and name not in bones:
                raise FileFormatError(path, f"frame {t}: the rig has no bone {name[:80]!r}")
            numbers = _vector(value, d if name == _ROOT else r)
            if not numbers:
                wanted = f"{d} finite numbers" if name == _ROOT else ("one angle" if r == 1 else "three angles")
                raise FileFormatError(path, f"frame {t}, {name}: expected {wanted}, got {json.dumps(value)[:80]}")
            if name == _ROOT:
                root_translation[t] = numbers
            else:
                degrees[t, bones[name]] = numbers
    return np.radians(degrees), root_translation


def _json(path: str | os.PathLike) -> object:
    data = file_bytes(path)
    try:
        return json.loads(data.decode("utf-8-sig"), object_pairs_hook=_object, parse_constant=_constant)
    except json.JSONDecodeError as error:
        raise FileFormatError(path, f"this is no JSON: {error.msg}", error.lineno) from None
    except RecursionError:
        raise FileFormatError(path, "the JSON is nested too deep") from None
    # Bytes that are no text, names given twice, NaN, and whole numbers of thousands of digits.
    except ValueError as error:
        raise FileFormatError(path, f"this is no JSON of a motion: {str(error)[:120]}") from None


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in found if names.count(name) > 1)
        raise ValueError(f"{twice[:80]!r} stands twice in one object")
    return found


def _constant(name: str) -> object:
    raise ValueError(f"{name} is not a finite number")


def _vector(value: object, size: int) -> list[float] | None:
    """The finite numbers of a list, or of one number where one is wanted; None for anything else."""
    values = value if isinstance(value, list) else [value]
    # Compared as they are: a whole number may be too large for a float.
    numbers = [
        float(x) for x in values if isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= _LARGEST
    ]
    return numbers if len(numbers) == len(values) == size else None
