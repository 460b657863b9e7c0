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


def test_rows_are_read_in_blocks(off, monkeypatch):
    monkeypatch.setattr("nilbs.io.off._ROWS", 3)
    assert off("OFF\n4 4 0\n" + V + "3 0 1 2\n" * 4)[1].shape == (4, 3)
    with pytest.raises(FileFormatError, match=r"a\.off:10: '1.5' is not a whole number"):
        off("OFF\n4 4 0\n" + V + "3 0 1 2\n" * 3 + "3 0 1.5 2\n")


def test_flat(off):
    U, T = off("OFF\n3 1 0\n0 0 0\n0 1 0\n1 0 0\n3 0 1 2\n")
    assert U.shape == (3, 2)
    assert T.tolist() == [[0, 2, 1]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("4 1 0\n", ":1: this is no OFF file"),
        ("\n# only\n", ":1: this is no OFF file"),
        ("BOFF\n", ":1: this is no OFF file"),
        ("4OFF\n4 1 0\n", ":1: an OFF file of more than three dimensions"),
        ("nOFF\n5\n4 1 0\n", ":1: an OFF file of more than three dimensions"),
        ("OFF BINARY\n\0\0\0\4", "binary"),
        ("OFF BINARY\n4 1 0\n", ":1: binary OFF is not read: save the mesh as text"),
        ("OFF\n", ":1: the numbers of vertices and faces must follow"),
        ("OFF\n4\n", ":2: the numbers of vertices and faces must follow"),
        ("OFF\n4 -1 0\n", ":2: the numbers of vertices and faces must follow"),
        ("OFF\n4 1.5 0\n", ":2: the numbers of vertices and faces must follow"),
        ("OFF\n0 0 0\n", ": the file holds no vertex"),
        ("OFF\n4 0 0\n" + V, ": the file holds no face"),
        ("OFF\n5 1 0\n" + V, ": the file ends after 4 of 5 vertices"),
        (f"OFF\n{10**18 - 1} 1 0\n" + V, ": the file ends after 4 of 999999999999999999 vertices"),
        ("OFF\n4 2 0\n" + V + "3 0 1 2\n", ": the file ends after 1 of 2 faces"),
        (f"OFF\n4 {10**9} 0\n" + V + "3 0 1 2\n", ": the file ends after 1 of 1000000000 faces"),
        ("OFF\n5 1 0\n" + V + "3 0 1 2\n", ": the file ends after 0 of 1 faces"),
        ("OFF\n3 2 0\n" + V + "3 0 1 2\n", ":6: a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "3 0 1 2\n3 0 1 2\n", ":8: a row after the 4 vertices and 1 faces"),
        ("OFF\n4 1 0\n0 0 1\n0 0\n", ":4: a vertex needs three coordinates, got 2"),
        ("OFF\n4 1 0\n0 0 1\n0 0 nan\n" + V, ":4: 'nan' is not a finite number"),
        ("OFF\n4 1 0\n0 0 1\n0 0 1_0\n" + V, ":4: '1_0' is not a finite number"),
        ("OFF\n4 1 0\n" + V + "3 0 1\n", ":7: a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "-3 0 1 2\n", ":7: a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "9" * 30 + " 0 1 2\n", ":7: a face is a number of corners"),
        ("OFF\n4 1 0\n" + V + "3 0 1 x\n", ":7: 'x' is not a whole number"),
        ("OFF\n4 1 0\n" + V + "3 0 1 " + "9" * 30, ":7: '99999"),
        ("OFF\n4 1 0\n" + V + "3 0 1 1_0\n", ":7: '1_0' is not a whole number"),
        ("OFF\n4 1 0\n" + V + "3 0 1 4\n", ":7: the face refers to vertex 4 of 4, counted from 0"),
        ("OFF\n4 1 0\n" + V + "3 0 1 -1\n", ":7: the face refers to vertex -1 of 4"),
        ("OFF\n4 1 0\n" + V + "2 0 1\n", ": the file holds no face with three different corners"),
    ],
)
def test_errors(off, text, message):
    with pytest.raises(FileFormatError) as caught:
        off(text)
    assert message in str(caught.value)
