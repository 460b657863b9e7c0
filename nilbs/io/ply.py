"""Stanford PLY, as text and binary: vertices, faces and edges; every other property is skipped."""

import io
import os
from dataclasses import dataclass
from itertools import islice
from typing import BinaryIO, Literal

import numpy as np

from nilbs.io.bounded import file_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.polygons import Elements, MeshFile, no_elements
from nilbs.io.text import line_feeds, without_mark

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_LIMIT = 2**16  # bytes
_ROWS = 2**16  # rows of text held at a time


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count: str | None  # the type of a list's length; None for a single value


@dataclass
class _Element:
    name: str
    size: int
    properties: list[_Property]


def read_ply(path: str | os.PathLike) -> MeshFile:
    """Read the vertices, faces and edges of a PLY file."""
    data = without_mark(path, file_bytes(path))
    if b"format ascii" in data[:_HEADER_LIMIT]:
        data = line_feeds(data)
    order, elements, start, line = _header(path, data)
    tables: dict[str, dict[str, np.ndarray]] = {}
    lines: dict[str, np.ndarray | None] = {}
    text = io.BytesIO(data)
    text.seek(start)
    binary = _Binary(path, data, start, order)
    for element in elements:
        if order == "":
            tables[element.name] = _text_rows(path, element, text, line)
            lines[element.name] = np.arange(line, line + element.size)
            line += element.size
        else:
            tables[element.name] = binary.columns(element)
            lines[element.name] = None
    vertex = tables.get("vertex", {})
    if not _has(vertex, "x", "y", "z"):
        raise FileFormatError(path, "the header names no vertex element with x, y and z")
    with np.errstate(invalid="ignore"):  # a signalling NaN is reported below, with its place
        V = np.stack([vertex[c].astype(np.float64) for c in "xyz"], axis=1)
    bad = np.flatnonzero(~np.isfinite(V).all(axis=1))
    if len(bad):
        at = lines["vertex"]
        message = f"vertex {bad[0]} is {V[bad[0]].tolist()}; every number must be finite"
        raise FileFormatError(path, message, None if at is None else int(at[bad[0]]))
    face, edge = tables.get("face", {}), tables.get("edge", {})
    faces = edges = no_elements()
    for name in ("vertex_indices", "vertex_index"):
        if f"{name} count" in face:
            counts = face[f"{name} count"].astype(np.int64)
            faces = Elements(_indices(path, face[name]), counts, lines["face"])
    if _has(edge, "vertex1", "vertex2"):
        ends = [_indices(path, edge[name]) for name in ("vertex1", "vertex2")]
        edges = Elements(np.stack(ends, axis=1).ravel(), np.full(len(ends[0]), 2), lines["edge"])
    return MeshFile(path, V, faces, edges, first=0)


def _has(table: dict[str, np.ndarray], *names: str) -> bool:
    """Whether an element has these properties, one value each."""
    return all(name in table and f"{name} count" not in table for name in names)


def _indices(path: str | os.PathLike, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "iu":
        raise FileFormatError(path, "the header gives vertex indices a type that is not whole numbers")
    return values.astype(np.int64)


def _header(path: str | os.PathLike, data: bytes) -> tuple[str, list[_Element], int, int]:
    """The byte order ("" for text), the elements, and where the rows start: byte and line."""
    end = data.find(b"end_header", 0, _HEADER_LIMIT)
    stop = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or stop == 0:
        raise FileFormatError(path, "this is no PLY file: it has no header from 'ply' to 'end_header'", 1)
    order = None
    elements: list[_Element] = []
    rows = data[:end].decode("latin-1").split("\n")
    for number, row in enumerate(rows, 1):
        match row.split():
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, size] if size.isascii() and size.isdecimal() and len(size) < 19:
                elements.append(_Element(name, int(size), []))
            case ["property", "list", count, kind, name] if elements and {count, kind} <= _TYPES.keys():
                if _TYPES[count][0] == "f":
                    raise FileFormatError(path, "the length of a list must be a whole number", number)
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind], None))
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise FileFormatError(path, f"cannot read the header line {row.strip()[:80]!r}", number)
    if order is None:
        raise FileFormatError(path, "the header names no format")
    for element in elements:
        names = [p.name for p in element.properties]
        if not names or len(set(names)) < len(names):
            raise FileFormatError(path, f"element {element.name} must have properties, each of another name")
    if len({element.name for element in elements}) < len(elements):
        raise FileFormatError(path, "the header names an element twice")
    return order, elements, stop, len(rows) + 1


class _Binary:
    """The rows of one element after the other, from a byte on."""

    def __init__(self, path: str | os.PathLike, data: bytes, start: int, order: str) -> None:
        self.path, self.data, self.start, self.order = path, data, start, order

    def columns(self, element: _Element) -> dict[str, np.ndarray]:
        """The columns of an element; a list is its values one row after the other, and their counts."""
        counts = self._first_counts(element) if element.size else {}
        table = self._table(element, counts)
        stop = self.start + element.size * table.itemsize
        if stop <= len(self.data):
            columns = np.frombuffer(self.data, table, count=element.size, offset=self.start)
            if all((columns[f"{name} count"] == count).all() for name, count in counts.items()):
                self.start = stop
                return {name: columns[name].ravel() for name in columns.dtype.names or ()}
        elif not any(p.count for p in element.properties):
            raise FileFormatError(self.path, f"the file ends within its {element.size} rows of {element.name}")
        return self._uneven(element)

    def _uneven(self, element: _Element) -> dict[str, np.ndarray]:
        """The same row by row, for lists of different lengths."""
        columns: dict[str, list[np.ndarray]] = {}
        for first in range(0, element.size, _ROWS):
            values: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
            counts: dict[str, list[int]] = {p.name: [] for p in element.properties}
            for row in range(first, min(first + _ROWS, element.size)):
                for p in element.properties:
                    count, start, self.start = self._value(element, p, self.start, row)
                    counts[p.name].append(count)
                    values[p.name].append(self.data[start : self.start])
            for p in element.properties:
                columns.setdefault(p.name, []).append(np.frombuffer(b"".join(values[p.name]), self.order + p.type))
                if p.count:
                    columns.setdefault(f"{p.name} count", []).append(np.array(counts[p.name], p.count))
        return {name: np.concatenate(parts) for name, parts in columns.items()}

    def _first_counts(self, element: _Element) -> dict[str, int]:
        """The lengths of the lists of the first row: as a rule, of every row."""
        counts: dict[str, int] = {}
        stop = self.start
        for p in element.properties:
            count, _, stop = self._value(element, p, stop, 0)
            if p.count:
                counts[p.name] = count
        return counts

    def _value(self, element: _Element, p: _Property, start: int, row: int) -> tuple[int, int, int]:
        """How many numbers a property has in a row, and where they start and stop."""
        count = 1
        if p.count:
            at, start = start, start + int(p.count[1])
            order: Literal["little", "big"] = "little" if self.order == "<" else "big"
            count = int.from_bytes(self.data[at:start], order, signed=p.count[0] == "i")
            if start <= len(self.data) and not 0 <= count <= len(self.data):
                raise FileFormatError(self.path, f"row {row} of {element.name} has a list of {count} values")
        stop = start + max(count, 0) * int(p.type[1])
        if stop > len(self.data):
            raise FileFormatError(self.path, f"the file ends within row {row} of {element.size} of {element.name}")
        return count, start, stop

    def _table(self, element: _Element, counts: dict[str, int]) -> np.dtype:
        fields: list[tuple] = []
        for p in element.properties:
            if p.count:
                fields.append((f"{p.name} count", self.order + p.count))
            fields.append((p.name, self.order + p.type, *[(counts.get(p.name, 0),)] * bool(p.count)))
        return np.dtype(fields)


def _text_rows(path: str | os.PathLike, element: _Element, text: BinaryIO, line: int) -> dict[str, np.ndarray]:
    columns: dict[str, list[np.ndarray]] = {
        name: [values] for name, values in _text_block(path, element, [], line).items()
    }
    for first in range(0, element.size, _ROWS):
        size = min(_ROWS, element.size - first)
        rows = list(islice(text, size))
        for name, values in _text_block(path, element, rows, line + first).items():
            columns[name].append(values)
        if len(rows) < size:
            raise FileFormatError(
                path, f"the file ends after {first + len(rows)} of {element.size} rows of {element.name}"
            )
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def _text_block(path: str | os.PathLike, element: _Element, rows: list[bytes], line: int) -> dict[str, np.ndarray]:
    values: dict[str, list] = {p.name: [] for p in element.properties}
    values.update({f"{p.name} count": [] for p in element.properties if p.count})
    whole = {p.name: p.type[0] in "iu" for p in element.properties}
    for number, row in enumerate(rows, line):
        words = row.split()
        at = 0
        try:
            if b"_" in row:  # float() would read 1_0 as 10
                raise ValueError
            for p in element.properties:
                size = 1
                if p.count:
                    size, at = int(words[at]), at + 1
                    values[f"{p.name} count"].append(size)
                if size < 0 or at + size > len(words):
                    raise IndexError
                values[p.name] += map(int if whole[p.name] else float, words[at : at + size])
                at += size
            if at < len(words):
                raise IndexError
        except IndexError:
            message = f"this row of {element.name} has {len(words)} words, not the number it needs"
            raise FileFormatError(path, message, number) from None
        except ValueError:
            message = f"this row of {element.name} holds a word that is not the number it should be"
            raise FileFormatError(path, message, number) from None
    try:
        return {name: np.array(v, np.int64 if whole.get(name, True) else np.float64) for name, v in values.items()}
    except OverflowError:
        raise FileFormatError(path, f"a whole number of element {element.name} is too large") from None
