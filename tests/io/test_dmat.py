import struct

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_dmat, write_dmat


@pytest.fixture
def dmat(tmp_path):
    def read(data):
        path = tmp_path / "a.dmat"
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return read_dmat(path)

    return read


@pytest.mark.parametrize("shape", [(1, 1), (5, 3), (3, 0), (0, 3), (0, 0)])
def test_round_trip_is_exact(tmp_path, rng, shape):
    A = rng.normal(size=shape) * 10.0 ** rng.integers(-300, 300, size=shape)
    write_dmat(tmp_path / "a.dmat", A)
    assert np.array_equal(read_dmat(tmp_path / "a.dmat"), A)


@pytest.mark.parametrize("shape", [(5, 3), (4, 0)])
def test_binary_form(dmat, rng, shape):
    A = rng.normal(size=shape)
    header = f"0 0\n{shape[1]} {shape[0]}\n".encode()
    assert np.array_equal(dmat(header + A.T.astype("<f8").tobytes()), A)


def test_text_may_be_laid_out_in_any_way(dmat):
    assert dmat(" 2 3 \r\n1\t2 3\r\n\r\n4 .5 -6.e1").tolist() == [[1, 4], [2, 0.5], [3, -60]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", ":1: a .dmat file starts with"),
        ("2\n3\n", ":1: a .dmat file starts with"),
        ("-2 3\n", ":1: a .dmat file starts with"),
        ("2 3 4\n", ":1: a .dmat file starts with"),
        ("1000000000 24\n1 2 3\n", ":1: 24 rows of 1000000000 columns do not fit in"),
        (b"0 0\n24 1000000000\n" + bytes(80), ":2: 1000000000 rows of 24 columns do not fit in"),
        (b"0 0\nhello", ":2: a .dmat file starts with"),
        (b"0 0\n2 2\n" + bytes(31), ": 4 binary values take 32 bytes, the file holds 31"),
        (b"0 0\n2 2\n" + bytes(33), ": 4 binary values take 32 bytes, the file holds 33"),
        (b"0 0\n1 2\n" + struct.pack("<2d", 0, np.inf), ": value 1 is inf"),
        ("1 3\n1\n2\n", ": the header promises 3 values, the file holds 2"),
        ("1 3\n1\n2\n3\n4", ": the file goes on after the 3 values"),
        ("1 3\n1\nx\n3\n", ":3: 'x' is not a finite number"),
        ("1 3\n1\n2\nnan\n", ":4: 'nan' is not a finite number"),
        ("1 3\n1\n2 -Infinity\n", ":3: '-Infinity' is not a finite number"),
        ("1 3\n1e999\n2\n3", ":2: '1e999' is not a finite number"),
        ("1 3\n1\n2\n1_0\n", ":4: '1_0' is not a finite number"),
    ],
)
def test_errors_name_the_place(dmat, text, message):
    with pytest.raises(FileFormatError) as caught:
        dmat(text)
    assert f"a.dmat{message}" in str(caught.value)


@pytest.mark.parametrize("A", [[1.0, 2.0], [[np.nan]], [["x"]]])
def test_write_dmat_checks_its_argument(tmp_path, A):
    with pytest.raises(ValueError, match="A"):
        write_dmat(tmp_path / "a.dmat", A)


@pytest.mark.parametrize("name", ["arm/arm-weights", "elephant/elephant-weights", "elephant/elephant-anim"])
def test_real_files_as_igl_reads_them(data, name):
    import igl

    path = data / f"{name}.dmat"
    assert np.array_equal(read_dmat(path), igl.readDMAT(str(path)))
