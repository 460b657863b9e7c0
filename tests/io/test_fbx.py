import os

import numpy as np
import pytest

from nilbs.geometry.skeleton import Skeleton
from nilbs.io import FileFormatError, fbx
from nilbs.io.fbx import read_fbx
from nilbs.io.gltf_writer import write_gltf
from nilbs.io.parts import Influences, Mesh, Parts


@pytest.fixture
def character(tmp_path):
    path = tmp_path / "a b;$(touch hacked).fbx"  # a name that a shell would run
    path.write_bytes(b"Kaydara FBX Binary  \0\x1a\0")
    return path


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """A program that stands in for Blender: a shell script whose last argument is the file to write."""
    if os.name != "posix":
        pytest.skip("the stand-in is a shell script")

    def install(script):
        program = tmp_path / "blender"
        program.write_text(f'#!/bin/sh\nfor target; do :; done\necho "$@" > "{tmp_path}/arguments"\n{script}\n')
        program.chmod(0o755)
        monkeypatch.setenv("NILBS_BLENDER", str(program))

    return install


def triangle():
    mesh = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 2, 1.0]]), np.array([[0, 1, 2]]))
    skeleton = Skeleton([[0, 0, 0], [0, 2, 0]], [[0, 1]], [-1], ["arm"])
    return Parts(mesh, skeleton, Influences(np.arange(3), np.zeros(3, int), np.ones(3)))


def test_the_copy_is_read(tmp_path, character, blender, monkeypatch):
    write_gltf(tmp_path / "copy.glb", triangle())
    blender(f'cp "{tmp_path}/copy.glb" "$target"')
    monkeypatch.chdir(tmp_path)
    parts = read_fbx(character.name)
    assert parts.skeleton.names == ("arm",)
    assert np.array_equal(parts.mesh.V, triangle().mesh.V)
    assert parts.notes[0] == "read by way of Blender, which writes lengths in metres with y up"
    arguments = (tmp_path / "arguments").read_text()
    assert arguments.startswith("--background --factory-startup --disable-autoexec --python-exit-code 3 --python ")
    assert f" -- {character} " in arguments
    assert not (tmp_path / "hacked").exists()
    assert not os.path.exists(arguments.split()[-1])  # the copy is gone


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("exit 3", "Blender could not convert it, and said: nothing"),
        ("exit 0", "Blender could not convert it, and said: nothing"),
        ("echo one; echo two; exit 1", "and said: two"),
        (
            "echo Traceback; echo 'ValueError: no\033[1m mesh' >&2; echo 'Blender quit'; exit 3",
            "ValueError: no?[1m mesh",
        ),
        ("yes | head -c 1000000; echo; echo Error: last; exit 1", "and said: Error: last"),
        ('echo nonsense > "$target"', "Blender's copy of it as GLB: "),
        ("exec sleep 20", "Blender was stopped: it took more than 0.5 s"),
    ],
)
def test_what_blender_says_is_told(character, blender, monkeypatch, script, message):
    blender(script)
    monkeypatch.setattr(fbx, "_SECONDS", 0.5 if "sleep" in script else 60)
    with pytest.raises(FileFormatError) as caught:
        read_fbx(character)
    assert str(caught.value).startswith(f"{character}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_blender(tmp_path, character, monkeypatch):
    monkeypatch.delenv("NILBS_BLENDER", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileFormatError, match=r"reading FBX needs Blender, .* or convert the file to \.glb"):
        read_fbx(character)
    monkeypatch.setenv("NILBS_BLENDER", str(tmp_path / "nowhere"))
    with pytest.raises(FileFormatError, match=r"nowhere\) cannot be started: No such file"):
        read_fbx(character)


def test_what_is_no_fbx_file_never_reaches_blender(tmp_path, blender):
    blender("exit 0")
    (tmp_path / "a.fbx").write_text("; FBX 7.3.0 project file")
    with pytest.raises(FileFormatError, match=r"a\.fbx: this is no binary FBX file"):
        read_fbx(tmp_path / "a.fbx")
    with pytest.raises(FileNotFoundError):
        read_fbx(tmp_path / "b.fbx")
    assert not (tmp_path / "arguments").exists()
