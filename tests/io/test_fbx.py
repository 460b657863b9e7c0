import os
import shutil
import subprocess

import numpy as np
import pytest

from nilbs.geometry.skeleton import Skeleton
from nilbs.io import FileFormatError, fbx
from nilbs.io.bundle import Bundle, Influences, Mesh
from nilbs.io.fbx import read_fbx
from nilbs.io.gltf_writer import write_gltf


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
    return Bundle(mesh, skeleton, Influences(np.arange(3), np.zeros(3, int), np.ones(3)))


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
    assert not os.path.exists(arguments.split()[-1])  # the copy is removed


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("exit 3", "Blender could not convert it: nothing"),
        ("exit 0", "Blender could not convert it: nothing"),
        ("echo one; echo two; exit 1", "convert it: two"),
        (
            "echo Traceback; echo 'ValueError: no\033[1m mesh' >&2; echo 'Blender quit'; exit 3",
            "ValueError: no?[1m mesh",
        ),
        ("yes | head -c 1000000; echo; echo Error: last; exit 1", "convert it: Error: last"),
        ('echo nonsense > "$target"', "Blender's copy of it as GLB: "),
        ("exec sleep 20", "Blender was stopped: it took more than 0.5 s"),
    ],
)
def test_the_message_of_blender_is_reported(character, blender, monkeypatch, script, message):
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


def test_blender_reads_fbx_files_only(tmp_path, blender):
    blender("exit 0")
    (tmp_path / "a.fbx").write_text("; FBX 7.3.0 project file")
    with pytest.raises(FileFormatError, match=r"a\.fbx: this is no binary FBX file"):
        read_fbx(tmp_path / "a.fbx")
    with pytest.raises(FileNotFoundError):
        read_fbx(tmp_path / "b.fbx")
    assert not (tmp_path / "arguments").exists()


MAKE = """
import sys
import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
data = bpy.data.armatures.new("rig")
rig = bpy.data.objects.new("rig", data)
bpy.context.collection.objects.link(rig)
bpy.context.view_layer.objects.active = rig
bpy.ops.object.mode_set(mode="EDIT")
lower, upper = data.edit_bones.new("lower"), data.edit_bones.new("upper")
lower.head, lower.tail = (0, 0, 0), (0, 0, 1)
upper.head, upper.tail, upper.parent = (0, 0, 1), (0, 0, 2), lower
bpy.ops.object.mode_set(mode="OBJECT")
mesh = bpy.data.meshes.new("sheet")
mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 0, 2), (0, 3, 2)], [], [(0, 1, 2), (0, 2, 3)])
body = bpy.data.objects.new("sheet", mesh)
bpy.context.collection.objects.link(body)
body.parent = rig
body.modifiers.new("rig", "ARMATURE").object = rig
for name, vertices in (("lower", [0, 1]), ("upper", [2, 3])):
    body.vertex_groups.new(name=name).add(vertices, 1.0, "REPLACE")
bone = rig.pose.bones["upper"]
bone.rotation_mode = "XYZ"
for frame, angle in ((1, 0.0), (11, 1.5707963)):
    bone.rotation_euler = (angle, 0, 0)
    bone.keyframe_insert("rotation_euler", frame=frame)
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 11
bpy.ops.export_scene.fbx(filepath=sys.argv[-1], add_leaf_bones=False, bake_anim_simplify_factor=0.0)
"""


def test_a_file_that_blender_itself_wrote(tmp_path, monkeypatch):
    blender = shutil.which("blender")
    if not blender:
        pytest.skip("there is no program `blender` to read FBX with")
    monkeypatch.delenv("NILBS_BLENDER", raising=False)
    (tmp_path / "make.py").write_text(MAKE)
    made = tmp_path / "made.fbx"
    options = ["--background", "--factory-startup", "--python-exit-code", "3", "--python", str(tmp_path / "make.py")]
    subprocess.run([blender, *options, "--", str(made)], check=True, capture_output=True)
    parts = read_fbx(made)
    assert parts.skeleton.names == ("lower", "upper")
    assert parts.skeleton.P.tolist() == [-1, 0]
    # Blender's z is up; in the copy y is.
    assert np.abs(parts.skeleton.C[parts.skeleton.BE[:, 0]] - [[0, 0, 0], [0, 1, 0]]).max() < 1e-5
    corners = {tuple(x) for x in np.round(parts.mesh.V, 4) + 0.0}
    assert corners == {(0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 2, -3)}
    W = parts.influences.dense(len(parts.mesh.V), 2, made)
    assert np.array_equal(W[:, 1] > 0.5, parts.mesh.V[:, 1] > 1)
    (clip,) = parts.clips
    assert clip.times[0] == 0
    # A quarter turn of the upper bone about its x takes the end of the bone forward.
    tip = np.array([0, 2, 0, 1])
    assert np.abs(clip.B[0, 1] @ tip - tip).max() < 1e-4
    assert np.abs(clip.B[-1, 1] @ tip - [0, 1, 1, 1]).max() < 1e-3
