import json

import numpy as np
import pytest

from nilbs.io import FileFormatError
from nilbs.io.archive import read_archive, write_archive

KIND = "test file 1"


@pytest.fixture
def path(tmp_path, rng):
    path = tmp_path / "a.bin"
    arrays = {"x": rng.normal(size=(5, 3)), "n": np.arange(4), "on": np.array([True, False]), "none": np.zeros((0, 2))}
    write_archive(path, arrays, {"name": "bär", "steps": [1, 2.5, None]}, kind=KIND)
    return path


def test_round_trip_is_exact(tmp_path, rng):
    arrays = {"a": rng.normal(size=(5, 3)), "b": rng.random((2, 2)).astype(np.float32).T, "c": np.arange(3)}
    write_archive(tmp_path / "a.bin", arrays, {"a": {"b": [1, "x"]}}, kind=KIND)
    read, settings = read_archive(tmp_path / "a.bin", kind=KIND)
    assert read.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype
        assert np.array_equal(read[name], array)
    assert settings == {"a": {"b": [1, "x"]}}


def test_only_known_types_and_finite_settings_are_written(tmp_path):
    with pytest.raises(ValueError, match="x has type complex128"):
        write_archive(tmp_path / "a.bin", {"x": np.zeros(2, complex)}, {}, kind=KIND)
    with pytest.raises(ValueError, match="JSON"):
        write_archive(tmp_path / "a.bin", {}, {"loss": float("nan")}, kind=KIND)
    assert list(tmp_path.iterdir()) == []


def test_another_kind_or_version_is_named(path):
    with pytest.raises(FileFormatError, match=r"a\.bin: is 'test file 1', not 'test file 2'"):
        read_archive(path, kind="test file 2")


def test_every_flipped_byte_is_found(path):
    original = path.read_bytes()
    for at in range(0, len(original), 3):
        damaged = bytearray(original)
        damaged[at] ^= 0x10
        path.unlink()
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError, match=r"a\.bin: is "):
            read_archive(path, kind=KIND)


def test_cut_anywhere(path):
    original = path.read_bytes()
    for end in range(1, len(original), 7):
        path.unlink()
        path.write_bytes(original[:end])
        with pytest.raises(FileFormatError, match=r"a\.bin: is "):
            read_archive(path, kind=KIND)


@pytest.mark.parametrize(
    "header",
    [
        "[]",
        "{}",
        '{"__metadata__": []}',
        '{"__metadata__": {"kind": "test file 1"}}',
        '{"__metadata__": {"kind": "test file 1", "settings": "[", "digest": ""}}',
        '{"x": {"dtype": "F64", "shape": [1000000000, 24], "data_offsets": [0, 8]}}',
        '{"x": {"dtype": "BF16", "shape": [4], "data_offsets": [0, 8]}}',
        "[" * 100_000,
        '{"__metadata__": {"kind": "test file 1"}, "x": ' + "[" * 100_000 + "]" * 100_000 + "}",
    ],
)
def test_any_header(tmp_path, header):
    path = tmp_path / "a.bin"
    data = header.encode() + b" " * (-len(header) % 8)
    path.write_bytes(len(data).to_bytes(8, "little") + data + bytes(8))
    with pytest.raises(FileFormatError, match=r"a\.bin: is "):
        read_archive(path, kind=KIND)


def test_settings_that_are_no_json_are_refused_although_their_digest_is_right(tmp_path):
    from safetensors.numpy import save

    from nilbs.io.archive import _digest

    for text in ("[", "[" * 100_000, json.dumps([["a", 1]]), r'{"\ud800": 1}'):
        metadata = {"kind": KIND, "settings": text, "digest": _digest({}, KIND, text)}
        (tmp_path / "a.bin").write_bytes(save({}, metadata))
        with pytest.raises(FileFormatError, match=r"a\.bin: "):
            read_archive(tmp_path / "a.bin", kind=KIND)
