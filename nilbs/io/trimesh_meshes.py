"""OFF, STL and 3MF through trimesh, which sees only content of bounded size and of one file.

PLY and OBJ have readers of their own: trimesh 5.2 refuses a binary PLY file that mixes triangles and quads, and leaves
out its edges; it splits the vertices of an OBJ file along texture seams.
"""

import io
import logging
import os
import re
import warnings
import zipfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nilbs.geometry.surface import Surface
from nilbs.io.bounded import file_bytes, text_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.polygons import Elements, MeshFile, no_elements
from nilbs.io.text import utf8_lines, without_mark
from nilbs.io.zipped import open_zip, unpacked

SUFFIXES = (".off", ".stl", ".3mf")
TEXT_LIMIT = 2**26  # bytes of text: trimesh holds it as Python objects of some thirty times its size

_QUIET = logging.NullHandler()  # trimesh logs what it cannot read; without a handler that goes to standard error
_OFF = re.compile(r"\s*(?:ST|C|N)*OFF(.*)", re.DOTALL)
_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL file
# Corners, ends of facets, and x for a corner without three words.
_CORNERS = re.compile(r"^[ \t]*(?:(v)ertex(?:[ \t]+\S+){3}[ \t\r]*$|verte(x)|(e)ndloop)", re.IGNORECASE | re.MULTILINE)
_SOLID = re.compile(r"^[ \t]*solid\b(.*)$", re.IGNORECASE | re.MULTILINE)
_END = re.compile(r"^[ \t]*end[ \t]*solid.*$", re.IGNORECASE | re.MULTILINE)
_MODEL = "3d/3dmodel.model"
_PARENTS = {
    **{"resources": "model", "build": "model", "item": "build", "object": "resources"},
    **{"mesh": "object", "components": "object", "component": "components"},
}
_PACKED = 100  # times that a 3MF file may grow when it is unpacked
_ELEMENTS = 2**14  # objects, meshes, components and items of a 3MF file
_PLACED, _NESTED = 2**12, 16  # objects that a 3MF file may place, and how deep one may hold another
_TRIANGLES = 2**25  # that they may hold together


def read_trimesh(path: str | os.PathLike) -> MeshFile:
    """Read an OFF, STL or 3MF file; FileFormatError also if it would take too much memory or time."""
    file = {".off": _read_off, ".stl": _read_stl, ".3mf": _read_3mf}[Path(path).suffix.lower()](path)
    bad = np.flatnonzero(~np.isfinite(file.V).all(axis=1))
    if len(bad):
        raise FileFormatError(path, f"vertex {bad[0]} is {file.V[bad[0]].tolist()}; every number must be finite")
    return replace(file, V=np.array(file.V))  # a plain array, without trimesh's record of changes


def trimesh_bytes(path: str | os.PathLike, V: np.ndarray, F: np.ndarray) -> bytes:
    """The content of an OFF, STL or 3MF file; ValueError if STL's 32 bits cannot hold a coordinate."""
    suffix = Path(path).suffix.lower()
    size = np.abs(V).max(initial=0)
    if suffix == ".stl" and size > np.finfo(np.float32).max:
        raise ValueError(f"{path}: a coordinate of {size:.3g} is too large for .stl")
    # OFF is written with a fixed number of decimals: those that keep 17 digits of the largest coordinate.
    decimals: dict[str, Any] = {"digits": max(0, 16 - int(np.floor(np.log10(size or 1))))} if suffix == ".off" else {}
    content: Any = Surface(V, F).to_trimesh().export(file_type=suffix[1:], **decimals)
    return content.encode() if isinstance(content, str) else content


def _read_off(path: str | os.PathLike) -> MeshFile:
    found = _OFF.match(re.sub(r"#[^\n]*", "", _text(path)))
    if found is None:
        raise FileFormatError(path, "this is no OFF file of three dimensions: it does not start with 'OFF'")
    rows = [words for line in found[1].splitlines() if (words := line.split())]
    counts = rows[0] if rows else []
    if not 2 <= len(counts) <= 3 or not all(re.fullmatch(r"[0-9]{1,18}", word) for word in counts):
        raise FileFormatError(path, "the numbers of vertices and faces must follow 'OFF' (binary OFF is not read)")
    n, m = map(int, counts[:2])
    if len(rows) != 1 + n + m:
        raise FileFormatError(path, f"the file has {len(rows) - 1} rows, not those of {n} vertices and {m} faces")
    if "_" in found[1]:
        raise FileFormatError(path, "a word with '_' is not a number")  # Python reads 1_0 as 10
    if not (n and m):
        return MeshFile(path, np.zeros((n, 3)), no_elements(), no_elements(), first=0)
    (mesh,) = _scene(path, f"OFF{found[1]}".encode(), "off").geometry.values()
    # trimesh cuts polygons into fans, which is wrong where they are not convex, and takes short rows as they are.
    faces = rows[1 + n :]
    try:
        sizes = [int(row[0]) for row in faces]
        if any(not 0 < size < len(row) for size, row in zip(sizes, faces, strict=True)):
            raise ValueError
        words = [word for size, row in zip(sizes, faces, strict=True) for word in row[1 : 1 + size]]
        polygons = Elements(np.array([int(word) for word in words], np.int64), np.array(sizes, np.int64), None)
    except (ValueError, OverflowError):
        raise FileFormatError(path, "a face is a number of corners, and so many whole numbers of vertices") from None
    return MeshFile(path, mesh.vertices, polygons, no_elements(), first=0)


def _read_stl(path: str | os.PathLike) -> MeshFile:
    """Triangles; corners with equal coordinates are one vertex, in the order in which they first appear."""
    data = file_bytes(path)
    count = int.from_bytes(data[80:_HEADER], "little")
    size = _HEADER + count * _TRIANGLE
    groups: dict[str, list[np.ndarray]] = {}
    if len(data) == size or not without_mark(path, data)[:100].lstrip().lower().startswith(b"solid"):
        if len(data) < max(size, _HEADER):
            raise FileFormatError(
                path, f"this is no STL file: it neither starts with 'solid' nor holds {count} triangles"
            )
        scene = _scene(path, data[:size], "stl")  # bytes behind the triangles are skipped
    else:
        _, *solids = _SOLID.split(_text(path))
        facets = [_END.sub("", body) for body in solids[1::2]]
        letters = ["".join(map("".join, _CORNERS.findall(body))).lower() for body in facets]
        if any(word != "vvve" * (len(word) // 4) for word in letters):
            raise FileFormatError(path, "every facet needs three corners of three numbers each")
        count = sum(map(len, letters)) // 4
        stops = np.cumsum([len(word) // 4 for word in letters])
        for name, word, stop in zip(solids[::2], letters, stops, strict=True):
            if name.strip() and word:
                groups.setdefault(name.strip(), []).append(np.arange(stop - len(word) // 4, stop))
        # Several solids become one: trimesh would merge their vertices, and takes long to name them.
        scene = _scene(path, f"solid\n{''.join(facets)}\nendsolid\n".encode(), "stl")
    corners = np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in scene.geometry.values())])
    if len(corners) != 3 * count:
        raise FileFormatError(path, f"trimesh finds {len(corners)} corners in {count} facets")
    _, first, place = np.unique(corners + 0.0, axis=0, return_index=True, return_inverse=True)  # -0.0 is 0.0
    corner = np.argsort(np.argsort(first))[place.ravel()]
    triangles = Elements(corner, np.full(count, 3), None)
    faces_of = {name: np.concatenate(faces) for name, faces in groups.items()}
    return MeshFile(path, corners[np.sort(first)] + 0.0, triangles, no_elements(), 0, faces_of)


def _read_3mf(path: str | os.PathLike) -> MeshFile:
    """The objects that a 3MF file places, in trimesh's order, each a group; numbers are in the unit of the file."""
    archive = open_zip(path)
    names = [name for name in archive.namelist() if _MODEL in name.lower()]
    if len(names) != 1:
        raise FileFormatError(path, f"a 3MF file holds one {_MODEL}; here are {len(names)}")
    size, packed = archive.getinfo(names[0]).file_size, os.path.getsize(path)
    if size > max(2**20, _PACKED * packed):
        raise FileFormatError(path, f"{names[0]} unpacks to {size} bytes, from a file of {packed}")
    model = unpacked(path, archive, names[0], limit=TEXT_LIMIT)
    _check_model(path, model)
    alone = io.BytesIO()  # trimesh does not see the other members
    with zipfile.ZipFile(alone, "w") as copy:
        copy.writestr("3D/3dmodel.model", model)
    scene = _scene(path, alone.getvalue(), "3mf")
    V, corners, groups = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], {}
    n = m = 0
    with _guarded(path, "3mf"):
        for node in scene.graph.nodes_geometry:
            matrix, name = scene.graph[node]
            if name not in scene.geometry:  # an object without a mesh
                continue
            mesh = scene.geometry[name].copy()
            if m + len(mesh.faces) > _TRIANGLES:
                raise FileFormatError(path, f"its objects hold more than {_TRIANGLES} triangles together")
            V.append(mesh.apply_transform(matrix).vertices)  # and turns the faces of a mirrored object
            corners.append(mesh.faces + n)
            groups[node] = np.arange(m, m + len(mesh.faces))
            n, m = n + len(mesh.vertices), m + len(mesh.faces)
    unit = str(scene.metadata.get("units", ""))[:40]
    notes = () if unit.startswith("millimeter") else (f"its numbers are in {unit}, and are kept as they are",)
    faces = Elements(np.concatenate(corners).ravel(), np.full(m, 3), None)
    return MeshFile(path, np.concatenate(V), faces, no_elements(), 0, groups if len(groups) > 1 else {}, notes)


def _check_model(path: str | os.PathLike, model: bytes) -> None:
    """Refuse what trimesh would follow out of the file, or into too many objects."""
    from lxml import etree

    if b"\0" in model or b"<!DOCTYPE" in model:
        raise FileFormatError(path, "its model is no plain XML in UTF-8")
    parts: dict[str, Counter[str]] = defaultdict(Counter)
    try:
        holder = ""
        tags = [f"{{*}}{name}" for name in _PARENTS]
        elements = etree.iterparse(
            io.BytesIO(model), events=("start",), tag=tags, resolve_entities=False, no_network=True, huge_tree=False
        )
        for number, (_, element) in enumerate(elements):
            if number >= _ELEMENTS:
                raise FileFormatError(path, f"its model has more than {_ELEMENTS} objects, meshes and items")
            kind, parent = (str(getattr(e, "tag", "")).rpartition("}")[2] for e in (element, element.getparent()))
            if parent != _PARENTS[kind]:  # trimesh would read it twice
                raise FileFormatError(path, f"its model has {kind} in {parent or 'nothing'}, not in {_PARENTS[kind]}")
            if kind == "object":
                holder = element.attrib["id"]
            if kind in ("item", "component"):
                if any(name.endswith("path") for name in element.attrib):
                    raise FileFormatError(path, "its objects lie in several files: export them as one model")
                parts["" if kind == "item" else holder][element.attrib["objectid"]] += 1
    except (etree.XMLSyntaxError, KeyError) as error:
        raise FileFormatError(path, f"its model cannot be read: {error}") from None
    placed, found = parts[""], 0
    if not placed:
        raise FileFormatError(path, "it places no object")
    edges = sum(map(Counter.total, parts.values()))
    for _ in range(_NESTED):
        found += placed.total()
        if found > min(_PLACED, edges * len(parts)):  # beyond the second limit trimesh drops objects silently
            raise FileFormatError(path, f"it places more than {_PLACED} objects, or too many of one another")
        inner: Counter[str] = Counter()
        for name, times in placed.items():
            for part, often in parts.get(name, Counter()).items():
                inner[part] += times * often
        placed = inner
    if placed:
        raise FileFormatError(path, f"its objects hold one another more than {_NESTED} times deep")


def _scene(path: str | os.PathLike, data: bytes, kind: str) -> Any:
    """What trimesh makes of the content of a file; without a path, so that it reads no other file."""
    import trimesh

    with _guarded(path, kind):
        return trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, postprocess=False)


@contextmanager
def _guarded(path: str | os.PathLike, kind: str) -> Iterator[None]:
    """Whatever goes wrong inside trimesh is an error of the file."""
    logging.getLogger("trimesh").addHandler(_QUIET)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):  # what overflows is reported as not finite
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", DeprecationWarning)  # numpy warns so of text that is not a number
            yield
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"[:200]
        raise FileFormatError(path, f"trimesh cannot read this .{kind} file ({reason})") from None


def _text(path: str | os.PathLike) -> str:
    data = text_bytes(path, limit=TEXT_LIMIT)
    if b"\0" in data:
        raise FileFormatError(path, "binary data where text was expected")
    return b"".join(utf8_lines(data.splitlines(keepends=True))[0]).decode()
