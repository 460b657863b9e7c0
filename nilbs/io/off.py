"""OFF as text: vertices and polygons; colours, normals and texture coordinates beside them are skipped."""

import codecs
import os
import re
from collections.abc import Iterator
from itertools import islice

import numpy as np

from nilbs.io.bounded import line_blocks
from nilbs.io.errors import FileFormatError
from nilbs.io.polygons import Elements, MeshFile, no_elements
from nilbs.io.words import finite_numbers, whole_numbers

_KEYWORD = re.compile(rb"((?:ST|C|N)*)(4?)(n?)OFF")
_ROWS = 2**16  # rows held at a time

_Row = tuple[int, list[bytes]]


def read_off(path: str | os.PathLike) -> MeshFile:
    r"""Read the vertices and faces of an OFF file.

    The keyword may be OFF, or carry C, N or ST for colours, normals and texture coordinates, and the counts may stand
    behind it; comments start with `#`. What a row holds beyond its three coordinates or its corners is skipped.

    Raises
    ------
    FileFormatError
        With the line, if the file is binary or in four or more dimensions, has other numbers of rows than it says, or
        holds a coordinate that is not finite or a corner that is no whole number.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.off"
    >>> _ = path.write_text("OFF\n3 1 0\n0 0 0 # origin\n1 0 0\n0 1 0\n3 0 1 2 255 0 0\n")
    >>> read_off(path).faces.corners
    array([0, 1, 2])
    """
    rows = _rows(path)
    n, m = _counts(path, rows)
    V, last = _vertices(path, rows, n)
    faces = _faces(path, rows, m, last)
    beyond = next(rows, None)
    if beyond:
        raise FileFormatError(path, f"a row after the {n} vertices and {m} faces that the file says it has", beyond[0])
    return MeshFile(path, V, faces, no_elements(), first=0)


def _rows(path: str | os.PathLike) -> Iterator[_Row]:
    """Lines that hold words, without comments, and their numbers."""
    for first, lines in line_blocks(path):
        for number, line in enumerate(lines, first):
            words = (line.partition(b"#")[0] if b"#" in line else line).split()
            if words:
                yield number, words


def _counts(path: str | os.PathLike, rows: Iterator[_Row]) -> tuple[int, int]:
    number, words = next(rows, (1, [b""]))
    word = words[0].removeprefix(codecs.BOM_UTF8)
    keyword = _KEYWORD.match(word)
    if keyword is None:
        raise FileFormatError(path, "this is no OFF file: it does not start with 'OFF'", number)
    if keyword[2] or keyword[3]:
        raise FileFormatError(path, "an OFF file of more than three dimensions", number)
    if b"BINARY" in words:
        raise FileFormatError(path, "binary OFF is not read: save the mesh as text, or as PLY", number)
    glued = word[keyword.end() :]
    words = [glued] * bool(glued) + words[1:]  # some write the counts into the first line, even without a space
    if not words:
        number, words = next(rows, (number, []))
    if not 2 <= len(words) <= 3 or not all(word.isdigit() and len(word) < 19 for word in words):
        raise FileFormatError(path, "the numbers of vertices and faces must follow 'OFF'", number)
    return int(words[0]), int(words[1])


def _vertices(path: str | os.PathLike, rows: Iterator[_Row], n: int) -> tuple[np.ndarray, int]:
    """Vertices, and the last line of them."""
    blocks, last, found = [np.zeros((0, 3))], 1, 0
    while found < n:
        words_of: list[bytes] = []
        at: list[int] = []
        for number, words in islice(rows, min(_ROWS, n - found)):
            if len(words) < 3:
                raise FileFormatError(path, f"a vertex needs three coordinates, got {len(words)}", number)
            words_of += words[:3]
            at.append(number)
        if not at:
            raise FileFormatError(path, f"the file ends after {found} of {n} vertices")
        blocks.append(finite_numbers(path, words_of, at))
        last, found = at[-1], found + len(at)
    return np.concatenate(blocks), last


def _faces(path: str | os.PathLike, rows: Iterator[_Row], m: int, last: int) -> Elements:
    none = no_elements()
    blocks = [(none.corners, none.counts, none.counts)]
    found = 0
    while found < m:
        words_of: list[bytes] = []
        sizes: list[int] = []
        at: list[int] = []
        for number, words in islice(rows, min(_ROWS, m - found)):
            size = int(words[0]) if words[0].isdigit() and len(words[0]) < 19 else len(words)
            if not 0 < size < len(words):
                raise FileFormatError(path, "a face is a number of corners, and so many vertices", number)
            words_of += words[1 : 1 + size]
            sizes.append(size)
            at.append(number)
        if not at:
            raise FileFormatError(path, f"the file ends after {found} of {m} faces")
        counts, lines = np.array(sizes, np.int64), np.array(at, np.int64)
        blocks.append((whole_numbers(path, words_of, counts, lines), counts, lines))
        found += len(at)
    return Elements(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
