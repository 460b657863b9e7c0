import io
import zipfile

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_weights, write_weights
from nilbs.io import zipped as module


def npy(header, values=b"", version=b"\1\0"):
    size = len(header).to_bytes(2 if version == b"\1\0" else 4, "little")
    return b"\x93NUMPY" + version + size + header.encode("latin-1") + values


def archive(path, member, name="W.npy"):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(name, member)


PLAIN = "{{'descr': '{}', 'fortran_order': False, 'shape': {}, }}\n"


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_round_trip_is_exact(tmp_path, rng, suffix):
    W = rng.dirichlet(np.ones(5), size=7)
    write_weights(tmp_path / f"a{suffix}", W)
    assert np.array_equal(read_weights(tmp_path / f"a{suffix}"), W)


@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "<f2", "<i4", "|u1"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz_as_numpy_writes_it(tmp_path, rng, kind, order, save):
    W = np.asarray((10 * rng.random((4, 3))).astype(kind), order=order)
    save(tmp_path / "a.npz", W=W, other=np.eye(2))
    assert np.array_equal(read_weights(tmp_path / "a.npz"), W)


def test_npy_version_two(tmp_path):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.eye(2), version=(2, 0))
    archive(tmp_path / "a.npz", buffer.getvalue())
    assert np.array_equal(read_weights(tmp_path / "a.npz"), np.eye(2))


@pytest.mark.parametrize(
    ("member", "message"),
    [
        (npy(PLAIN.format("<f8", "(1000000000, 24)"), bytes(80)), "W claims the shape (1000000000, 24), but holds 80"),
        (npy(PLAIN.format("<f8", "(1, 2)"), np.array([1, np.nan]).tobytes()), "W holds a number that is not finite"),
        (npy(PLAIN.format("<f8", "(2,)"), bytes(16)), "this file holds (2,)"),
        (npy(PLAIN.format("<f8", "(0, 3)")), "this file holds (0, 3)"),
        (npy(PLAIN.format("<f1", "(1, 1)"), bytes(1)), "W is of the unknown type <f1"),
        (npy(PLAIN.format("|O", "(1, 1)"), bytes(8)), "W is not a plain array of numbers"),
        (npy("(" * 9000), "W is not a plain array of numbers"),
        (npy("\x80\xff"), "W is not a plain array of numbers"),
        (b"hello", "W is not a plain array of numbers"),
        (b"", "W.npy is empty"),
    ],
)
def test_npz_that_is_not_a_matrix(tmp_path, member, message):
    archive(tmp_path / "a.npz", member)
    with pytest.raises(FileFormatError) as caught:
        read_weights(tmp_path / "a.npz")
    assert "a.npz: " in str(caught.value)
    assert message in str(caught.value)


def test_a_pickle_is_never_run(tmp_path):
    np.savez(tmp_path / "a.npz", W=np.array([[print]], dtype=object))
    with pytest.raises(FileFormatError, match="not a plain array"):
        read_weights(tmp_path / "a.npz")


def test_npz_without_weights(tmp_path):
    np.savez(tmp_path / "a.npz", V=np.eye(2), F=np.eye(2))
    with pytest.raises(FileFormatError, match="no array W, but 'F', 'V'"):
        read_weights(tmp_path / "a.npz")
    (tmp_path / "a.npz").write_text("hello")
    with pytest.raises(FileFormatError, match=r"a\.npz: damaged \.npz file"):
        read_weights(tmp_path / "a.npz")


def test_an_archive_that_unpacks_to_too_much(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", W=np.zeros((1000, 100)))
    monkeypatch.setattr(module, "SIZE_LIMIT", 2**18)
    with pytest.raises(FileFormatError, match=r"W\.npy is empty, larger than"):
        read_weights(tmp_path / "a.npz")


def test_every_flipped_byte_is_read_as_before_or_refused(tmp_path):
    # A zip file checks the sum of its members; what it leaves unchecked does not change the array.
    path = tmp_path / "a.npz"
    W = np.arange(6.0).reshape(3, 2)
    write_weights(path, W)
    original = path.read_bytes()
    refused = 0
    for i in range(len(original)):
        damaged = bytearray(original)
        damaged[i] ^= 0xFF
        path.unlink()
        path.write_bytes(damaged)
        try:
            assert np.array_equal(read_weights(path), W)
        except FileFormatError:
            refused += 1
    assert refused > len(original) / 3


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_write_weights_checks_its_arguments(tmp_path, suffix):
    with pytest.raises(ValueError, match="must be"):
        write_weights(tmp_path / f"a{suffix}", np.ones(3))
    with pytest.raises(FileFormatError, match=r"must end in \.dmat or \.npz"):
        write_weights(tmp_path / "a.csv", np.ones((1, 1)))
