import numpy as np
import pytest

from nilbs.io import FileFormatError, read_mesh

V = "0 0 1\n1 0 0\n1 1 0\n0 1 0\n"
SQUARE = [[0, 1, 2], [0, 2, 3]]


@pytest.fixture
def off(tmp_path):
    def read(text):
        path = tmp_path / "a.off"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mesh(path)

    return read


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n4 1 0\n" + V + "4 0 1 2 3\n",
        "OFF 4 1 0\n" + V + "4 0 1 2 3\n",
        "OFF4 1 0\n" + V + "4 0 1 2 3\n",
        "OFF\n4 1\n" + V + "4 0 1 2 3",
        "\ufeffOFF\n4 1 0\n" + V + "4 0 1 2 3\n",
        "# made by hand\nOFF # keyword\n\n4 1 99 # counts\n"
        + V.replace("\n", " # v\n\n")
        + "#\n4 0 1 2 3 # f\n# end\n",
        "COFF\n4 1 0\n" + V.replace("\n", " 255 0 0 255\n") + "4 0 1 2 3 1 0 0\n",
        "NOFF\n4 1 0\n" + V.replace("\n", " 0 0 1\n") + "4 0 1 2 3 7\n",
        "STOFF\n4 1 0\n" + V.replace("\n", " 0.5 0.5\n") + "4 0 1 2 3\n",
        "STCNOFF\n4 1 0\n" + V.replace("\n", " 0 0 1 1 1 1 1 0.5 0.5\n") + "4 0 1 2 3\n",
        ("OFF\n4 1 0\n" + V + "4 0 1 2 3\n").replace("\n", "\r\n"),
    ],
)
def test_forms(off, text):
    U, F = off(text)
    assert U.tolist() == [[0, 0, 1], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert F.tolist() == SQUARE


def test_order_and_number_of_vertices_stay(off, rng):
    U = np.repeat(rng.normal(size=(4, 3)), 2, axis=0)
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in U.tolist())
    read, F = off(f"OFF\n8 2 0\n{rows}3 7 0 1\n3 2 2 3\n")
    assert np.array_equal(read, U)
    assert F.tolist() == [[7, 0, 1]]


def test_polygons_that_are_not_convex_are_cut_inside(off):
    rows = "0 0 1\n4 0 1\n4 4 1\n3 1 1\n9 9 1\n"
    U, F = off(f"OFF\n5 3 0\n{rows}3 0 1 4\n4 2 3 0 1\n3 0 1 2\n")
    assert F[[0, 3]].tolist() == [[0, 1, 4], [0, 1, 2]]  # in the file's order
    assert np.linalg.det(np.dstack([U[F[1:3]][..., :2], np.ones((2, 3))])).min() > 0


def test_flat(off):
    U, T = off("OFF\n3 1 0\n0 0 0\n0 1 0\n1 0 0\n3 0 1 2\n")
    assert U.shape == (3, 2)
    assert T.tolist() == [[0, 2, 1]]


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        ("4 1 0\n", "no OFF file"),
        ("\n# only\n", "no OFF file"),
        ("BOFF\n", "no OFF file"),
        ("4OFF\n4 1 0\n", "three dimensions"),
        ("nOFF\n5\n4 1 0\n", "three dimensions"),
        ("OFF BINARY\n\0\0\0\4", "binary"),
        ("OFF BINARY\n4 1 0\n", "binary OFF"),
        ("OFF\n", "numbers of vertices and faces"),
        ("OFF\n4\n", "numbers of vertices and faces"),
        ("OFF\n4 -1 0\n", "numbers of vertices and faces"),
        ("OFF\n4 1.5 0\n", "numbers of vertices and faces"),
        ("OFF\n0 0 0\n", "no vertex"),
        ("OFF\n4 0 0\n" + V, "no face"),
        ("OFF\n5 1 0\n" + V, "5 vertices"),
        (f"OFF\n{10**18 - 1} 1 0\n" + V, "999999999999999999 vertices"),
        ("OFF\n4 2 0\n" + V + "3 0 1 2\n", "2 faces"),
        (f"OFF\n4 {10**9} 0\n" + V + "3 0 1 2\n", "1000000000 faces"),
        ("OFF\n4 1 0\n" + V + "3 0 1 2\n3 0 1 2\n", "1 faces"),
        ("OFF\n3 2 0\n" + V + "3 0 1 2\n", "a face is a number of corners"),
        ("OFF\n4 1 0\n0 0\n0 0 1\n0 1 1\n1 1 1\n3 0 1 2\n", "trimesh cannot read"),
        ("OFF\n4 1 0\n" + V.replace("0 0 1", "0 0 nan") + "3 0 1 2\n", "vertex 0"),
        ("OFF\n4 1 0\n" + V.replace("0 0 1", "0 0 x") + "3 0 1 2\n", "trimesh cannot read"),
        ("OFF\n4 1 0\n" + V.replace("0 0 1", "0 0 1_0") + "3 0 1 2\n", "'_'"),
        ("OFF\n4 1 0\n" + V + "3 0 1\n", "a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "-3 0 1 2\n", "a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "9" * 30 + " 0 1 2\n", "a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "3 0 1 x\n", "cannot read"),
        ("OFF\n4 1 0\n" + V + "3 0 1 " + "9" * 30, "cannot read"),
        ("OFF\n4 1 0\n" + V + "3 0 1 1_0\n", "'_'"),
        ("OFF\n4 1 0\n" + V + "3 0 1 4\n", "range"),
        ("OFF\n4 1 0\n" + V + "3 0 1 -1\n", "range"),
        ("OFF\n4 1 0\n" + V + "2 0 1\n", "no face with three different corners"),
    ],
)
def test_errors(off, text, fact):
    with pytest.raises(FileFormatError) as caught:
        off(text)
    assert "a.off: " in str(caught.value)
    assert fact in str(caught.value)
