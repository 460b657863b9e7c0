import numpy as np
import pytest

from nilbs.io import FileFormatError, read_npy, write_npy


@pytest.mark.parametrize("shape", [(5, 3), (5, 2), (4,), (0, 3), (2, 3, 4)])
@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "|i1", "<u4"])
def test_round_trip_is_exact(tmp_path, rng, shape, kind):
    A = (100 * rng.random(shape)).astype(kind)
    path = tmp_path / "a.npy"
    write_npy(path, A)
    assert np.array_equal(read_npy(path), A)
    assert np.load(path).dtype == np.dtype(kind)
    np.save(path, np.asfortranarray(A))
    assert np.array_equal(read_npy(path), A)


def test_a_file_that_claims_too_much(tmp_path):
    path = tmp_path / "a.npy"
    write_npy(path, np.zeros((3, 3)))
    path.write_bytes(path.read_bytes().replace(b"(3, 3), }        ", b"(999999999, 3), }"))
    with pytest.raises(FileFormatError, match=r"a\.npy: the file claims the shape \(999999999, 3\), but holds"):
        read_npy(path)


def test_objects_are_neither_read_nor_written(tmp_path):
    with pytest.raises(ValueError, match="array of numbers, got object"):
        write_npy(tmp_path / "a.npy", [print])
    np.save(tmp_path / "a.npy", np.array([print], dtype=object))
    with pytest.raises(FileFormatError, match="not a plain array of numbers"):
        read_npy(tmp_path / "a.npy")


def test_an_array_of_too_many_dimensions(tmp_path):
    path = tmp_path / "a.npy"
    write_npy(path, np.zeros((1,) * 8))
    assert read_npy(path).shape == (1,) * 8
    write_npy(path, np.zeros((1,) * 9))
    with pytest.raises(FileFormatError, match=r"a\.npy: the file is not a plain array of numbers$"):
        read_npy(path)


def test_small_numbers_that_take_too_much_as_doubles(tmp_path, monkeypatch):
    monkeypatch.setattr("nilbs.io.npy.SIZE_LIMIT", 800)
    path = tmp_path / "a.npy"
    write_npy(path, np.zeros(100, dtype=np.uint8))
    assert len(read_npy(path)) == 100
    write_npy(path, np.zeros(101, dtype=np.uint8))
    with pytest.raises(FileFormatError, match=r"the file holds 101 numbers, more than 100$"):
        read_npy(path)
