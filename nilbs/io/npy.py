"""NumPy's `.npy` files of numbers, read without pickle; the size that a header claims is checked."""

import math
import os
import re

import numpy as np

from nilbs.io.atomic import replacing
from nilbs.io.bounded import SIZE_LIMIT, file_bytes
from nilbs.io.errors import FileFormatError, check_suffix

_NPY_HEADER = re.compile(
    r"\{'descr': '([<>|][fiub][1248])', 'fortran_order': (True|False), "
    r"'shape': \((?:(\d{1,18}(?:, ?\d{1,18}){0,7}),?)?\),? *\}\s*"
)


def read_npy(path: str | os.PathLike) -> np.ndarray:
    """Read an array of numbers.

    Parameters
    ----------
    path : str or path
        A `.npy` file.

    Returns
    -------
    A : float array
        Of one to eight dimensions.

    Raises
    ------
    FileFormatError
        If the file is no such array, holds a number that is not finite, or is cut.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/points.npy"
    >>> write_npy(path, [[1.0, 2.0]])
    >>> read_npy(path)
    array([[1., 2.]])
    """
    check_suffix(path, ".npy")
    A = npy_array(path, file_bytes(path), "the file")
    if not A.ndim:
        raise FileFormatError(path, "the file holds one number, not an array")
    return A


def write_npy(path: str | os.PathLike, A: np.ndarray) -> None:
    """Write an array of numbers, in its own type.

    Parameters
    ----------
    path : str or path
        A file that ends in `.npy`.
    A : array
        Numbers.

    Raises
    ------
    ValueError
        If the suffix is another, or A holds no numbers.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> write_npy(tempfile.mkdtemp() + "/values.npy", np.array([0.5], dtype=np.float32))
    """
    check_suffix(path, ".npy")
    A = np.asarray(A)
    if A.dtype.kind not in "fiu":
        raise ValueError(f"A must be an array of numbers, got {A.dtype}")
    with replacing(path) as file:
        np.save(file, A, allow_pickle=False)


def npy_array(path: str | os.PathLike, data: bytes, name: str) -> np.ndarray:
    """The finite numbers in the bytes of a `.npy` file, in double precision; memory is bounded by these bytes."""
    A = stored_array(path, data, name, kinds="fiu")
    if A.size * 8 > SIZE_LIMIT:
        raise FileFormatError(path, f"{name} holds {A.size} numbers, more than {SIZE_LIMIT // 8}")
    with np.errstate(invalid="ignore"):  # a signalling NaN is reported below
        A = A.astype(np.float64)
    if not np.isfinite(A).all():
        raise FileFormatError(path, f"{name} holds a number that is not finite")
    return A


def stored_array(path: str | os.PathLike, data: bytes, name: str, *, kinds: str) -> np.ndarray:
    """The array in the bytes of a `.npy` file [1]_, as it is: a view of them, of one of these kinds of dtype.

    References
    ----------
    .. [1] NumPy, the NPY format, https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html.
    """
    long = data[6:7] in (b"\2", b"\3")
    start = 12 if long else 10
    end = start + int.from_bytes(data[8:start], "little")
    header = _NPY_HEADER.fullmatch(data[start : min(end, 2**16)].decode("latin-1"))
    if not data.startswith(b"\x93NUMPY") or not header or header[1][1] not in kinds:
        objects = b"'descr': '|O'" in data[start : start + 99]
        message = " but a pickle, which is never read: save an array of plain numbers" if objects else ""
        raise FileFormatError(path, f"{name} is not a plain array of numbers{message}")
    try:
        kind = np.dtype(header[1])
    except TypeError:
        raise FileFormatError(path, f"{name} is of the unknown type {header[1]}") from None
    shape = tuple(int(size) for size in header[3].split(",")) if header[3] else ()
    if math.prod(shape) * kind.itemsize != len(data) - end:
        raise FileFormatError(path, f"{name} claims the shape {shape}, but holds {len(data) - end} bytes")
    A = np.frombuffer(data, kind, offset=end)
    return A.reshape(shape, order="F" if header[2] == "True" else "C")
