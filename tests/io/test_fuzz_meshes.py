"""Readers of meshes return a usable mesh or raise FileFormatError, for any content."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nilbs.io import FileFormatError
from nilbs.io.bundle import select_group
from nilbs.io.mesh import read_mesh_parts

OBJ = "o body\nv 0 0 1\nv 1 0 0\nv 0 1 0\nv 1 1 1 0.5 0.5 0.5\ng a b\nf 1/1 2/2 3\ng\nf 1 2 -1 3\n"
OFF = "COFF\n4 2 0\n0 0 1 1 1 1 1\n1 0 0 1 1 1 1\n1 1 0 1 1 1 1\n0 1 0 1 1 1 1\n3 0 1 2\n4 0 1 2 3 255 0 0\n"
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 1\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
STL = f"solid a b\n{FACET}endsolid\nsolid c\n{FACET}endsolid\n"
BINARY_STL = b"solid".ljust(80) + struct.pack("<I", 2) + struct.pack("<12fH", *range(12), 0) * 2

# Name: (a good file, words of such files).
FORMATS = {
    "a.obj": (
        OBJ.encode(),
        ["v", "f", "l", "g", "o", "a", "1", "-1", "0", "2/1", "3", "0.5", "nan", "\\", "#", "é", "1_0"],
    ),
    "a.off": (OFF.encode(), ["OFF", "BINARY", "4OFF", "#", "0", "1", "3", "-1", "0.5", "nan", "9" * 25, "1_0", "x"]),
    "a.stl": (
        STL.encode(),
        ["solid", "facet", "outer loop", "vertex", "endloop", "1", "0.5", "nan", "1_0", "é", "end"],
    ),
    "b.stl": (BINARY_STL, ["solid", "\0\0\0\0", "\xff\xff\xff\x7f", "\x02\0\0\0", "vertex"]),
}


def read_or_refused(path, content):
    """The mesh, or None if the file is refused with one line that names it."""
    path.unlink(missing_ok=True)  # replacing a file is much slower on some disks than writing a new one
    path.write_bytes(content)
    message = ""
    try:
        mesh = read_mesh_parts(path)
    except FileFormatError as error:
        message = str(error)
    assert not message or (path.name in message and "\n" not in message)
    if message:
        return None
    assert np.isfinite(mesh.V).all()
    assert ((mesh.E >= 0) & (len(mesh.V) > mesh.E)).all()
    assert (np.diff(np.sort(mesh.E, axis=1), axis=1) > 0).all()
    for name, faces in mesh.groups.items():
        assert len(faces)
        assert (np.diff(faces) > 0).all()
        V, E, kept = select_group(mesh, name)
        assert np.array_equal(V, mesh.V[kept])
        assert np.array_equal(kept[E], mesh.E[faces])
    return mesh


@pytest.fixture(params=FORMATS)
def form(request, tmp_path):
    good, words = FORMATS[request.param]
    path = tmp_path / request.param
    assert read_or_refused(path, good) is not None
    return path, good, words


@settings(max_examples=40)
@given(content=st.binary(max_size=300))
def test_any_bytes(form, content):
    read_or_refused(form[0], content)


@settings(max_examples=40)
@given(data=st.data())
def test_a_good_file_damaged(form, data):
    path, good, _ = form
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged)))
        stop = at + data.draw(st.sampled_from([0, 0, 1, 1, 4, 60]))
        damaged[at:stop] = data.draw(st.binary(max_size=4) | st.sampled_from([b"", b"-", b"9" * 19, b"\xff" * 4, b" "]))
    read_or_refused(path, bytes(damaged))


@settings(max_examples=40)
@given(data=st.data())
def test_the_right_words_in_any_order(form, data):
    path, good, words = form
    ends = st.sampled_from([" ", "\n", ""])
    pairs = data.draw(st.lists(st.tuples(st.sampled_from(words), ends), max_size=30))
    drawn = "".join(word + end for word, end in pairs)
    start = data.draw(st.sampled_from([0, len(good) // 2, len(good)]))
    read_or_refused(path, good[:start] + drawn.encode("latin-1"))


def test_cut_anywhere(form):
    path, good, _ = form
    for end in range(len(good)):
        read_or_refused(path, good[:end])


@settings(max_examples=40)
@given(data=st.data())
def test_any_polygons(tmp_path, data):
    """On a small lattice corners coincide, sides overlap and polygons cross themselves often."""
    height = data.draw(st.sampled_from([1, 3]))
    V = [
        [data.draw(st.integers(0, 3)), data.draw(st.integers(0, 3)), data.draw(st.integers(1, height))]
        for _ in range(9)
    ]
    polygons = data.draw(st.lists(st.lists(st.integers(1, 9), max_size=12), min_size=1, max_size=5))
    groups = data.draw(st.lists(st.sampled_from(["g a", "g b a", "o c", "g", ""]), min_size=5, max_size=5))
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in V)
    text += "".join(f"{g}\nf {' '.join(map(str, p))}\n" for g, p in zip(groups, polygons, strict=False))
    mesh = read_or_refused(tmp_path / "a.obj", text.encode())
    if any(len(polygon) == len(set(polygon)) == 3 for polygon in polygons):
        assert mesh is not None
    # Flat, the same polygons are refused only where they cross themselves.
    flat = text.replace(" 1\nv", " 0\nv").replace(" 1\ng", " 0\ng") if height == 1 else ""
    read_or_refused(tmp_path / "flat.obj", flat.encode())
