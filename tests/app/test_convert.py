"""Files go from one format to another by command, sorted by what they hold; nothing is half done."""

import json
import os

import numpy as np
import pytest

from nilbs.app.main import main
from nilbs.characters.bundle import load_bundle
from nilbs.characters.saving import write_bundle
from nilbs.geometry.kinematics import forward_kinematics, smooth_random_rotations
from nilbs.geometry.plane import in_space
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io import read_bundle, read_mesh, read_transforms, read_weights, write_mesh, write_motion_json, write_weights
from nilbs.io.bone_map import write_bone_map
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.registry import READABLE, WRITABLE

CLOSE = 1e-5  # of the size


@pytest.fixture
def body(tmp_path, bar, rng):
    """A folder with a bar as body.obj, body_rig.txt with weights, and wave.bvh, a motion of the same rig."""
    V, E, C, _ = bar(3)
    skeleton = skeleton_of_joints(C[:2], [-1, 0], ["upper", "lower"], ends={1: C[2]})
    W = rng.dirichlet([1, 1], size=len(V))
    theta = smooth_random_rotations(skeleton.P, 3, 6, amplitude=0.5, rng=rng)
    B = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta)
    clip = Clip("wave", skeleton, np.arange(6) / 30, B)
    files = [tmp_path / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    write_bundle(Bundle(Mesh(V, E), skeleton, Influences.of_matrix(W), (clip,)), files)
    return tmp_path


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def posed(folder, *names, B=None):
    """Posed vertices of a character in files, by transforms or by its own first motion."""
    bundle = load_bundle([folder / name for name in names])
    B = bundle.clips[0].B if B is None else B
    V = np.hstack([in_space(bundle.mesh.V), np.ones((len(bundle.mesh.V), 1))])
    return np.einsum("vb,tbij,vj->tvi", weights_of(bundle), B, V)[..., :3]


def weights_of(bundle):
    """The matrix of a bundle's weights."""
    return bundle.influences.dense(*bundle.influences.shape, "a bundle")


def test_a_body_its_rig_and_a_motion_in_one_file_and_back(body, out, succeeds):
    files = [body / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    values = succeeds("convert", *files, "-o", out / "body.glb")
    assert values["inputs"] == {
        str(files[0]): ["mesh"],
        str(files[1]): ["rig", "weights"],
        str(files[2]): ["motion"],
    }
    assert values["outputs"] == {str(out / "body.glb"): ["mesh", "rig", "weights", "motion"]}
    back = [out / name for name in ("x.obj", "x_rig.txt", "x.bvh")]
    succeeds("convert", out / "body.glb", "-o", *back)
    wave = read_bundle(body / "wave.bvh").clips[0]
    U = posed(body, "body.obj", "body_rig.txt", B=wave.B)
    size = np.ptp(U, axis=(0, 1)).max()
    assert np.abs(posed(out, "body.glb") - U).max() <= CLOSE * size
    again = read_bundle(out / "x.bvh").clips[0]
    assert np.abs(posed(out, "x.obj", "x_rig.txt", B=again.B) - U).max() <= CLOSE * size
    assert np.abs(again.times - wave.times).max() <= 1e-6


def test_the_order_of_files_does_not_matter(body, out, succeeds):
    files = [body / name for name in ("wave.bvh", "body_rig.txt", "body.obj")]
    values = succeeds("convert", *files, "-o", out / "body.glb")
    assert list(values["inputs"].values()) == [["motion"], ["rig", "weights"], ["mesh"]]


def test_libigls_formats(body, out, succeeds):
    files = [body / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    names = ("x.ply", "x.tgf", "x-weights.dmat", "x-motion.dmat")
    values = succeeds("convert", *files, "-o", *(out / name for name in names))
    assert any("holds no names" in note for note in values["notes"])
    B = read_transforms(out / "x-motion.dmat")
    U = posed(body, "body.obj", "body_rig.txt", B=read_bundle(body / "wave.bvh").clips[0].B)
    assert np.abs(posed(out, "x.ply", "x.tgf", "x-weights.dmat", B=B) - U).max() <= CLOSE * 4
    values = succeeds("convert", *(out / name for name in names), "-o", out / "x.glb")
    assert list(values["inputs"].values()) == [["mesh"], ["rig"], ["weights"], ["motion"]]
    assert np.abs(posed(out, "x.glb") - U).max() <= CLOSE * 4


def test_a_flat_character(assets, out, succeeds, tmp_path):
    motion = tmp_path / "motion.json"
    write_motion_json(motion, ["bone0", "bone1"], np.linspace(0, 1, 3)[:, None, None] * [[0.2], [1]], np.ones((3, 2)))
    files = (assets / "bar2.obj", assets / "bar.tgf", assets / "bar2-weights.npz", motion)
    succeeds("convert", *files, "-o", out / "x.glb", out / "x-motion.dmat")
    bundle = load_bundle([out / "x.glb"])
    assert bundle.mesh.V.shape == (27, 2)
    assert np.abs(bundle.clips[0].B - read_transforms(out / "x-motion.dmat")).max() <= 1e-6
    assert np.abs(posed(out, "x.glb")[..., 2]).max() <= 1e-9


def test_a_mesh_alone(body, out, succeeds):
    values = succeeds("convert", body / "body.obj", "-o", out / "x.ply", out / "x.glb")
    V, F = read_mesh(body / "body.obj")
    assert np.array_equal(read_mesh(out / "x.ply")[0], V)
    assert np.array_equal(read_mesh(out / "x.ply")[1], F)
    assert values["outputs"][str(out / "x.glb")] == ["mesh"]
    assert values["notes"] == []


@pytest.mark.parametrize("suffix", [".off", ".stl", ".3mf"])
def test_a_mesh_through_trimesh(body, out, succeeds, suffix):
    values = succeeds("convert", body / "body.obj", "-o", out / f"x{suffix}")
    assert bool(values["notes"]) == (suffix == ".stl")
    V, F = read_mesh(body / "body.obj")
    U, G = read_mesh(out / f"x{suffix}")
    assert np.allclose(U[G], V[F], rtol=1e-6, atol=1e-6)
    assert succeeds("info", out / f"x{suffix}")["files"][0]["facets"] == len(F)
    if suffix != ".stl":
        read = load_bundle([out / f"x{suffix}", body / "body_rig.txt"])
        assert np.abs(read.mesh.V - V).max() <= 1e-15


def test_a_group_of_a_mesh(out, succeeds, tmp_path):
    lines = ["v 9 9 9", "v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", "g rest", "f 1 2 3", "g face", "f 3 4 5"]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\n")
    succeeds("convert", tmp_path / "a.obj", "--group", "face", "-o", out / "a.obj")
    assert read_mesh(out / "a.obj")[0].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_weights_alone(assets, out, succeeds):
    succeeds("convert", assets / "bar3-weights.npz", "-o", out / "w.dmat")
    assert (read_weights(out / "w.dmat") == read_weights(assets / "bar3-weights.npz")).all()


def test_a_rig_alone(body, out, succeeds):
    values = succeeds("convert", body / "wave.bvh", "-o", out / "x.tgf")
    assert values["inputs"] == {str(body / "wave.bvh"): ["rig", "motion"]}
    assert "no output holds the motion" in values["notes"]
    assert np.abs(read_bundle(out / "x.tgf").skeleton.C - read_bundle(body / "wave.bvh").skeleton.C).max() <= 1e-9


def test_a_motion_is_mapped_onto_the_rig(body, out, succeeds, tmp_path):
    # The same bones with other names, matched by a map.
    parts = read_bundle(body / "wave.bvh")
    (body / "wave.bvh").write_text((body / "wave.bvh").read_text().replace("upper", "A1").replace("lower", "A2"))
    write_bone_map(tmp_path / "map.json", {"upper": "A1", "lower": "A2"})
    files = [body / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    values = succeeds("convert", *files, "--map", tmp_path / "map.json", "-o", out / "x.glb")
    assert any("2 of 2 bones follow" in note for note in values["notes"])
    U = posed(body, "body.obj", "body_rig.txt", B=parts.clips[0].B)
    assert np.abs(posed(out, "x.glb") - U).max() <= CLOSE * 4


def test_a_bone_map_is_written_to_be_corrected(body, out, succeeds, fails):
    files = [body / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    succeeds("convert", *files, "--write-map", out / "map.json", "-o", out / "x.glb")
    assert json.loads((out / "map.json").read_text()) == {"upper": "upper", "lower": "lower"}
    (body / "wave.bvh").write_text((body / "wave.bvh").read_text().replace("upper", "Q").replace("lower", "Z"))
    line = fails("convert", *files, "--write-map", out / "map.json", "-o", out / "y.glb")
    assert line.startswith(f"{body}/wave.bvh: ")
    assert json.loads((out / "map.json").read_text()) == {"upper": None, "lower": None}
    assert sorted(os.listdir(out)) == ["map.json", "x.glb"]


def test_a_clip_is_chosen_by_name(body, out, succeeds, fails):
    parts = read_bundle(body / "wave.bvh")
    clips = tuple(
        Clip(name, parts.skeleton, parts.clips[0].times[:n], parts.clips[0].B[:n])
        for name, n in (("walk", 2), ("run", 3))
    )
    write_bundle(Bundle(skeleton=parts.skeleton, clips=clips), [body / "two.glb"])
    values = succeeds("convert", body / "two.glb", "-o", out / "x.glb")
    assert values["sizes"]["motion"] == "walk: 2 frames; run: 3 frames"
    # All of a file that moves another rig, too.
    values = succeeds("convert", body / "body.obj", body / "body_rig.txt", body / "two.glb", "-o", out / "y.glb")
    assert values["sizes"]["motion"] == "walk: 2 frames; run: 3 frames"
    assert [clip.name for clip in read_bundle(out / "y.glb").clips] == ["walk", "run"]
    values = succeeds("convert", body / "two.glb", "-o", out / "x.bvh")
    assert "all 2 were written, one after the other (walk, run); --clip chooses one" in " ".join(values["notes"])
    assert len(read_bundle(out / "x.bvh").clips[0].B) == 5
    for name in ("run", "RUN", "ru"):
        succeeds("convert", body / "two.glb", "--clip", name, "-o", out / "x.bvh")
        assert len(read_bundle(out / "x.bvh").clips[0].B) == 3
    assert "there is no motion 'fly', but 'walk', 'run'" in fails(
        "convert", body / "two.glb", "--clip", "fly", "-o", out / "x.bvh"
    )


def test_weights_that_are_missing_are_solved_on_request(assets, out, succeeds, fails):
    files = (assets / "bar3.obj", assets / "bar.tgf")
    line = fails("convert", *files, "-o", out / "x.glb")
    assert line.startswith(f"{out}/x.glb: there are no weights to write")
    assert "--solve" in line
    assert os.listdir(out) == []
    succeeds("convert", *files, "--solve", "-o", out / "x.glb", out / "x.npz")
    W = read_weights(out / "x.npz")
    assert np.abs(W.sum(axis=1) - 1).max() <= 1e-9
    assert np.abs(weights_of(load_bundle([out / "x.glb"])) - W).max() <= 1e-4


def test_as_a_table(body, nilbs, out):
    files = [body / name for name in ("body.obj", "body_rig.txt", "wave.bvh")]
    status, text, err = nilbs("convert", *files, "-o", out / "x.glb")
    assert (status, err) == (0, "")
    lines = text.splitlines()
    assert lines[:3] == [f"{files[0]}: mesh", f"{files[1]}: rig, weights", f"{files[2]}: motion"]
    assert lines[3] == (
        f"-> {out}/x.glb: mesh of 54 vertices, 104 faces; rig of 2 bones; weights of 54 vertices, 2 bones; "
        "motion of wave: 6 frames"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["body.obj", "other.obj", "-o", "out/x.ply"], "body.obj and {}/other.obj both hold a mesh: leave one out"),
        (["body_rig.txt", "other.tgf", "-o", "out/x.tgf"], "body_rig.txt and {}/other.tgf both hold a rig"),
        (["w.npz", "v.npz", "-o", "out/x.npz"], "w.npz and {}/v.npz both hold weights"),
        (["w.npz", "other.tgf", "-o", "out/x.npz"], "w.npz: weights of 3 bones, but the rig has 2"),
        (["w.npz", "body.obj", "other.tgf", "-o", "out/x.npz"], "the weights have 4 rows and 3 columns"),
        (["walk.json", "-o", "out/x.dmat"], "walk.json: a motion goes together with its rig"),
        (["body.obj", "walk.json", "-o", "out/x.glb"], "walk.json: a motion goes together with its rig"),
        (["body.obj", "-o", "out/x.bvh"], "out/x.bvh: there is no rig to write"),
        (["body.obj", "-o", "out/x.ply", "out/x.tgf"], "out/x.tgf: there is no rig to write"),
        (["body.obj", "-o", "out/x.fbx"], "out/x.fbx: the file name must end in .obj or"),
        (["body.obj", "-o", "out/no/x.ply"], "out/no: the folder does not exist"),
        (["body.obj", "--solve", "-o", "out/x.ply"], "body.obj: there is no rig: give its file too"),
        (["body.obj", "--group", "head", "-o", "out/x.ply"], "body.obj: the mesh has no group 'head'"),
        (["body.obj", "-o", "out/x.ply", "body.obj"], "body.obj: this file is read too"),
        (["body.obj", "--write-map", "body.json", "--map", "body.json", "-o", "out/x.ply"], "body.json: this file is"),
        (["body.obj", "--clip", "walk", "-o", "out/x.ply"], "--clip is for a motion, and no file brings one"),
        (["body_rig.txt", "--group", "head", "-o", "out/x.tgf"], "--group is for a mesh, and no file brings one"),
        (["body.obj", "--map", "body.json", "-o", "out/x.ply"], "--map is for a motion for another rig, and no file"),
        (["body.obj", "--write-map", "out/m.json", "-o", "out/x.ply"], "--write-map is for a motion for another rig"),
        (["body.obj", "--write-map", "out/m.txt", "-o", "out/x.ply"], "out/m.txt: the file name must end in .json"),
        (
            ["body.obj", "body_rig.txt", "bow.json", "--write-map", "out/m.json", "-o", "out/x.glb"],
            "--write-map is for a motion for another rig, and no file brings one",
        ),
        (
            ["body.obj", "body_rig.txt", "wave.bvh", "again.bvh", "--write-map", "out/m.json", "-o", "out/x.glb"],
            "--write-map writes the map of one motion, and there are {}/wave.bvh and {}/again.bvh",
        ),
        (["body.obj", "-o", "out/x.ply", "out/x.ply"], "out/x.ply: the same file is named twice"),
        (["names.mhw", "-o", "out/x.npz"], "names.mhw: its weights are of bones by name"),
        (["no.obj", "-o", "out/x.ply"], "no.obj: No such file or directory"),
        (["body.doc", "-o", "out/x.ply"], "body.doc: the file name must end in .obj or"),
        (["body.obj", "body_rig.txt", "walk.json", "-o", "out/x.glb"], "walk.json: frame 0: the rig has no bone 'leg'"),
    ],
)
def test_a_mistake_is_named_and_nothing_written(body, out, fails, words, message):
    write_mesh(body / "other.obj", np.eye(3), [[0, 1, 2]])
    write_bundle(Bundle(skeleton=read_bundle(body / "body_rig.txt").skeleton), [body / "other.tgf"])
    for name in ("w.npz", "v.npz"):
        write_weights(body / name, np.full((4, 3), 1 / 3))
    (body / "walk.json").write_text('{"frames": [{"leg": [0, 0, 1]}]}')
    (body / "bow.json").write_text('{"frames": [{"upper": [0, 0, 1]}]}')
    (body / "body.json").write_text("{}")
    (body / "again.bvh").write_bytes((body / "wave.bvh").read_bytes())
    (body / "names.mhw").write_text(json.dumps({"weights": {}}))
    words = [word if word.startswith("-") or "." not in word else body / word for word in words]
    assert message.replace("{}", str(body)) in fails("convert", *words)
    assert os.listdir(out) == []


def test_help_names_every_suffix(capsys):
    # The texts are written out, because --help imports nothing; the lists they follow are the registry's.
    with pytest.raises(SystemExit):
        main(["convert", "--help"])
    written = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    read = capsys.readouterr().out
    assert [suffix for suffix in WRITABLE if f"{suffix} " not in written and f"{suffix}," not in written] == []
    assert [suffix for suffix in READABLE if suffix not in read] == []


def test_motions_of_another_rest_pose_stand_upright_and_are_shown(nilbs, tmp_path):
    """The file's bones lie along x at rest; its first frame is a T."""
    joints = {"Hips": (0, 1), "Head": (0, 1.7), "LeftArm": (0.2, 1.5), "RightArm": (-0.2, 1.5)}
    joints |= {"LeftUpLeg": (0.1, 0.95), "RightUpLeg": (-0.1, 0.95)}
    (tmp_path / "rig.txt").write_text(
        "".join(f"joints {name} {x} {y} 0\n" for name, (x, y) in joints.items())
        + "root Hips\n"
        + "".join(f"hier Hips {name}\n" for name in joints if name != "Hips")
    )
    channels = "CHANNELS 3 Zrotation Yrotation Xrotation"
    # Each joint's offset is turned to x by a quarter turn about z; frames turn it back.
    lines = ["HIERARCHY", "ROOT Hips", "{", "OFFSET 0 1 0", channels]
    for name, (x, y) in joints.items():
        if name != "Hips":
            lines += [
                f"JOINT {name}",
                "{",
                f"OFFSET {y - 1} {-x} 0",
                channels,
                "End Site",
                "{",
                "OFFSET 1 0 0",
                "}",
                "}",
            ]
    lines += ["}", "MOTION", "Frames: 2", "Frame Time: 0.1", "90 0 0 " + "0 0 0 " * 5, "90 0 0 " + "0 0 0 " * 5]
    (tmp_path / "walk.bvh").write_text("\n".join(lines) + "\n")
    files = [tmp_path / "rig.txt", tmp_path / "walk.bvh"]
    status, output, error = nilbs("convert", *files, "--show", tmp_path / "map.png", "-o", tmp_path / "out.bvh")
    assert status == 0, error
    assert "frame 0" in output
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    clip = read_bundle(tmp_path / "out.bvh").clips[0]
    np.testing.assert_allclose(clip.B[0], np.tile(np.eye(4), (6, 1, 1)), atol=1e-5)
    status, output, _ = nilbs("convert", *files, "--up", "x", "--forward", "-y", "-o", tmp_path / "out.bvh")
    assert status == 0
    assert "its x is y here" in output
    assert "its y is -z here" in output
    status, _, error = nilbs("convert", tmp_path / "rig.txt", "--up", "z", "-o", tmp_path / "out.bvh")
    assert status == 2
    assert "--up" in error
