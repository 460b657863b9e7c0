import itertools
import struct

import numpy as np
import pytest

from nilbs.geometry.facets import is_watertight
from nilbs.io import FileFormatError, read_mesh, write_mesh
from nilbs.io.bundle import Mesh, select_group
from nilbs.io.mesh import read_mesh_parts

TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture
def obj(tmp_path):
    def read(text):
        path = tmp_path / "a.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mesh(path)

    return read


@pytest.fixture
def ply(tmp_path):
    def read(header, rows=b"", form="ascii"):
        path = tmp_path / "a.ply"
        rows = rows.encode() if isinstance(rows, str) else rows
        path.unlink(missing_ok=True)
        path.write_bytes(f"ply\nformat {form} 1.0\n{header}\nend_header\n".encode() + rows)
        return read_mesh(path)

    return read


def v(V):
    return "".join(f"v {x} {y} {z}\n" for x, y, z in V)


VERTEX = "element vertex {}\nproperty float x\nproperty float y\nproperty float z"
FACE = "element face {}\nproperty list uchar int vertex_indices"


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
@pytest.mark.parametrize("kind", ["surface", "flat triangles", "flat edges"])
def test_round_trip_is_exact(tmp_path, rng, suffix, kind):
    d = 3 if kind == "surface" else 2
    V = rng.normal(size=(20, d)) * 10.0 ** rng.integers(-300, 300, size=(20, d))
    E = np.array([rng.choice(20, 2 if kind == "flat edges" else 3, replace=False) for _ in range(9)])
    path = tmp_path / f"a{suffix}"
    write_mesh(path, V, E)
    U, read = read_mesh(path)
    assert np.array_equal(U, V)
    if kind == "flat triangles":  # turned counter-clockwise: the same corners
        assert np.array_equal(np.sort(read), np.sort(E))
    else:
        assert np.array_equal(read, E)


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_flat_triangles_are_turned_counter_clockwise(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_mesh(path, [[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 2, 1], [1, 3, 2], [0, 3, 3], [0, 0, 1]])
    V, T = read_mesh(path)
    a, b = V[T[:, 1]] - V[T[:, 0]], V[T[:, 2]] - V[T[:, 0]]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).tolist() == [1, 1]


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_an_empty_mesh_is_written_but_refused_when_read(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_mesh(path, np.zeros((0, 3)), np.zeros((0, 3), int))
    with pytest.raises(FileFormatError, match=r"no vertex|the file is empty"):
        read_mesh(path)


@pytest.mark.parametrize(("V", "F"), [(np.eye(3), [[0, 1]]), (np.eye(3), [[0, 1, 2, 0]]), (np.eye(3), [[0, 1, 3]])])
def test_write_mesh_checks_its_arguments(tmp_path, V, F):
    with pytest.raises(ValueError, match="F"):
        write_mesh(tmp_path / "a.obj", V, F)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("corner", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/"])
def test_obj_forms_of_a_corner(obj, corner):
    face = "f " + " ".join(corner.format(i) for i in (1, 2, 4)) + "\n"
    V, F = obj(v(TETRAHEDRON) + "vt 0 0\nvn 0 0 1\ng body\nusemtl skin\ns 1\n" + face)
    assert np.array_equal(V, TETRAHEDRON)
    assert F.tolist() == [[0, 1, 3]]


def test_obj_keeps_order_and_number_of_vertices(obj, rng):
    # Textured, with unused vertices and repeated positions: readers that merge or split vertices fail.
    V = np.repeat(rng.normal(size=(4, 3)), 2, axis=0)
    U, F = obj(v(V[:5]) + "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 3/2 5/3\nf 1/3 3/1 5/2\n" + v(V[5:]) + "f 8/1 7/2 1/3\n")
    assert np.array_equal(U, V)
    assert F.tolist() == [[0, 2, 4], [0, 2, 4], [7, 6, 0]]


def test_obj_negative_indices_count_from_where_they_stand(obj):
    V = np.arange(18.0).reshape(6, 3)
    assert obj(v(V[:3]) + "f -3 -2 -1\n" + v(V[3:]) + "f -1 -2 1\n")[1].tolist() == [[0, 1, 2], [5, 4, 0]]


def test_obj_polygons_become_fans(obj):
    V = np.array([[np.cos(a), np.sin(a), 1] for a in np.arange(5)])
    assert obj(v(V) + "f 1 2 3 4 5\nf 2 3 4\n")[1].tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [1, 2, 3]]


def test_obj_line_ends_comments_colours_and_continued_lines(obj):
    text = "# by hand \\\n\nv 0 0 0 # origin\nv 1 0 0 1.0\nv 0 1 \\\n0 0.5 0.5 0.5\nv 0 0 1 1 1 1 1\nf 1 2\\\n 4"
    V, F = obj(text.replace("\n", "\r\n"))
    assert np.array_equal(V, TETRAHEDRON)
    assert F.tolist() == [[0, 1, 3]]


def test_obj_polyline_is_its_edges(obj):
    V, F = obj("v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3\nl 3 1\n")
    assert V.shape == (3, 2)
    assert F.tolist() == [[0, 1], [1, 2], [2, 0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 1\nv 1 0\n", ":2: a vertex needs three coordinates, got 2"),
        ("v 0 0 1\rv 1 0\rv 1 1 0\r", ":2: a vertex needs three coordinates, got 2"),
        ("v 0 0 1\nv 1 x 0\n", ":2: 'x' is not a finite number"),
        ("v 0 0 1\nv 1 1_0 0\n", ":2: '1_0' is not a finite number"),
        ("v 0 0 nan\n", ":1: 'nan' is not a finite number"),
        ("v 0 0 1\n\nv 0 -inf 0\n", ":3: '-inf' is not a finite number"),
        ("v 0 0 1e999\n", ":1: '1e999' is not a finite number"),
        ("v 0 0 1\nv 1 0 0\nf 1 2\n", ": the file holds no face with three different corners"),
        ("v 0 0 1\nf\n", ": the file holds no face with three different corners"),
        ("v 0 0 1\nv 1 0 0\nf 1 2 1 2\n", ": the file holds no face with three different corners"),
        ("v 0 0 1\nv 1 0 0\nf 1 2 3\n", ":3: the face refers to vertex 3 of 2, counted from 1"),
        ("v 0 0 1\nv 1 0 0\nf 1 2 -3\n", ":3: the face refers to vertex 0 of 2, counted from 1"),
        ("v 0 0 1\nv 1 0 0\nf 1 0 2\n", ":3: 0 is not a vertex: vertices count from 1"),
        ("v 0 0 1\nv 1 0 0\nf 1 2 1\nf 1 a/1 2\n", ":4: 'a' is not a whole number"),
        ("v 0 0 1\nf 1 1.5 1\n", ":2: '1.5' is not a whole number"),
        ("v 0 0 1\nf 1 1_0 1\n", ":2: '1_0' is not a whole number"),
        ("v 0 0 1\nf 1 1 9" + "9" * 30, ":2: '9"),
        ("v 0 0 0\nl 1\n", ": the file holds no face"),
        ("v 0 0 0\nl 1 1\n", ": the file holds no face"),
        ("v 0 0 0\nl 1 2\n", ":2: the edge refers to vertex 2"),
        ("v 0 0 1\nf 1 1 \\\n", ": the file ends in the middle of a statement"),
        ("v 0 0 1\n", ": the file holds no face"),
        ("v 0 0 1\nv 1 1 1\nl 1 2\n", ": the file holds no face"),
        ("hello\n", ": the file holds no vertex"),
        ("v 0 0 1\nf 1 1 1\n\0", ":3: binary data where text was expected"),
        ("v 0 0 0\nv 2 0 0\nv 0 1 0\nv 2 3 0\nf 1 2 3\nf 1 2 3 4", ":6: this polygon crosses itself"),
    ],
)
def test_obj_errors_name_file_and_line(obj, text, message):
    with pytest.raises(FileFormatError) as caught:
        obj(text)
    assert f"a.obj{message}" in str(caught.value)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("rows_at_once", [1, 2**16])
def test_ply_forms(ply, form, mixed, rows_at_once, monkeypatch):
    monkeypatch.setattr("nilbs.io.ply._ROWS", rows_at_once)
    # Between are properties and elements that are not read; faces have equal and different lengths.
    header = (
        "comment made by hand\nobj_info none\nelement camera 1\nproperty double fov\n"
        "element vertex 4\nproperty uchar red\nproperty double x\nproperty float y\nproperty short z\n"
        "element face 2\nproperty float quality\nproperty list uchar uint vertex_index\nproperty list char float uv\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nproperty uchar c"
    )
    faces = [(0.5, [0, 1, 3, 2], [1.5]) if mixed else (0.5, [0, 1, 3], [1.5, 2]), (0.25, [3, 2, 1], [3.5, 4])]
    V = [(255, 0.1, 1.5, 7), (0, 3.25, 0, -1), (0, 0.5, 2, 3), (9, 4, 5, 6)]
    if form == "ascii":
        rows = "1\n" + "".join(" ".join(map(str, row)) + "\n" for row in V)
        rows += "".join(f"{q} {len(f)} {' '.join(map(str, f))} {len(u)} {' '.join(map(str, u))}\n" for q, f, u in faces)
        rows = (rows + "0 1 7\n").encode()
    else:
        o = "<" if "little" in form else ">"
        rows = struct.pack(o + "d", 1.0) + b"".join(struct.pack(o + "Bdfh", *row) for row in V)
        for q, f, u in faces:
            rows += struct.pack(f"{o}fB{len(f)}Ib{len(u)}f", q, len(f), *f, len(u), *u)
        rows += struct.pack(o + "iiB", 0, 1, 7)
    U, F = ply(header, rows, form)
    assert U.tolist() == [[0.1, 1.5, 7], [3.25, 0, -1], [0.5, 2, 3], [4, 5, 6]]
    # The quad is concave at its fourth corner, vertex 2.
    assert F.tolist() == ([[1, 3, 2], [1, 2, 0], [3, 2, 1]] if mixed else [[0, 1, 3], [3, 2, 1]])


def test_ply_rows_are_read_in_blocks(ply, monkeypatch):
    monkeypatch.setattr("nilbs.io.ply._ROWS", 2)
    header = VERTEX.format(5) + "\n" + FACE.format(3)
    assert ply(header, "0 0 1\n1 0 0\n2 0 0\n3 0 0\n4 0 0\n3 0 1 2\n3 2 3 4\n4 0 1 2 3\n")[1].shape == (4, 3)
    with pytest.raises(FileFormatError, match=r"a\.ply:13: this row of vertex has 2 words"):
        ply(header, "0 0 1\n1 0 0\n2 0 0\n3 0\n4 0 0\n3 0 1 2\n3 2 3 4\n4 0 1 2 3\n")


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        (VERTEX.format(2), "0 0 1\n", "the file ends after 1 of 2 rows of vertex"),
        (VERTEX.format(10**9), "0 0 1\n", "the file ends after 1 of 1000000000 rows of vertex"),
        (VERTEX.format(1), "0 0 x\n", ":8: this row of vertex holds a word"),
        (VERTEX.format(1), "0 0 1_0\n", ":8: this row of vertex holds a word"),
        (VERTEX.format(1), "0 0 1 2\n", ":8: this row of vertex has 4 words"),
        (VERTEX.format(1), "0 0 nan\n", ":8: vertex 0 is"),
        (VERTEX.format(1), "0 0 1\n", ": the file holds no face"),
        (VERTEX.format(0), "", ": the file holds no vertex"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n3 0 0 1\n", ":11: the face refers to vertex 1 of 1"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n3 0 0 -1\n", ":11: the face refers to vertex -1 of 1"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n2 0 0\n", ": the file holds no face with three"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n-1\n", ":11: this row of face has 1 words"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n9 0 0 0\n", ":11: this row of face has 4 words"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n3 0 0 0.5\n", ":11: this row of face holds a word"),
        (VERTEX.format(1) + "\n" + FACE.format(1), "0 0 1\n3 0 0 " + "9" * 30, "a whole number of element face is too"),
        (VERTEX.format(1) + "\n" + FACE.format(1).replace("int", "float"), "0 0 1\n3 0 0 0\n", "not whole numbers"),
        (VERTEX.format(1).replace("z", "w"), "0 0 1\n", "no vertex element with x, y and z"),
        (VERTEX.format(1).replace("z", "x"), "0 0 1\n", "each of another name"),
        ("element vertex 0", "", "must have properties"),
        (VERTEX.format(1) + "\n" + VERTEX.format(1), "0 0 1\n", "names an element twice"),
        (VERTEX.format(-1), "", ":3: cannot read the header line 'element vertex -1'"),
        (VERTEX.format(1).replace("float", "real"), "", ":4: cannot read the header line 'property real x'"),
        (FACE.format(1).replace("uchar", "float"), "", ":4: the length of a list must be a whole number"),
        ("format ascii 2.0", "", ":3: cannot read"),
    ],
)
def test_ply_errors(ply, header, rows, message):
    with pytest.raises(FileFormatError) as caught:
        ply(header, rows)
    assert message in str(caught.value)


def test_ply_without_format_or_header(tmp_path):
    path = tmp_path / "a.ply"
    for text, message in [
        ("ply\nend_header\n", "names no format"),
        ("ply\nformat ascii 1.0\n", "no PLY file"),
        ("ply\nformat ascii 1.0\nend_header", "no PLY file"),
        ("off\nend_header\n", "no PLY file"),
    ]:
        path.write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_mesh(path)


@pytest.mark.parametrize("mixed", [False, True])
def test_ply_binary_cut_anywhere(ply, mixed):
    header = VERTEX.format(4) + "\n" + FACE.format(2) + "\nelement edge 1\nproperty int vertex1\nproperty int vertex2"
    faces = [[0, 1, 2], [3, 2, 1, 0]] if mixed else [[0, 1, 2], [3, 2, 1]]
    rows = struct.pack("<12f", *range(12)) + b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in faces)
    rows += struct.pack("<2i", 0, 1)
    assert ply(header, rows, "binary_little_endian")[1].shape == (2 + mixed, 3)
    for end in range(len(rows)):
        with pytest.raises(FileFormatError, match="the file ends within"):
            ply(header, rows[:end], "binary_little_endian")


def test_ply_binary_that_claims_too_much(ply):
    for count in (10**9, 10**18 - 1):
        with pytest.raises(FileFormatError, match="the file ends within"):
            ply(VERTEX.format(count), bytes(1000), "binary_little_endian")
    lists = VERTEX.format(1) + "\nelement face 1000000000\nproperty list {} int vertex_indices"
    for kind, size in [("int", struct.pack("<i", -1)), ("uint", struct.pack("<I", 2**32 - 1))]:
        with pytest.raises(FileFormatError, match="row 0 of face has a list of"):
            ply(lists.format(kind), bytes(12) + size + bytes(100), "binary_little_endian")
    with pytest.raises(FileFormatError, match="row 0 of 1000000000"):
        ply(lists.format("uint"), bytes(12) + struct.pack("<I", 100) + bytes(100), "binary_little_endian")


def test_ply_binary_nan_names_the_vertex(ply):
    signalling = struct.pack("<8fI", 0, 0, 1, 1, 1, 1, 1, 1, 0x7F800001)
    with pytest.raises(FileFormatError, match=r"a\.ply: vertex 2 is \[1\.0, 1\.0, nan\]"):
        ply(VERTEX.format(3), signalling, "binary_little_endian")


@pytest.mark.parametrize("name", ["arm/arm.obj", "elephant/elephant.obj", "makehuman/base.obj"])
def test_real_meshes_as_igl_reads_them(data, name):
    import igl

    V, F = read_mesh(data / name)
    V_igl, F_igl = igl.read_triangle_mesh(str(data / name))
    assert np.array_equal(V, V_igl)
    assert np.array_equal(F, F_igl)


def test_obj_reader_against_a_slow_twin(obj, rng):
    # Convex polygons, here of corners on a circle, are fans.
    angle = np.sort(rng.uniform(0, 6, size=40))
    V = np.stack([np.cos(angle), np.sin(angle), 1 + 0 * angle], axis=1)
    polygons = [np.sort(rng.choice(40, size=size, replace=False)) + 1 for size in rng.integers(3, 7, size=30)]
    text = v(V) + "".join(f"f {' '.join(map(str, p))}\n" for p in polygons)
    twin = []
    for p in polygons:
        for i, j in itertools.pairwise(p[1:]):
            twin.append([p[0] - 1, i - 1, j - 1])
    assert obj(text)[1].tolist() == twin


def test_obj_starts_with_a_byte_order_mark(obj):
    V, F = obj(b"\xef\xbb\xbf" + (v(TETRAHEDRON) + "f 1 2 4\n").encode())
    assert np.array_equal(V, TETRAHEDRON)
    assert F.tolist() == [[0, 1, 3]]


def test_faces_that_repeat_corners(mesh_of):
    mesh = mesh_of(v(TETRAHEDRON) + "g a\nf 1 1 2\nf 1 2 2 4 4\ng b\nf 2 3\nf 1 2 1 3\nf 4 3 2\ng c\nf 2 2 2\n")
    assert mesh.E.tolist() == [[0, 1, 3], [3, 2, 1]]
    assert {name: faces.tolist() for name, faces in mesh.groups.items()} == {"a": [0], "b": [1]}
    assert mesh.notes == ("4 of 6 faces have fewer than three different corners and are left out",)


def test_a_polygon_in_space_that_crosses_itself_is_noted(mesh_of):
    mesh = mesh_of("v 0 0 1\nv 2 0 1\nv 0 1 1\nv 2 3 1\nf 1 2 3\nf 1 2 3 4\n")
    assert mesh.E.shape == (3, 3)
    assert mesh.notes == ("1 polygons cross themselves or have too many corners to be cut well, in line 6 first",)


def test_ply_that_crosses_itself_has_no_line(ply, tmp_path):
    faces = struct.pack("<12f", 0, 0, 1, 2, 0, 1, 0, 1, 1, 2, 3, 1) + struct.pack("<B4i", 4, 0, 1, 2, 3)
    ply(VERTEX.format(4) + "\n" + FACE.format(1), faces, "binary_little_endian")
    assert read_mesh_parts(tmp_path / "a.ply").notes[0].endswith("to be cut well")


@pytest.fixture
def mesh_of(tmp_path):
    def read(text):
        path = tmp_path / "a.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mesh_parts(path)

    return read


FACES = "f 1 2 3\nf 1 2 3 4\n"


@pytest.mark.parametrize(
    ("statements", "groups"),
    [
        (FACES, {}),
        ("g a\n" + FACES + "f 2 3 4\n", {"a": [0, 1, 2, 3]}),
        ("g a b\n" + FACES + "g b\nf 2 3 4\n", {"a": [0, 1, 2], "b": [0, 1, 2, 3]}),
        ("g a b\n" + FACES + "g\nf 2 3 4\n", {"a": [0, 1, 2], "b": [0, 1, 2]}),
        ("g a\nf 1 2 3\ng b\nf 1 2 4\ng a\nf 2 3 4\ng never\n", {"a": [0, 2], "b": [1]}),
        (
            "o left arm\nf 1 2 3\ng skin\nf 1 2 4\no right arm\nf 2 3 4\n",
            {"left arm": [0, 1], "skin": [1, 2], "right arm": [2]},
        ),
        ("o a\ng a a\nf 1 2 3\n", {"a": [0]}),
        ("usemtl m\ns 1\ng a # of g b\nf 1 2 3\nusemtl n\nf 1 2 4\n", {"a": [0, 1]}),
        ("g a \\\nb\nf 1 2 3\n", {"a": [0], "b": [0]}),
        ("g a\r\nf 1 2 3\r\n", {"a": [0]}),
        ("g Hüfte Бедро\nf 1 2 3\n", {"Hüfte": [0], "Бедро": [0]}),
        ("g Hüfte\nf 1 2 3\n".encode("latin-1"), {"Hüfte": [0]}),
        ("g a#1\nf 1 2 3\n", {"a#1": [0]}),
    ],
)
def test_obj_groups_and_objects(mesh_of, statements, groups):
    statements = statements if isinstance(statements, bytes) else statements.encode()
    mesh = mesh_of(v(TETRAHEDRON).encode() + statements)
    assert {name: faces.tolist() for name, faces in mesh.groups.items()} == groups


def test_obj_groups_through_blocks_of_lines(mesh_of, monkeypatch):
    monkeypatch.setattr("nilbs.io.bounded._BLOCK", 10)
    mesh = mesh_of(v(TETRAHEDRON) + "g a\nf 1 2 3\nf 1 3 4\ng b\nf -1 -2 -3\n")
    assert mesh.E.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1]]
    assert {name: faces.tolist() for name, faces in mesh.groups.items()} == {"a": [0, 1], "b": [2]}


def test_obj_that_puts_every_face_into_thousands_of_groups(mesh_of):
    names = " ".join(f"g{i}" for i in range(2000))
    with pytest.raises(FileFormatError, match="its faces are in 2000 groups each"):
        mesh_of(v(TETRAHEDRON) + f"g {names}\n" + "f 1 2 3\n" * 2000)


def test_select_group(mesh_of):
    mesh = mesh_of(v(TETRAHEDRON) + "g low\nf 1 2 3\ng high\nf 4 3 2\n")
    V, E, kept = select_group(mesh, "high")
    assert kept.tolist() == [1, 2, 3]
    assert np.array_equal(V, TETRAHEDRON[kept])
    assert np.array_equal(kept[E], [[3, 2, 1]])
    with pytest.raises(ValueError, match="no group 'head'; its groups are: 'low', 'high'"):
        select_group(mesh, "head")


def test_select_group_of_a_mesh_without_groups():
    with pytest.raises(ValueError, match="no group 'body'; its groups are: none"):
        select_group(Mesh(TETRAHEDRON, SIDES), "body")


def test_makehuman_body(data):
    V, E, kept = select_group(read_mesh_parts(data / "makehuman/base.obj"), "body")
    assert (V.shape, E.shape, kept.max()) == ((13380, 3), (26756, 3), 13379)
    assert is_watertight(E)
