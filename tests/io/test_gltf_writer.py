"""Writing glTF: files are read back and follow the specification."""

import base64
import json
import struct

import numpy as np
import pytest

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rotation_matrices
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.gltf import read_gltf
from nilbs.io.gltf_pose import track
from nilbs.io.gltf_writer import write_gltf

CODES = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}


def posed(parts, clip, frame):
    """The vertices of a clip's frame."""
    V = parts.mesh.V
    W = parts.influences.dense(len(V), len(parts.skeleton.names), "test")
    # The file's weights have single precision; far from the origin their sum must be one to the last digit.
    W /= W.sum(axis=1, keepdims=True)
    return linear_blend_skinning(V, W, parts.clips[clip].B[frame])


def chain(b, rng, *, roots=1, d=3):
    """A skeleton of b bones in a random forest."""
    P = np.array([-1 if j < roots else int(rng.integers(0, j)) for j in range(b)])
    positions = np.zeros((b, d))
    for j in range(b):
        positions[j] = rng.normal(size=d) + (positions[P[j]] if P[j] >= 0 else 0)
    ends = {j: positions[j] + rng.normal(size=d) for j in range(b) if rng.random() < 0.7}
    return skeleton_of_joints(positions, P, [f"b{j}" for j in range(b)], ends=ends)


def whole(skeleton, rng, *, n=40, most=11):
    """A mesh around a skeleton, with weights of up to so many bones."""
    b, d = skeleton.BE.shape[0], skeleton.d
    V = skeleton.C[rng.integers(0, len(skeleton.C), n)] + rng.normal(size=(n, d))
    E = np.array([rng.choice(n, 3, replace=False) for _ in range(2 * n + 1)])
    W = np.zeros((n, b))
    for i in range(n):
        bones = rng.choice(b, min(b, int(rng.integers(1, most + 1))), replace=False)
        W[i, bones] = rng.random(len(bones))
    W /= W.sum(axis=1, keepdims=True)
    vertex, bone = np.nonzero(W)
    return Mesh(V, E), Influences(vertex, bone, W[vertex, bone])


def written(folder, parts, name="made.glb"):
    notes = write_gltf(folder / name, parts)
    return read_gltf(folder / name), notes


def assert_same(parts, back, size):
    """Skeleton, weights and posed vertices agree."""
    s, r = parts.skeleton, back.skeleton
    assert r.names == s.names
    assert r.P.tolist() == s.P.tolist()
    for end in (0, 1):
        np.testing.assert_allclose(r.C[r.BE[:, end]], s.C[s.BE[:, end]], rtol=0, atol=1e-5 * size)
    n, b = len(parts.mesh.V), len(s.names)
    np.testing.assert_allclose(back.mesh.V, parts.mesh.V, rtol=0, atol=1e-5 * size)
    assert back.mesh.E.tolist() == parts.mesh.E.tolist()
    np.testing.assert_allclose(back.influences.dense(n, b, ""), parts.influences.dense(n, b, ""), rtol=0, atol=1e-6)
    assert [c.name for c in back.clips] == [c.name for c in parts.clips]
    for k, clip in enumerate(parts.clips):
        np.testing.assert_allclose(back.clips[k].times, clip.times, rtol=1e-6)
        for frame in range(len(clip.times)):
            np.testing.assert_allclose(posed(back, k, frame), posed(parts, k, frame), rtol=0, atol=1e-5 * size)


def rigid(skeleton, rng, frames=5):
    C = skeleton.C[skeleton.BE[:, 0]]
    BE = np.stack([np.arange(len(C))] * 2, axis=1)
    theta = rng.normal(size=(frames, len(C), 3))
    return forward_kinematics(C, BE, skeleton.P, theta, root_translation=rng.normal(size=(frames, 3)))


@pytest.mark.parametrize(("b", "roots"), [(1, 1), (3, 1), (30, 1), (30, 4), (300, 1)])
@pytest.mark.parametrize("offset", [0.0, 1e5, 1e8])
def test_what_was_written_reads_back(tmp_path, rng, b, roots, offset):
    skeleton = chain(b, rng, roots=roots)
    B = rigid(skeleton, rng)
    mesh, influences = whole(skeleton, rng)
    move = np.array([1.0, -2, 0.5]) * offset
    shift = np.eye(4)
    shift[:3, 3] = move
    moved = Skeleton(skeleton.C + move, skeleton.BE, skeleton.P, skeleton.names, skeleton.forks)
    clips = tuple(Clip(f"clip{k}", moved, np.linspace(0, 2, 5), shift @ B @ np.linalg.inv(shift)) for k in (0, 1))
    parts = Bundle(Mesh(mesh.V + move, mesh.E), moved, influences, clips)
    back, notes = written(tmp_path, parts)
    assert notes == ()
    assert back.notes == ()
    assert_same(parts, back, np.ptp(mesh.V, axis=0).max())


def test_every_digit_of_ends_and_forks(tmp_path):
    joints = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    names = ["root", "a", "b", "c"]
    P = [-1, 0, 0, 1]
    for ends in ({}, {3: np.array([0, 0.1, 7])}, {0: np.array([0, 0, 0.3]), 2: np.array([0, 0, 0])}):
        skeleton = skeleton_of_joints(joints, P, names, ends=ends)
        back, _ = written(tmp_path, Bundle(skeleton=skeleton))
        assert back.skeleton.C.tolist() == skeleton.C.tolist()
        assert back.skeleton.BE.tolist() == skeleton.BE.tolist()
        assert back.skeleton.forks.tolist() == skeleton.forks.tolist()


def test_bones_that_stretch_along_their_own_axes(tmp_path, rng):
    skeleton = chain(12, rng)
    mesh, influences = whole(skeleton, rng)
    axes = rotation_matrices(rng.normal(size=(12, 3)))
    C, t = skeleton.C[skeleton.BE[:, 0]], 6
    B = np.zeros((t, 12, 4, 4))
    for frame in range(t):
        for bone, parent in enumerate(skeleton.P):
            scale = np.diag(0.5 + rng.random(3)) * (1 if bone % 5 else -1)
            local = np.eye(4)
            local[:3, :3] = rotation_matrices(rng.normal(size=3)) @ axes[bone] @ scale @ axes[bone].T
            local[:3, 3] = C[bone] - local[:3, :3] @ C[bone] + 0.1 * rng.normal(size=3)
            B[frame, bone] = local if parent < 0 else B[frame, parent] @ local
    parts = Bundle(mesh, skeleton, influences, (Clip("stretch", skeleton, np.arange(6.0), B),))
    back, notes = written(tmp_path, parts)
    assert notes == ()
    size = max(np.ptp(posed(parts, 0, frame), axis=0).max() for frame in range(t))
    assert_same(parts, back, size)


def test_quaternions_do_not_jump():
    angle = np.linspace(0, 4 * np.pi, 50)
    B = np.tile(np.eye(4), (50, 1, 1, 1))
    B[:, 0, :3, :3] = rotation_matrices(angle[:, None] * [0, 0, 1])
    q = track(np.zeros((1, 3)), np.array([-1]), np.eye(3)[None], B, size=1.0).parts["rotation"][:, 0]
    np.testing.assert_allclose(q[:, [2, 3]], np.stack([np.sin(angle / 2), np.cos(angle / 2)], axis=1), atol=1e-12)


def test_shear_is_written_as_close_as_it_goes_and_noted(tmp_path):
    skeleton = Skeleton([[0, 0, 0], [1, 0, 0]], [[0, 1]], [-1], ("a",))
    B = np.tile(np.eye(4), (2, 1, 1, 1))
    B[1, 0, :3, :3] = [[1, 0.5, 0], [0, 1, 0], [0, 0, 2]]
    B[0, 0, :3, :3] = [[1, 0, 0], [0.4, 1, 0], [0, 0, 2]]
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    ones = Influences(np.arange(3), np.zeros(3, int), np.ones(3))
    back, notes = written(tmp_path, Bundle(mesh, skeleton, ones, (Clip("bend", skeleton, np.arange(2.0), B),)))
    (note,) = notes
    assert note.startswith("clip 'bend' shears bones, which glTF cannot hold: 'a' is off by up to ")
    off = np.abs(back.clips[0].B[:, 0, :3, :3] - B[:, 0, :3, :3]).max()
    assert float(note.split()[-5]) / 100 == pytest.approx(off, rel=0.05)
    assert 0.01 < off < 0.5


def test_a_bone_that_shrinks_to_nothing(tmp_path):
    skeleton = skeleton_of_joints([[0, 0, 0], [1, 0, 0]], [-1, 0], ["a", "b"])
    B = np.zeros((2, 2, 4, 4))
    B[:, :, 3, 3] = 1
    B[0] = np.eye(4)
    B[1, :, :3, 3] = [3, 1, 2]
    back, notes = written(tmp_path, Bundle(skeleton=skeleton, clips=(Clip("gone", skeleton, np.arange(2.0), B),)))
    assert notes == ()
    np.testing.assert_allclose(back.clips[0].B, B, atol=1e-6)


def test_a_flat_character(tmp_path, rng):
    skeleton = chain(4, rng, d=2)
    mesh, influences = whole(skeleton, rng)
    a, b = (mesh.V[mesh.E[:, k]] - mesh.V[mesh.E[:, 0]] for k in (1, 2))
    E = np.where((a[:, :1] * b[:, 1:] < a[:, 1:] * b[:, :1]), mesh.E[:, ::-1], mesh.E)
    back, _ = written(tmp_path, Bundle(Mesh(mesh.V, E), skeleton, influences), "made.gltf")
    assert back.mesh.V.shape == mesh.V.shape
    np.testing.assert_allclose(back.mesh.V, mesh.V, atol=1e-6)
    assert back.mesh.E.tolist() == E.tolist()
    np.testing.assert_allclose(back.skeleton.C[:, :2], skeleton.C, atol=1e-6)
    assert not back.skeleton.C[:, 2].any()


def test_a_mesh_alone_far_from_the_origin(tmp_path, rng):
    V = rng.normal(size=(30, 3)) * 1e-3 + [1e6, 0, -1e6]
    back, notes = written(tmp_path, Bundle(Mesh(V, np.arange(30).reshape(-1, 3))))
    assert notes == ()
    assert np.abs(back.mesh.V - V).max() < 1e-5 * np.ptp(V, axis=0).max()


def test_weights_are_made_whole(tmp_path):
    skeleton = skeleton_of_joints([[0, 0, 0], [1, 0, 0]], [-1, 0], ["a", "b"])
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    influences = Influences(np.array([0, 0, 1, 1, 1]), np.array([0, 1, 1, 0, 1]), np.array([2.0, 6, 0.25, -1, 0.5]))
    back, notes = written(tmp_path, Bundle(mesh, skeleton, influences))
    assert notes == ("1 negative weights are left out", "1 vertices have no weight and are given to 'a'")
    assert back.influences.dense(3, 2, "").tolist() == [[0.25, 0.75], [0, 1], [1, 0]]


def test_clips_that_do_not_fit_a_file_as_they_are(tmp_path):
    skeleton = Skeleton([[0, 0, 0], [1, 0, 0]], [[0, 1]], [-1], ("a",))
    B = np.tile(np.eye(4), (4, 1, 1, 1))
    B[:, 0, 2, 3] = np.arange(4)
    still = Clip("still", skeleton, np.array([0.0]), B[:1])
    clips = (still, Clip("none", skeleton, np.zeros(0), B[:0]), Clip("late", skeleton, np.array([-1.0, 0, 0, 1]), B))
    back, notes = written(tmp_path, Bundle(skeleton=skeleton, clips=clips))
    assert notes == (
        "clip 'none' has no frame and is left out",
        "clip 'late' starts at -1 s and is moved to 0 s",
        "clip 'late': of frames at the same time only the last is kept",
    )
    assert [clip.name for clip in back.clips] == ["still", "late"]
    assert back.clips[1].times.tolist() == [0, 1, 2]
    assert back.clips[1].B[:, 0, 2, 3].tolist() == [0, 2, 3]
    # A clip without motion is a clip.
    back, _ = written(tmp_path, Bundle(skeleton=skeleton, clips=(still,)))
    assert back.clips[0].B.tolist() == B[:1].tolist()


BONE = Skeleton([[0, 0, 0], [1, 0, 0]], [[0, 1]], [-1], ("a",))
FACE = Mesh(np.eye(3), np.array([[0, 1, 2]]))
ONE = Influences(np.array([0]), np.array([0]), np.array([1.0]))
STILL = np.eye(4)[None, None]
OTHER = Skeleton([[0, 0, 0], [1, 0, 0]], [[1, 0]], [-1], ("a",))


@pytest.mark.parametrize(
    ("parts", "match"),
    [
        (Bundle(), "neither a mesh nor a skeleton"),
        (Bundle(FACE, None, ONE), "need a skeleton"),
        (Bundle(FACE, clips=(Clip("c", BONE, [0.0], STILL),)), "need a skeleton"),
        (Bundle(None, BONE, ONE), "need a mesh"),
        (Bundle(Mesh(np.eye(3), np.zeros((0, 3), int))), "mesh of triangles"),
        (Bundle(Mesh(np.eye(2), np.array([[0, 1]]))), "mesh of triangles"),
        (Bundle(Mesh(np.eye(3), np.array([[0, 1, 3]]))), "E"),
        (Bundle(FACE, BONE, Influences(np.array([3]), np.array([0]), np.array([1.0]))), "influences.vertex"),
        (Bundle(FACE, BONE, Influences(np.array([0]), np.array([1]), np.array([1.0]))), "influences.bone"),
        (Bundle(None, BONE, None, (Clip("c", OTHER, [0.0], STILL),)), "clip 'c' belongs to another skeleton"),
        (Bundle(None, BONE, None, (Clip("c", BONE, [0.0], STILL * 2),)), "last row"),
        (Bundle(None, BONE, None, (Clip("c", BONE, [0.0, 1], STILL),)), "B must be"),
    ],
)
def test_arguments_that_cannot_be_written(tmp_path, parts, match):
    with pytest.raises(ValueError, match=match):
        write_gltf(tmp_path / "a.glb", parts)
    assert list(tmp_path.iterdir()) == []


def test_what_is_written_keeps_to_the_specification(tmp_path, rng):
    skeleton = chain(6, rng)
    mesh, influences = whole(skeleton, rng, most=6)
    clip = Clip("c", skeleton, np.arange(5.0), rigid(skeleton, rng))
    write_gltf(tmp_path / "a.glb", Bundle(mesh, skeleton, influences, (clip,)))
    data = (tmp_path / "a.glb").read_bytes()
    assert struct.unpack("<4sII", data[:12]) == (b"glTF", 2, len(data))
    size = struct.unpack("<I", data[12:16])[0]
    assert size % 4 == 0
    root, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    assert len(binary) == root["buffers"][0]["byteLength"]
    assert len(binary) % 4 == 0
    assert all(view["byteOffset"] % 4 == 0 for view in root["bufferViews"])
    attributes = root["meshes"][0]["primitives"][0]["attributes"]
    assert set(attributes) == {"POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1"}
    values = {}
    for name, index in attributes.items():
        entry = root["accessors"][index]
        view = root["bufferViews"][entry["bufferView"]]
        assert view["target"] == 34962
        kind = next(k for k, v in CODES.items() if v == entry["componentType"])
        values[name] = np.frombuffer(binary, kind, view["byteLength"] // np.dtype(kind).itemsize, view["byteOffset"])
        values[name] = values[name].reshape(entry["count"], -1)
    entry = root["accessors"][attributes["POSITION"]]
    assert entry["min"] == values["POSITION"].min(axis=0).tolist()
    assert entry["max"] == values["POSITION"].max(axis=0).tolist()
    np.testing.assert_allclose(np.linalg.norm(values["NORMAL"], axis=1), 1, atol=1e-6)
    W = np.concatenate([values["WEIGHTS_0"], values["WEIGHTS_1"]], axis=1)
    assert np.abs(W.astype(float).sum(axis=1) - 1).max() < 2e-7
    assert (np.diff(W, axis=1) <= 0).all()
    J = np.concatenate([values["JOINTS_0"], values["JOINTS_1"]], axis=1)
    assert not J[W == 0].any()
    for entry in root["animations"][0]["samplers"]:
        clock = root["accessors"][entry["input"]]
        assert (clock["min"], clock["max"]) == ([0.0], [4.0])
    assert all(node.get("children") != [] for node in root["nodes"])


def test_smooth_normals_point_outward(tmp_path):
    V = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [5, 5, 5]])
    sides = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    E = np.array([(x, y, z) if (x + y + z) % 2 == 0 else (y, x, z) for x, y, z in sides])
    write_gltf(tmp_path / "a.gltf", Bundle(Mesh(V, E)))
    root = json.loads((tmp_path / "a.gltf").read_text())
    view = root["bufferViews"][root["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    data = base64.b64decode(root["buffers"][0]["uri"].split(",")[1])
    N = np.frombuffer(data, "<f4", 21, view["byteOffset"]).reshape(7, 3)
    np.testing.assert_allclose(N, [*V[:6], [0, 0, 1]], atol=1e-6)
