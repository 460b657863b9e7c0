"""libigl's matrix files: `.dmat`, as text and binary."""

import os
import re

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing
from nilbs.io.bounded import text_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.words import finite_numbers

_HEADER = re.compile(rb"[ \t\r\n]*(\d{1,18})[ \t]+(\d{1,18})[ \t\r]*(?:\n|$)")


def read_dmat(path: str | os.PathLike) -> np.ndarray:
    r"""Read a matrix from a `.dmat` file.

    Parameters
    ----------
    path : str or path
        The file: a header `columns rows`, then the values column by column, one a word. In the binary form a header
        `0 0` comes first, and the values are little-endian doubles.

    Returns
    -------
    A : (rows, columns) float array

    Raises
    ------
    FileFormatError
        If there is no header, a word is not a finite number, or there are other than the promised number of values.
    OSError
        If the file cannot be read.

    References
    ----------
    .. [1] libigl, file formats, https://libigl.github.io/file-formats/dmat/.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "A.dmat"
    >>> _ = path.write_text("2 3\n1 2 3\n4 5 6\n")
    >>> read_dmat(path)
    array([[1., 4.],
           [2., 5.],
           [3., 6.]])
    """
    data = text_bytes(path)
    columns, rows, start = _header(path, data, 0, 1)
    if columns == rows == 0 and data[start:].strip():
        columns, rows, start = _header(path, data, start, 2)
        values = _binary(path, data, start, columns * rows)
    else:
        values = _text(path, data, start, columns * rows)
    # Columns first in the file, rows first in memory.
    return np.ascontiguousarray(values.reshape(columns, rows).T)


def write_dmat(path: str | os.PathLike, A: np.ndarray) -> None:
    """Write a matrix to a `.dmat` file, as text with every digit.

    Parameters
    ----------
    path : str or path
        The file.
    A : (rows, columns) float array
        The matrix.

    Raises
    ------
    ValueError
        If A is not a finite matrix.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/A.dmat"
    >>> write_dmat(path, [[0.1, 2.0]])
    >>> read_dmat(path)
    array([[0.1, 2. ]])
    """
    (A,) = arrays(A=(A, "n m"))
    with replacing(path, "w") as file:
        file.write(f"{A.shape[1]} {A.shape[0]}\n")
        for column in A.T:
            file.write("\n".join([*map(repr, column.tolist()), ""]))


def _header(path: str | os.PathLike, data: bytes, start: int, line: int) -> tuple[int, int, int]:
    match = _HEADER.match(data, start)
    if not match:
        raise FileFormatError(path, "a .dmat file starts with its numbers of columns and rows", line)
    columns, rows = int(match[1]), int(match[2])
    # A text file takes at least two bytes a value, so memory stays in proportion to the file.
    if columns * rows > len(data):
        raise FileFormatError(path, f"{rows} rows of {columns} columns do not fit in {len(data)} bytes", line)
    return columns, rows, match.end()


def _binary(path: str | os.PathLike, data: bytes, start: int, size: int) -> np.ndarray:
    if len(data) - start != 8 * size:
        raise FileFormatError(path, f"{size} binary values take {8 * size} bytes, the file holds {len(data) - start}")
    values = np.frombuffer(data, "<f8", offset=start).astype(np.float64)
    if not np.isfinite(values).all():
        bad = int(np.flatnonzero(~np.isfinite(values))[0])
        raise FileFormatError(path, f"value {bad} is {values[bad]}; every number must be finite")
    return values


def _text(path: str | os.PathLike, data: bytes, start: int, size: int) -> np.ndarray:
    words = data[start:].split(maxsplit=size)  # whatever is left over stays one word
    try:
        values = np.array([float(word) for word in words[:size]], dtype=np.float64)
    except ValueError:
        values = np.full(0, 0.0)
    if len(values) == len(words[:size]) and np.isfinite(values).all() and b"_" not in b"".join(words[:size]):
        if len(values) < size:
            raise FileFormatError(path, f"the header promises {size} values, the file holds {len(values)}")
        if len(words) > size:
            raise FileFormatError(path, f"the file goes on after the {size} values that its header promises")
        return values
    first = data.count(b"\n", 0, start) + 1
    lines = [number for number, line in enumerate(data[start:].split(b"\n"), first) for _ in line.split()]
    return finite_numbers(path, words[:size], lines[:size])  # raises, with the line
