import os
import tracemalloc

import pytest

from nilbs.io import FileFormatError, bounded, read_dmat, read_mesh, read_motion_json, read_npy, read_tgf, read_weights
from nilbs.io.errors import check_suffix

READERS = {
    "a.obj": read_mesh,
    "a.ply": read_mesh,
    "a.tgf": read_tgf,
    "a.dmat": read_dmat,
    "a.npz": read_weights,
    "a.npy": read_npy,
    "a.json": lambda path: read_motion_json(path, ["bone0"], 3),
}


@pytest.fixture(params=READERS)
def reader(request, tmp_path):
    return READERS[request.param], tmp_path / request.param


def test_a_missing_file_is_an_os_error_that_names_it(reader):
    read, path = reader
    with pytest.raises(FileNotFoundError, match=path.name):
        read(path)


def test_a_folder_is_an_os_error(reader):
    read, path = reader
    path.mkdir()
    with pytest.raises(IsADirectoryError, match=path.name):
        read(path)


def test_an_empty_file(reader):
    read, path = reader
    path.touch()
    with pytest.raises(FileFormatError, match=f"{path.name}: the file is empty"):
        read(path)


def test_a_pipe_is_refused_without_waiting(reader):
    read, path = reader
    os.mkfifo(path)
    with pytest.raises(FileFormatError, match="not a regular file"):
        read(path)


def test_a_file_over_the_limit_is_refused_before_it_is_read(reader):
    read, path = reader
    with open(path, "wb") as file:
        file.truncate(bounded.SIZE_LIMIT + 1)  # sparse: takes no room on the disk
    with pytest.raises(FileFormatError, match="larger than 2 GiB"):
        read(path)


def test_binary_data(reader, rng):
    read, path = reader
    path.write_bytes(b"\x7fELF\0\0\0" + rng.bytes(5000))
    with pytest.raises(FileFormatError, match=path.name):
        read(path)


@pytest.mark.parametrize("name", ["a.obj", "a.tgf"])
def test_a_line_without_end_is_no_text(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"# fine\n" + b"1 " * bounded.LINE_LIMIT)
    with pytest.raises(FileFormatError, match=f"{name}:2: binary data"):
        READERS[name](path)


def test_lines_are_numbered_across_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(bounded, "_BLOCK", 10)
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 1\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 2 2 2\nv 3 3 3\nv 4 5 9\nf -1 -2 -3\n")
    V, F = read_mesh(path)
    assert F.tolist() == [[0, 1, 2], [5, 4, 3]]
    assert V[5].tolist() == [4, 5, 9]
    path.write_text("v 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    with pytest.raises(FileFormatError, match=r"a\.obj:5: the face refers to vertex 9"):
        read_mesh(path)


def test_the_suffix_is_checked_whatever_its_case(tmp_path):
    assert check_suffix("A.OBJ", ".obj") == ".obj"
    with pytest.raises(FileFormatError, match=r"a\.dae: the file name must end in \.obj or .*, not \.dae"):
        read_mesh(tmp_path / "a.dae")
    with pytest.raises(FileFormatError, match="this one has none"):
        read_mesh(tmp_path / "mesh")


def test_the_error_carries_its_parts():
    error = FileFormatError("a.obj", "wrong", 3)
    assert (error.path, error.message, error.line) == ("a.obj", "wrong", 3)
    assert isinstance(error, ValueError)
    assert str(FileFormatError("a.obj", "wrong")) == "a.obj: wrong"


def test_the_error_stays_on_one_line_whatever_it_quotes():
    assert str(FileFormatError("a.obj", "no joint \x1b[31m\n\ud800", 3)) == "a.obj:3: no joint ?[31m??"


def test_a_small_file_takes_little_memory(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"{}")
    tracemalloc.start()
    bounded.file_bytes(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20
