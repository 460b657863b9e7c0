"""STL, as text and binary: triangles whose corners are merged where they are equal."""

import os
import re

import numpy as np

from nilbs.io.bounded import file_bytes, line_blocks
from nilbs.io.errors import FileFormatError
from nilbs.io.polygons import Elements, MeshFile, no_elements
from nilbs.io.words import finite_numbers

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes
_STARTS = (b"facet", b"outer", b"color", b"endfacet", b"end")
_NAMED = re.compile(rb"\s*solid", re.IGNORECASE)


def read_stl(path: str | os.PathLike) -> MeshFile:
    r"""Read the triangles of an STL file.

    STL knows no vertices. Corners with equal coordinates are one vertex here, and vertices stand in the order in which
    they first appear. Normals, colours and attributes are skipped. In a text file every `solid` with a name is a
    group. A file is binary where its size is what its count of triangles tells, even if it starts with `solid`.

    Raises
    ------
    FileFormatError
        With the line of a text file, if it ends within a triangle or a corner is not three finite numbers.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.stl"
    >>> corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    >>> _ = path.write_text(f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid a\n")
    >>> read_stl(path).V.shape
    (3, 3)
    """
    data = file_bytes(path)
    count = int.from_bytes(data[80:_HEADER], "little")
    size = _HEADER + count * _TRIANGLE.itemsize
    lines: np.ndarray | None = None
    groups: dict[str, np.ndarray] = {}
    if len(data) == size or not _NAMED.match(data[:100]):
        if len(data) < max(size, _HEADER):
            message = f"this is no STL file: it neither starts with 'solid' nor holds {count} triangles"
            raise FileFormatError(path, message if len(data) >= _HEADER else message.split(" nor")[0])
        corners = np.frombuffer(data, _TRIANGLE, count=count, offset=_HEADER)["corners"].reshape(-1, 3)
        with np.errstate(invalid="ignore"):  # a signalling NaN is reported below
            corners = corners.astype(np.float64)
        bad = np.flatnonzero(~np.isfinite(corners).all(axis=1))
        if len(bad):
            raise FileFormatError(path, f"triangle {bad[0] // 3} has a corner that is not finite")
    else:
        del data
        corners, lines, groups = _text(path)
    V, corner = _merged(corners)
    return MeshFile(path, V, Elements(corner, np.full(len(corner) // 3, 3), lines), no_elements(), 0, groups)


def _text(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Corners, the lines of the triangles and the triangles of every solid that has a name."""
    blocks = [np.zeros((0, 3))]
    lines: list[int] = []
    starts: list[tuple[str, int]] = []
    n = 0
    for first, rows in line_blocks(path):
        words_of: list[bytes] = []
        at: list[int] = []
        for number, row in enumerate(rows, first):
            words = row.split()
            kind = words[0].lower() if words else b"color"
            if kind == b"vertex":
                if len(words) != 4:
                    raise FileFormatError(path, f"a corner needs three coordinates, got {len(words) - 1}", number)
                words_of += words[1:]
                at.append(number)
            elif kind == b"endloop":
                if n + len(at) != 3 * len(lines) + 3:
                    raise FileFormatError(path, "a facet needs three corners", number)
                lines.append(number)
            elif kind == b"solid":
                starts.append((b" ".join(words[1:]).decode("utf-8", "replace"), len(lines)))
            elif kind not in _STARTS and not kind.startswith(b"endsolid"):
                raise FileFormatError(path, f"cannot read {row.strip()[:40].decode('latin-1')!r}", number)
        if at:
            blocks.append(finite_numbers(path, words_of, at))
            n += len(at)
    if n != 3 * len(lines):
        raise FileFormatError(path, "the file ends within a facet")
    groups: dict[str, list[np.ndarray]] = {}
    for (name, start), stop in zip(starts, [start for _, start in starts[1:]] + [len(lines)], strict=True):
        if name and stop > start:
            groups.setdefault(name, []).append(np.arange(start, stop))
    return np.concatenate(blocks), np.array(lines, np.int64), {k: np.concatenate(v) for k, v in groups.items()}


def _merged(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different corners in the order of their first appearance, and which one each is."""
    corners = corners + 0.0  # -0.0 is 0.0
    order = np.lexsort(corners.T)
    new = np.ones(len(corners), dtype=bool)
    new[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    first = order[new]  # the sort is stable
    place = np.empty(len(corners), dtype=np.int64)
    place[order] = np.cumsum(new) - 1
    rank = np.argsort(np.argsort(first))
    return corners[np.sort(first)], rank[place]
