"""Text files of any encoding and line ends hold the same as in UTF-8."""

import codecs

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_bundle, read_dmat, read_mesh, read_motion_json, read_tgf
from nilbs.io.bvh import read_bvh
from nilbs.io.mesh import read_mesh_parts
from nilbs.io.rignet import read_rignet
from nilbs.io.text import utf8_lines

TETRAHEDRON = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 1\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
BVH = "HIERARCHY\nROOT {}\n{{ OFFSET 0 1 0\nCHANNELS 3 Xrotation Yrotation Zrotation\nJOINT {}\n{{ OFFSET 0 1 0 }} }}\n"
BVH += "MOTION\nFrames: 2\nFrame Time: 0.1\n0 0 0\n0 0 90\n"
FILES = {
    "a.obj": ("".join(f"v {row}\n" for row in TETRAHEDRON.splitlines()) + "g one\nf 1 3 2\nf 1 2 4\n", read_mesh),
    "a.off": (f"OFF\n4 4 0\n{TETRAHEDRON}{FACES}", read_mesh),
    "a.stl": (f"solid a\n{FACET}endsolid a\n", read_mesh),
    "a.ply": (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face 4\nproperty list uchar int vertex_indices\nend_header\n{TETRAHEDRON}{FACES}",
        read_mesh,
    ),
    "a.tgf": ("1 0 0 0\n2 1 0 0\n3 1 1 0\n#\n1 2\n2 3\n#\n", read_tgf),
    "a.txt": (
        "joints a 0 0 0\njoints b 1 0 0\nroot a\nhier a b\nskin 0 a 1\n",
        lambda path: (read_rignet(path).skeleton.C,),
    ),
    "a.dmat": ("2 3\n1\n2\n3\n4\n5\n6\n", lambda path: (read_dmat(path),)),
    "a.json": (
        '{"frames": [\n{"bone0": [0, 0, 30]}\n]}\n',
        lambda path: (read_motion_json(path).theta,),
    ),
    "a.bvh": (BVH.format("a", "b"), lambda path: (read_bvh(path).clips[0].B,)),
}
ENCODINGS = ["utf-8-sig", "utf-16", "utf-16-be with a mark", "utf-32"]
LINE_ENDS = ["\n", "\r\n", "\r", "\r\r\n"]


def encoded(text, encoding):
    return codecs.BOM_UTF16_BE + text.encode("utf-16-be") if "mark" in encoding else text.encode(encoding)


@pytest.fixture(params=FILES)
def format_(request, tmp_path):
    """A function that reads the bytes of a file, its text, and what that holds."""
    text, read = FILES[request.param]
    path = tmp_path / request.param

    def read_bytes(data):
        path.unlink(missing_ok=True)
        path.write_bytes(data)
        return read(path)

    return read_bytes, text, read_bytes(text.encode())


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_byte_order_marks(format_, encoding):
    read, text, expected = format_
    assert same(read(encoded(text, encoding)), expected)


@pytest.mark.parametrize("ends", LINE_ENDS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_line_ends(format_, encoding, ends):
    read, text, expected = format_
    assert same(read(text.replace("\n", ends).encode(encoding)), expected)


def test_tabs_and_blank_lines(tmp_path):
    for name in ("a.obj", "a.tgf", "a.txt", "a.bvh"):
        text, read = FILES[name]
        (tmp_path / name).write_text(text)
        expected = read(tmp_path / name)
        (tmp_path / name).write_text("\n" + text.replace(" ", "\t").replace("\n", " \n\n"))
        assert same(read(tmp_path / name), expected)


@pytest.mark.parametrize("data", [codecs.BOM_UTF16_LE + b"\x00\xd8a\x00", codecs.BOM_UTF32_LE + b"\xff\xff\xff\xff"])
def test_marks_of_what_is_no_text(format_, data):
    with pytest.raises(FileFormatError, match=r"the file starts as UTF-(16|32), and is no such text"):
        format_[0](data * 30)


def test_text_that_is_cut_within_a_character(tmp_path):
    (tmp_path / "a.tgf").write_bytes(FILES["a.tgf"][0].encode("utf-16")[:-1])
    assert len(read_tgf(tmp_path / "a.tgf")[0]) == 3


@pytest.mark.parametrize(
    ("names", "encoding", "shown"),
    [
        (("Hüfte", "Rücken"), "latin-1", "Windows-1252"),
        (("épaule_G", "côté"), "cp1252", "Windows-1252"),
        (("Œil–gauche", "née"), "cp1252", "Windows-1252"),
        (("ÄÖÜ", "ß"), "latin-1", "Windows-1252"),
        (("\x81Hüfte", "b"), "latin-1", "Latin-1"),
        (("センター", "左腕"), "cp932", "Shift-JIS"),
        (("ボーン", "頭"), "cp932", "Shift-JIS"),  # whose bytes are those of braces too
        (("右ひじ_01", "左足"), "cp932", "Shift-JIS"),
        (("Hüfte", "腰"), "utf-8", None),
    ],
)
def test_names_of_bones_in_other_encodings(tmp_path, names, encoding, shown):
    (tmp_path / "a.bvh").write_bytes(BVH.format(*names).encode(encoding))
    parts = read_bvh(tmp_path / "a.bvh")
    assert parts.skeleton.names == names
    assert parts.notes == ((f"its text is not UTF-8: it was read as {shown}",) if shown else ())
    rig = "joints {0} 0 0 0\njoints {1} 1 0 0\nroot {0}\nhier {0} {1}\nskin 0 {1} 1\n".format(*names)
    (tmp_path / "a.txt").write_bytes(rig.encode(encoding))
    parts = read_bundle(tmp_path / "a.txt")
    assert parts.skeleton.names == names
    assert parts.notes == ((f"its text is not UTF-8: it was read as {shown}",) if shown else ())


def test_names_of_groups(tmp_path):
    mesh = FILES["a.obj"][0].replace("one", "Ärmel")
    (tmp_path / "a.obj").write_bytes(mesh.encode("cp1252"))
    parts = read_mesh_parts(tmp_path / "a.obj")
    assert list(parts.groups) == ["Ärmel"]
    assert parts.notes == ("its text is not UTF-8: it was read as Windows-1252",)
    (tmp_path / "a.obj").write_bytes(FILES["a.obj"][0].encode() + "# Ärmel\n".encode("cp1252"))
    assert read_mesh_parts(tmp_path / "a.obj").notes == ()
    (tmp_path / "a.stl").write_bytes(f"solid Ärmel\n{FACET}endsolid\n".encode("cp1252"))
    assert list(read_mesh_parts(tmp_path / "a.stl").groups) == ["Ärmel"]


def test_lines_of_both_encodings():
    lines, other = utf8_lines(["ä\n".encode(), "ö\n".encode("latin-1"), b"a\n"])
    assert (b"".join(lines).decode(), other) == ("ä\nö\na\n", "Windows-1252")


def test_errors_name_the_line_whatever_ends_it(tmp_path):
    for ends in LINE_ENDS[:3]:
        (tmp_path / "a.tgf").write_bytes(FILES["a.tgf"][0].replace("2 3", "2 x").replace("\n", ends).encode("utf-16"))
        with pytest.raises(FileFormatError, match=r"a\.tgf:6: a bone needs"):
            read_tgf(tmp_path / "a.tgf")
