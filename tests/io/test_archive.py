import io
import json
import tracemalloc
import zipfile

import numpy as np
import pytest
from safetensors.numpy import save

from nilbs.io import FileFormatError
from nilbs.io.archive import HEADER, KINDS, _digest, read_archive, safetensors_digest, write_archive

KIND = "test file 1"
COMPRESS = pytest.mark.parametrize("compress", [False, True])


def content(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Arrays of all kinds, in every form that they are stored in."""
    smooth = np.cumsum(rng.integers(-3, 4, 3000))
    arrays = {kind.name: smooth.astype(kind) for kind in KINDS}
    limits = np.array([2**31 - 1, -(2**31), 0] * 500, dtype=np.int32)
    table = np.add.outer(np.arange(40) ** 3, 1000 * np.arange(50)).astype(np.int64)
    floats = rng.normal(size=(5, 3))
    floats[0] = np.nan, np.inf, -np.inf
    return arrays | {"limits": limits, "table": table, "turned": table.T, "floats": floats, "none": np.zeros((0, 2))}


@pytest.fixture(params=[False, True], ids=["stored", "compressed"])
def path(request, tmp_path, rng):
    path = tmp_path / "a.bin"
    arrays = {"x": rng.normal(size=(5, 3)), "n": np.arange(400), "on": np.array([True]), "none": np.zeros((0, 2))}
    write_archive(path, arrays, {"name": "bär", "steps": [1, 2.5, None]}, kind=KIND, compress=request.param)
    return path


@COMPRESS
def test_round_trip_is_exact(tmp_path, rng, *, compress):
    arrays = content(rng)
    write_archive(tmp_path / "a.bin", arrays, {"a": {"b": [1, "x"]}}, kind=KIND, compress=compress)
    read, settings = read_archive(tmp_path / "a.bin", kind=KIND)
    assert read.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype
        assert np.array_equal(read[name], array, equal_nan=array.dtype.kind == "f")
        assert read[name].flags.writeable
        assert read[name].flags.c_contiguous
    assert settings == {"a": {"b": [1, "x"]}}


def test_the_form_that_compresses_best_is_named(tmp_path, rng):
    arrays = {
        "slope": np.arange(0, 100_000, 7, dtype=np.int32),
        "noise": rng.integers(0, 200, 20_000).astype(np.int64) * 2**40 + rng.integers(0, 2, 20_000),
        "zero": np.zeros(20_000),
        "few": np.arange(5),
    }
    write_archive(tmp_path / "a.bin", arrays, {}, kind=KIND, compress=True)
    with zipfile.ZipFile(tmp_path / "a.bin") as archive:
        forms = json.loads(archive.read(HEADER))["forms"]
    assert {name: how["form"] for name, how in forms.items()} == {"slope": "differences", "noise": "bytes"}
    write_archive(tmp_path / "b.bin", arrays, {}, kind=KIND)
    sizes = [(tmp_path / name).stat().st_size for name in ("a.bin", "b.bin")]
    assert sizes[0] < 0.2 * sizes[1]


def test_the_same_content_makes_the_same_file(tmp_path, rng):
    arrays = content(rng)
    for name in ("a.bin", "b.bin"):
        write_archive(tmp_path / name, arrays, {"x": 1}, kind=KIND, compress=True)
    assert (tmp_path / "a.bin").read_bytes() == (tmp_path / "b.bin").read_bytes()


def test_numpy_reads_what_is_stored_plain(tmp_path, rng):
    arrays = content(rng)
    write_archive(tmp_path / "a.npz", arrays, {}, kind=KIND)
    with np.load(tmp_path / "a.npz") as found:
        np.testing.assert_array_equal(found["table"], arrays["table"])


def test_only_known_types_and_finite_settings_are_written(tmp_path):
    with pytest.raises(ValueError, match="x has type complex128"):
        write_archive(tmp_path / "a.bin", {"x": np.zeros(2, complex)}, {}, kind=KIND)
    with pytest.raises(ValueError, match="JSON"):
        write_archive(tmp_path / "a.bin", {}, {"loss": float("nan")}, kind=KIND)
    assert list(tmp_path.iterdir()) == []


def test_another_kind_or_version_is_named(path):
    with pytest.raises(FileFormatError, match=r"a\.bin: is 'test file 1', not 'test file 2'"):
        read_archive(path, kind="test file 2")
    assert read_archive(path, kind="test file 2", older=[KIND])[1]["name"] == "bär"


def test_every_flipped_byte_is_found(path):
    original = path.read_bytes()
    for at in range(0, len(original), 3):
        damaged = bytearray(original)
        damaged[at] ^= 0x10
        path.unlink()
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError, match=r"a\.bin: is "):
            read_archive(path, kind=KIND)


def test_cut_anywhere_or_longer(path):
    original = path.read_bytes()
    for end in range(1, len(original), 7):
        path.unlink()
        path.write_bytes(original[:end])
        with pytest.raises(FileFormatError, match=r"a\.bin: is "):
            read_archive(path, kind=KIND)
    path.write_bytes(original + b"\0")
    with pytest.raises(FileFormatError, match=r"a\.bin: is "):
        read_archive(path, kind=KIND)


def zipped(path, members: dict[str, bytes], **header) -> None:
    """An archive with a digest that is right."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.comment = bytes(64)
        if header:
            archive.writestr(HEADER, json.dumps({"kind": KIND, "settings": {}, "forms": {}} | header))
        for name, data in members.items():
            archive.writestr(name, data)
    data = file.getvalue()[:-64]
    path.write_bytes(data + _digest(data))


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def planes(**how) -> dict:
    return {"forms": {"x": {"form": "bytes", "type": "int16", "shape": [3]} | how}}


@pytest.mark.parametrize(
    ("members", "header", "message"),
    [
        ({}, {}, "it has no archive.json"),
        ({HEADER: b"["}, {}, "archive.json is no JSON object"),
        ({HEADER: b"[" * 100_000}, {}, "archive.json is no JSON object"),
        ({HEADER: b"\xff"}, {}, "archive.json is no JSON object"),
        ({}, {"kind": 7}, "is 7, not 'test file 1'"),
        ({}, {"kind": None}, "is 'something else'"),
        ({}, {"settings": []}, "its settings are no JSON object"),
        ({}, {"forms": 3}, "its settings are no JSON object"),
        ({"x.npy": b"x"}, {"forms": {}}, "x is not a plain array of numbers"),
        ({"x.npy": npy(np.array(["a"]))}, {"forms": {}}, "x is not a plain array of numbers"),
        ({"x.npy": npy(np.zeros(3))[:-1]}, {"forms": {}}, "x claims the shape"),
        ({"x.npy": npy(np.zeros(3, dtype=np.float16))}, {"forms": {}}, "x is of the type float16"),
        ({"x.npy": npy(np.zeros((2, 3)))}, planes(), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 4), dtype=np.uint8))}, planes(), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((4, 3), dtype=np.uint8))}, planes(), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, planes(form="plain"), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, planes(type="O"), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, planes(shape=[-3]), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, planes(shape=[10**30]), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, planes(shape=None), "x is not stored in the form that"),
        ({"x.npy": npy(np.zeros((2, 3), dtype=np.uint8))}, {"forms": {"x": 1}}, "x is not stored in the form that"),
        (
            {"x.npy": npy(np.zeros((8, 3), dtype=np.uint8))},
            planes(form="differences", type="float64"),
            "x is not stored in the form that",
        ),
    ],
)
def test_any_content_is_refused_although_its_digest_is_right(tmp_path, members, header, message):
    zipped(tmp_path / "a.bin", members, **header)
    with pytest.raises(FileFormatError, match=rf"a\.bin: .*{message}") as caught:
        read_archive(tmp_path / "a.bin", kind=KIND)
    assert str(caught.value).isprintable()


def test_a_member_may_not_be_there_twice(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate name"):
        zipped(tmp_path / "a.bin", {HEADER: b"{}"}, forms={})
    with pytest.raises(FileFormatError, match="or a member twice"):
        read_archive(tmp_path / "a.bin", kind=KIND)


def test_a_file_that_unpacks_to_too_much_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("nilbs.io.archive.SIZE_LIMIT", 10**7)
    zipped(tmp_path / "a.bin", {f"{k}.npy": npy(np.zeros(10**6)) for k in range(4)}, forms={})
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match="it holds more than 9 MiB"):
            read_archive(tmp_path / "a.bin", kind=KIND)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()


def safetensors(path, arrays: dict[str, np.ndarray], text: str, kind: str = KIND) -> None:
    path.write_bytes(save(arrays, {"kind": kind, "settings": text, "digest": safetensors_digest(arrays, kind, text)}))


def test_files_of_earlier_versions_are_read(tmp_path, rng):
    arrays = {"x": rng.normal(size=(5, 3)), "n": np.arange(4, dtype=np.int32)}
    safetensors(tmp_path / "a.bin", arrays, '{"name": "bär"}')
    read, settings = read_archive(tmp_path / "a.bin", kind="test file 2", older=[KIND])
    assert settings == {"name": "bär"}
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)
    data = bytearray((tmp_path / "a.bin").read_bytes())
    data[-1] ^= 1
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(FileFormatError, match="its digest does not match"):
        read_archive(tmp_path / "a.bin", kind=KIND)


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
    for text in ("[", "[" * 100_000, json.dumps([["a", 1]]), r'{"\ud800": 1}'):
        safetensors(tmp_path / "a.bin", {}, text)
        with pytest.raises(FileFormatError, match=r"a\.bin: "):
            read_archive(tmp_path / "a.bin", kind=KIND)
