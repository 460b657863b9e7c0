import errno
import os
import stat

import numpy as np
import pytest

from nilbs.io import (
    check_writable,
    replacing,
    write_dmat,
    write_mesh,
    write_motion_json,
    write_npy,
    write_tgf,
    write_transforms,
    write_weights,
)

C = np.array([[0.0, 0, 0], [1, 0, 0]])
WRITERS = {
    "a.obj": lambda path: write_mesh(path, np.eye(3), [[0, 1, 2]]),
    "a.ply": lambda path: write_mesh(path, np.eye(3), [[0, 1, 2]]),
    "a.tgf": lambda path: write_tgf(path, C, [[0, 1]]),
    "a.dmat": lambda path: write_dmat(path, np.eye(3)),
    "a.npy": lambda path: write_npy(path, np.eye(3)),
    "a.npz": lambda path: write_weights(path, np.eye(3)),
    "b.dmat": lambda path: write_transforms(path, np.eye(4)[None, None]),
    "a.json": lambda path: write_motion_json(path, ["bone0"], np.zeros((1, 1, 3)), np.zeros((1, 3))),
}


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt, SystemExit])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write():
        with replacing(path, "w") as file:
            file.write("new")
            file.flush()
            assert len(os.listdir(tmp_path)) == 2
            raise error

    with pytest.raises(error):
        write()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_the_new_file_appears_only_at_the_end(tmp_path):
    path = tmp_path / "a.bin"
    with replacing(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_permissions_are_those_of_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    with replacing(tmp_path / "a", "w") as file:
        file.write("x")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_a_link_is_followed(tmp_path):
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    with replacing(tmp_path / "link", "w") as file:
        file.write("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_leaves_one_file(tmp_path, name):
    WRITERS[name](tmp_path / name)
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path, name):
    # /dev/full answers every write with "no space left"; a link to it stands for a file on a full disk.
    path = tmp_path / name
    path.symlink_to("/dev/full")
    with pytest.raises(OSError, match=name) as caught:
        WRITERS[name](path)
    assert caught.value.errno == errno.ENOSPC
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


def test_a_device_is_written_to_and_stays_one():
    with replacing(os.devnull, "w") as file:
        file.write("x")
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_a_missing_folder_is_named(tmp_path):
    path = tmp_path / "no" / "a.txt"
    with pytest.raises(FileNotFoundError, match="the folder does not exist") as caught, replacing(path):
        pass
    assert caught.value.filename == str(path.parent)
    with pytest.raises(FileNotFoundError, match="the folder does not exist") as caught:
        check_writable(path)
    assert caught.value.filename == str(path.parent)


def test_a_folder_is_not_a_file_to_write(tmp_path):
    with pytest.raises(IsADirectoryError, match="folder") as caught, replacing(tmp_path, "w") as file:
        file.write("x")
    assert caught.value.filename == str(tmp_path)
    assert os.listdir(tmp_path) == []
    with pytest.raises(IsADirectoryError, match="folder"):
        check_writable(tmp_path)


def test_an_input_file_is_not_replaced(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "b.txt").symlink_to("a.txt")
    check_writable(tmp_path / "c.txt", inputs=[tmp_path / "a.txt", tmp_path / "no.txt", tmp_path / "c.txt"])
    check_writable(os.devnull, inputs=[os.devnull])
    for path, read in (("a.txt", "b.txt"), ("b.txt", "a.txt"), ("a.txt", "a.txt")):
        with pytest.raises(FileExistsError, match=f"this file is read too .*{path}"):
            check_writable(tmp_path / path, inputs=[tmp_path / read])


def test_check_writable_needs_the_permission(tmp_path, monkeypatch):
    check_writable(tmp_path / "a.txt")
    check_writable(os.devnull)
    monkeypatch.setattr(os, "access", lambda place, mode: False)
    with pytest.raises(PermissionError, match="cannot be written"):
        check_writable(tmp_path / "a.txt")
    assert os.listdir(tmp_path) == []


def test_a_long_name_still_fits(tmp_path):
    with replacing(tmp_path / ("x" * 250), "w") as file:
        file.write("x")
    assert len(os.listdir(tmp_path)) == 1
