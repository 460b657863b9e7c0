"""Habits of files, as commands report them: positions of .bvh, motions of AMASS, handles of .tgf, names of rigs."""

import numpy as np
import pytest

from nilbs.characters.gingerbread import write_gingerbread
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io import read_weights
from nilbs.io.bundle import Clip
from nilbs.io.bvh import read_bvh, write_bvh
from nilbs.io.joints import first_joints
from nilbs.io.rignet import write_rignet
from nilbs.io.smpl import JOINTS

SIX = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
HIPS = f"""HIERARCHY
ROOT world {{ OFFSET 0 0 0 {SIX}
JOINT Hips {{ OFFSET 1 94 -452 {SIX}
JOINT Spine {{ OFFSET 0 16 0 {SIX} }} }} }}
MOTION
Frames: 1
Frame Time: 0.1
0 0 0 0 0 0 -0.5 93.5 -9 0 0 0 0 16 0 0 0 0
"""


@pytest.fixture
def hips(tmp_path):
    path = tmp_path / "hips.bvh"
    path.write_text(HIPS)
    return path


def places(path):
    (clip,) = read_bvh(path, positions="replace").clips
    x = first_joints(clip.skeleton)
    return ((clip.B[0, :, :3, :3] @ x[:, :, None])[..., 0] + clip.B[0, :, :3, 3]).round(6).tolist()


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ((), [[0, 0, 0], [-0.5, 93.5, -9], [-0.5, 109.5, -9]]),
        (("--positions", "auto"), [[0, 0, 0], [-0.5, 93.5, -9], [-0.5, 109.5, -9]]),
        (("--positions", "replace"), [[0, 0, 0], [-0.5, 93.5, -9], [-0.5, 109.5, -9]]),
        (("--positions", "add"), [[0, 0, 0], [0.5, 187.5, -461], [0.5, 219.5, -461]]),
    ],
)
def test_positions(hips, tmp_path, succeeds, how, expected):
    succeeds("convert", hips, *how, "-o", tmp_path / "b.bvh")
    assert places(tmp_path / "b.bvh") == expected
    notes = [note for report in succeeds("info", hips, *how)["files"] for note in report.get("notes", [])]
    assert any("take the place of their OFFSETs (2): 50 % repeat them" in note for note in notes) == (
        how[-1:] in ((), ("auto",))
    )


def test_positions_are_of_a_bvh_file(assets, fails, hips, out):
    model, x = assets / "bar3.nilbs", assets / "x.npy"
    np.save(x, np.zeros((2, 3)))
    none = "--positions is for the positions of a .bvh file, and there is none"
    assert fails("info", assets / "bar.tgf", "--positions", "add") == none
    assert fails("convert", assets / "bar.tgf", "--positions", "add", "-o", out / "a.tgf") == none
    query = ("query", model, x, "--positions", "add", "--frame", 0, "-o", out / "o.npy")
    assert fails(*query) == "--positions is for the motion of a file: give one with --motion"
    (assets / "m.json").write_text('{"frames": [{}]}')
    assert fails(*query, "--motion", assets / "m.json") == none
    assert "no bone of the motion has a name like" in fails(*query, "--motion", hips)


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def test_point_handles_have_weights(assets, tmp_path, succeeds, nilbs):
    rig = tmp_path / "mixed.tgf"
    rig.write_text("1 .25 .5 0\n2 2 .5 0\n3 3.75 .5 0\n4 2 .9 0\n#\n1 2 1 0 0\n2 3 1 0 0\n1 4 0 1 0\n")
    values = succeeds("weights", assets / "bar2.obj", rig, "-o", tmp_path / "w.npz")
    assert (values["bones"], values["point_handles"]) == (2, 1)
    assert values["notes"][:2] == [
        f"{rig}: pseudo-edges are left out: 1, in line 8 first",
        f"{rig}: joints of no bone are point handles, with weights of their own (1): point0 (joint 4)",
    ]
    assert read_weights(tmp_path / "w.npz").shape[1] == 3
    report = succeeds("info", rig)["files"][0]
    assert (report["bones"], report["point_handles"], report["problems"]) == (2, 1, [])
    rig.write_text("1 .5 .5 0\n2 3.5 .5 0\n#\n")
    values = succeeds("weights", assets / "bar2.obj", rig)
    assert (values["bones"], values["point_handles"]) == (0, 2)
    status, _, err = nilbs("train", assets / "bar2.obj", rig, "--steps", 0, "-o", tmp_path / "m.nilbs")
    assert status == 0
    assert "every bone is a root, and random motion turns all bones but these" in err


@pytest.mark.parametrize("prefix", ["Model_", "Model:", "mixamorig", "mixamorig1:", "Armature|Skeleton_"])
def test_all_bones_of_a_rig_with_a_prefix_follow(tmp_path, succeeds, prefix):
    names = ["Hips", "Spine", "Head", "LeftArm", "LeftHand", "Antenna"]
    C = np.array([[0, 1, 0], [0, 1.2, 0], [0, 1.6, 0], [0.2, 1.5, 0], [0.6, 1.5, 0], [0, 1.8, 0]])
    P = np.array([-1, 0, 1, 1, 3, 2])
    write_rignet(tmp_path / "rig.txt", skeleton_of_joints(C, P, [prefix + name for name in names]))
    walk = skeleton_of_joints(C, P, names)
    write_bvh(tmp_path / "walk.bvh", Clip("walk", walk, np.arange(2) / 30, np.tile(np.eye(4), (2, 6, 1, 1))))
    values = succeeds("convert", tmp_path / "rig.txt", tmp_path / "walk.bvh", "-o", tmp_path / "o.glb")
    assert any("6 of 6 bones follow a bone of the motion" in note for note in values["notes"])
    values = succeeds("info", tmp_path / "rig.txt", tmp_path / "walk.bvh")
    assert values["problems"] == []


def test_a_recorded_motion_is_described_and_converted(tmp_path, succeeds, rng):
    path = tmp_path / "walk.npz"
    np.savez(
        path, poses=0.1 * rng.normal(size=(3, 66)), trans=np.zeros((3, 3)), mocap_framerate=30.0, betas=np.ones(16)
    )
    rig, motion = succeeds("info", path)["files"]
    assert (rig["kind"], rig["bones"], rig["names"]) == ("rig", 22, list(JOINTS[22]))
    assert rig["notes"] == ["betas, the shape of the recorded person, are left out"]
    assert (motion["kind"], motion["frames"], motion["problems"]) == ("motion", 3, [])
    succeeds("convert", path, "-o", tmp_path / "walk.bvh")
    assert read_bvh(tmp_path / "walk.bvh").clips[0].B.shape == (3, 22, 4, 4)


def test_a_motion_without_names_in_common_takes_a_map(tmp_path, succeeds):
    _, rig = write_gingerbread(tmp_path, 2)
    (tmp_path / "walk.bvh").write_text(HIPS)
    values = succeeds("info", rig, tmp_path / "walk.bvh")
    assert any("it will take a map" in line for line in values["problems"])
