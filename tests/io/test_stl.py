import struct

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_mesh
from nilbs.io.mesh import read_mesh_parts

SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def text(corners, name="a"):
    facets = ""
    for triangle in np.asarray(corners).tolist():
        rows = "".join(f"      vertex {x} {y} {z}\n" for x, y, z in triangle)
        facets += f"  facet normal 0 0 0\n    outer loop\n{rows}    endloop\n  endfacet\n"
    return f"solid {name}\n{facets}endsolid {name}\n".encode()


def binary(corners, header=b"", count=None):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 7) for triangle in corners)
    return header.ljust(80, b" ") + struct.pack("<I", len(corners) if count is None else count) + rows


@pytest.fixture
def stl(tmp_path):
    def read(content):
        path = tmp_path / "a.stl"
        path.write_bytes(content)
        return read_mesh(path)

    return read


@pytest.mark.parametrize("form", [text, binary, lambda corners: binary(corners, b"solid of some program")])
def test_equal_corners_are_one_vertex_in_order_of_appearance(stl, form, rng):
    V = rng.normal(size=(30, 3)).astype(np.float32).astype(float)
    F = np.array([rng.choice(30, 3, replace=False) for _ in range(40)])
    # A slow twin.
    place, rows = {}, []
    for triangle in V[F].tolist():
        rows.append([place.setdefault(tuple(corner), len(place)) for corner in triangle])
    U, G = stl(form(V[F]))
    assert U.tolist() == [list(corner) for corner in place]
    assert G.tolist() == rows


def test_a_closed_surface_stays_closed(stl):
    from nilbs.geometry.facets import is_watertight

    U, F = stl(binary(TETRAHEDRON[SIDES]))
    assert U.shape == (4, 3)
    assert is_watertight(F)


def test_zeros_of_both_signs_are_one_place(stl):
    corners = [[[0.0, 0, 1], [1, 0, 0], [0, 1, 0]], [[-0.0, 0, 1], [0, 1, 0], [-1, -0.0, 0]]]
    assert stl(binary(corners))[0].shape == (4, 3)


def test_solids_are_groups(tmp_path):
    path = tmp_path / "a.stl"
    corners = TETRAHEDRON[SIDES]
    path.write_bytes(
        text(corners[:1], "left arm")
        + text(corners[1:2], "")
        + text(corners[2:3], "Hüfte")
        + text(corners[3:], "left arm")
    )
    groups = read_mesh_parts(path).groups
    assert {name: faces.tolist() for name, faces in groups.items()} == {"left arm": [0, 3], "Hüfte": [2]}


def test_text_in_capitals_with_line_ends_of_windows(stl):
    assert stl(text(TETRAHEDRON[SIDES]).upper().replace(b"\n", b"\r\n"))[1].shape == (4, 3)


def test_a_solid_may_be_called_vertex_and_need_no_end(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(text(TETRAHEDRON[SIDES], "vertex").replace(b"endsolid vertex", b""))
    mesh = read_mesh_parts(path)
    assert mesh.E.shape == (4, 3)
    assert list(mesh.groups) == ["vertex"]


def test_bytes_after_a_binary_file(stl):
    assert stl(binary(TETRAHEDRON[SIDES]) + b"more")[1].shape == (4, 3)


def test_triangles_without_three_different_corners_are_left_out(stl):
    assert stl(binary(TETRAHEDRON[np.concatenate([SIDES, [[1, 1, 2]]])]))[1].shape == (4, 3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello", "this is no STL file: it neither starts with 'solid'"),
        (b"x" * 100, "this is no STL file: it neither starts with 'solid' nor holds 2021161080 triangles"),
        (binary(TETRAHEDRON[SIDES])[:-1], "this is no STL file: it neither starts with 'solid' nor holds 4 triangles"),
        (binary(TETRAHEDRON[SIDES], count=10**9), "nor holds 1000000000 triangles"),
        (binary([]), "the file holds no vertex"),
        (b"solid a\nendsolid a\n", "the file holds no vertex"),
        (binary([[[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]]), "every number must be finite"),
        (b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n", "three corners"),
        (b"solid a\nfacet\nouter loop\nvertex 0 0 inf\n", "three corners"),
        (b"solid a\n" + b"vertex 0 inf 0\n" * 3 + b"endloop\n", "every number must be finite"),
        (b"solid a\n" + b"vertex 0 1_0 0\n" * 3 + b"endloop\n", "trimesh cannot read"),
        (b"solid a\n" + b"vertex 0 x 0\n" * 3 + b"endloop\n", "trimesh cannot read"),
        (b"solid a\nvertex 0 0\nvertex 1 1 1 1\nvertex 1 1 1\nendloop\n", "three corners"),
        (b"solid a\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\n", "three corners"),
        (b"solid a\nouter loop\n" + b"vertex 0 0 1\n" * 4 + b"endloop\n", "three corners"),
        (b"solid a\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "three corners"),
        (
            b"solid a\n" + b"outer loop vertex 0 0 0\n" * 3 + b"vertex 0 0 1\n" * 3 + b"endloop\n",
            "6 corners in 1 facets",
        ),
        (b"solid a\nouter loop\nvortex 0 0 0\n", "no vertex"),
        (b"solid a\n\0\n", "binary data where text was expected"),
    ],
)
def test_errors(stl, content, message):
    with pytest.raises(FileFormatError) as caught:
        stl(content)
    assert "a.stl: " in str(caught.value)
    assert message in str(caught.value)


def test_a_signalling_nan(stl):
    content = bytearray(binary([[[0, 0, 1], [1, 0, 1], [0, 1, 1]]]))
    content[96:100] = struct.pack("<I", 0x7F800001)
    with pytest.raises(FileFormatError, match="vertex 0"):
        stl(bytes(content))


def test_coordinates_that_differ_by_more_than_a_number_holds(stl):
    corners = [[[1e308, 0, 1e305], [-1e308, 0, 0], [0, 1e308, 0]]]
    assert stl(text(corners))[0].tolist() == corners[0]
