"""Wavefront OBJ: vertices in the file's order and number, whatever textures and groups stand beside them."""

import os
from array import array

import numpy as np

from nilbs.io.bounded import line_blocks
from nilbs.io.errors import FileFormatError
from nilbs.io.names import text_of
from nilbs.io.polygons import Elements, MeshFile
from nilbs.io.words import finite_numbers, whole_numbers

# x y z, then a weight, a colour or both: never used.
_VERTEX_LENGTHS = (4, 5, 7, 8)
_GROUPS_PER_FACE = 16


def read_obj(path: str | os.PathLike) -> MeshFile:
    """Read vertices, faces and line elements of an OBJ file.

    Corners may be written `v`, `v/vt`, `v//vn` or `v/vt/vn`, with negative indices counting back from the last vertex.
    A line `g` puts the faces after it into groups, one for each of its words, a line `o` into an object besides, whose
    name is the rest of the line. Materials, textures, normals and colours are left out; an unused vertex stays.
    """
    blocks: list[np.ndarray] = [np.zeros((0, 3))]
    faces, edges, groups = _Corners(path), _Corners(path), _Groups(path)
    n = 0
    carried: list[bytes] = []
    notes: list[str] = []
    for first, lines in line_blocks(path, notes):
        words_of: list[bytes] = []
        at: list[int] = []
        for number, line in enumerate(lines, first):
            words = line.split()
            if carried:
                words, carried = carried + words, []
            if not words:
                continue
            kind = words[0]
            if kind not in (b"v", b"f", b"l", b"g", b"o"):
                continue
            if words[-1].endswith(b"\\"):  # the statement goes on in the next line
                carried = [*words[:-1], words[-1][:-1]] if words[-1] != b"\\" else words[:-1]
                continue
            if kind in (b"g", b"o"):
                groups.change(kind, words[1:])
                continue
            if b"#" in line:
                words = b" ".join(words).partition(b"#")[0].split()
            if kind == b"v":
                if len(words) not in _VERTEX_LENGTHS:
                    raise FileFormatError(path, f"a vertex needs three coordinates, got {len(words) - 1}", number)
                words_of += words[1:4]
                at.append(number)
            elif kind == b"f":
                faces.add(words[1:], number, n + len(at))
                groups.add_face()
            else:  # a polyline is its edges
                for start in range(1, len(words) - 1):
                    edges.add(words[start : start + 2], number, n + len(at))
        V = finite_numbers(path, words_of, at) if at else blocks[0]
        n += len(V)
        blocks.append(V)
        faces.convert()
        edges.convert()
    if carried:
        raise FileFormatError(path, "the file ends in the middle of a statement")
    named = groups.faces_by_name()
    notes = [] if all(map(str.isascii, named)) else notes
    return MeshFile(path, np.concatenate(blocks), faces.elements(), edges.elements(), 1, named, tuple(notes))


class _Corners:
    """The corners of faces or lines: words first, then, block by block, indices."""

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = path
        self.words: list[bytes] = []
        self.counts: list[int] = []
        self.lines: list[int] = []
        self.seen: list[int] = []  # vertices before each element, for negative indices
        self.blocks: list[tuple[np.ndarray, ...]] = [(np.zeros(0, np.int64),) * 3]

    def add(self, words: list[bytes], line: int, seen: int) -> None:
        self.words += words
        self.counts.append(len(words))
        self.lines.append(line)
        self.seen.append(seen)

    def convert(self) -> None:
        counts = np.array(self.counts, np.int64)
        lines = np.array(self.lines, np.int64)
        corners = whole_numbers(self.path, [word.partition(b"/")[0] for word in self.words], counts, lines)
        zero = np.flatnonzero(corners == 0)
        if len(zero):
            line = int(lines[np.searchsorted(np.cumsum(counts), zero[0], side="right")])
            raise FileFormatError(self.path, "0 is not a vertex: vertices count from 1", line)
        corners = np.where(corners < 0, corners + np.repeat(np.array(self.seen, np.int64), counts), corners - 1)
        self.blocks.append((corners, counts, lines))
        self.words, self.counts, self.lines, self.seen = [], [], [], []

    def elements(self) -> Elements:
        corners, counts, lines = (np.concatenate(parts) for parts in zip(*self.blocks, strict=True))
        return Elements(corners, counts, lines)


class _Groups:
    """The groups and the object that faces belong to."""

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = path
        self.named: dict[bytes, list[bytes]] = {b"g": [], b"o": []}  # what holds for the faces that follow
        self.states: dict[tuple[bytes, ...], int] = {(): 0}
        self.state: int | None = 0  # None until the next face needs it
        self.of_face = array("i")

    def change(self, kind: bytes, words: list[bytes]) -> None:
        comment = next((i for i, word in enumerate(words) if word.startswith(b"#")), len(words))
        words = words[:comment]
        # A line lists several groups; an object has one name, with its spaces.
        self.named[kind] = words if kind == b"g" else [b" ".join(words)] * bool(words)
        self.state = None

    def add_face(self) -> None:
        if self.state is None:
            names = tuple(dict.fromkeys([*self.named[b"o"], *self.named[b"g"]]))
            self.state = self.states.setdefault(names, len(self.states))
        self.of_face.append(self.state)

    def faces_by_name(self) -> dict[str, np.ndarray]:
        of_face = np.array(self.of_face, dtype=np.int64)
        order = np.argsort(of_face, kind="stable")
        ends = np.cumsum(np.bincount(of_face, minlength=len(self.states)))
        sizes = np.diff(ends, prepend=0)
        listed = sum(len(names) * int(size) for names, size in zip(self.states, sizes, strict=True))
        if listed > _GROUPS_PER_FACE * len(of_face) + 1000:  # a short file could fill the memory with them
            raise FileFormatError(self.path, f"its faces are in {listed / len(of_face):.0f} groups each, on average")
        states: dict[str, list[int]] = {}
        for names, state in self.states.items():
            for name in dict.fromkeys(map(text_of, names)):
                states.setdefault(name, []).append(state)
        return {
            name: np.sort(np.concatenate([order[ends[state] - sizes[state] : ends[state]] for state in those]))
            for name, those in states.items()
        }
