"""Reading glTF: what is read agrees with the specification written as loops, and lies are caught."""

import base64
import json
import os
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io.errors import FileFormatError
from nilbs.io.gltf import read_gltf

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = [[0.0, 0, 0], [1, 0, 0], [0, 1, 1]]


class File:
    """A glTF file that a test puts together."""

    def __init__(self, **root):
        self.root = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "nodes": [], "meshes": [], **root}
        self.data = b""

    def view(self, data, **more):
        self.data += bytes(-len(self.data) % 4)
        self.root["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.root["bufferViews"]) - 1

    def accessor(self, values, kind="f4", **more):
        values = np.asarray(values, kind)
        values = values.reshape(len(values), -1)
        entry = {"bufferView": self.view(values.tobytes()), "componentType": CODES[kind], "count": len(values)}
        self.root["accessors"].append({**entry, "type": KINDS[values.shape[1]], **more})
        return len(self.root["accessors"]) - 1

    def mesh(self, attributes, indices=None, **more):
        primitive = {"attributes": attributes, **more}
        if indices is not None:
            primitive["indices"] = self.accessor(indices, "u2")
        self.root["meshes"].append({"primitives": [primitive]})
        return len(self.root["meshes"]) - 1

    def node(self, **entry):
        self.root["nodes"].append(entry)
        return len(self.root["nodes"]) - 1

    def json(self):
        self.root["buffers"] = [{"byteLength": len(self.data)}, *self.root.get("buffers", [])[1:]]
        return self.root

    def glb(self):
        return glb(self.json(), self.data)

    def read(self, folder):
        path = folder / "made.glb"
        path.write_bytes(self.glb())
        return read_gltf(path)


def glb(root, data=b""):
    text = (root if isinstance(root, str) else json.dumps(root)).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(data)) + b"BIN\0" + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def refused(folder, content, match, name="bad.glb"):
    path = folder / name
    path.write_bytes(content.glb() if isinstance(content, File) else content)
    with pytest.raises(FileFormatError, match=match) as caught:
        read_gltf(path)
    assert "\n" not in str(caught.value)


def matrix(t=(0, 0, 0), q=(0, 0, 0, 1), s=(1, 1, 1)):
    """Translation, quaternion and scale, by the textbook: v + 2 u x (u x v + w v)."""
    u, w = np.array(q[:3], float), float(q[3])
    columns = [e * k + 2 * np.cross(u, np.cross(u, e * k) + w * e * k) for e, k in zip(np.eye(3), s, strict=True)]
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = np.array(columns).T, t
    return M


def quaternion(rng):
    q = rng.normal(size=4)
    return (q / np.linalg.norm(q)).tolist()


def worlds(root, given=None):
    """World matrices of all nodes, some with other parts than at rest; recursively."""
    G = {}

    def walk(node, above):
        entry = {**root["nodes"][node], **(given or {}).get(node, {})}
        local = matrix(*(entry.get(k, d) for k, d in PARTS.items()))
        if "matrix" in entry:
            local = np.reshape(entry["matrix"], (4, 4)).T
        G[node] = above @ local
        for child in entry.get("children", []):
            walk(child, G[node])

    below = {c for n in root["nodes"] for c in n.get("children", [])}
    for node in set(range(len(root["nodes"]))) - below:
        walk(node, np.eye(4))
    return G


PARTS = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}


def skin_vertices(G, joints, bind, J, W, v):
    """What the specification says of a skin, as loops."""
    posed = np.zeros((len(v), 3))
    for i in range(len(v)):
        for j, w in zip(J[i], W[i], strict=True):
            posed[i] += w * (G[joints[j]] @ bind[j] @ np.append(v[i], 1))[:3]
    return posed


def posed(parts, clip=None, frame=0):
    """The vertices of what was read, as nilbs poses them."""
    V = np.pad(parts.mesh.V, ((0, 0), (0, 3 - parts.mesh.V.shape[1])))
    W = parts.influences.dense(len(V), len(parts.skeleton.names), "test")
    return linear_blend_skinning(V, W, parts.clips[clip].B[frame])


@pytest.fixture
def character(rng):
    """A file with a skin of four joints below nodes with any transforms, bound in the pose at rest."""
    file = File()
    file.node(name="top", children=[1], translation=[3, 1, 2], rotation=quaternion(rng), scale=[2, 2, 2])
    file.node(name="hip", children=[2, 4], translation=[1, 0, 0], rotation=quaternion(rng))
    file.node(name="between", children=[3], rotation=quaternion(rng), scale=[1, 1.5, 1])
    file.node(name="arm", children=[5], translation=[0, 2, 0], rotation=quaternion(rng))
    file.node(name="leg", translation=[0, -2, 0], rotation=quaternion(rng))
    file.node(name="hand", translation=[0, 1, 0], rotation=quaternion(rng), scale=[0.5, 0.5, 0.5])
    file.joints = [1, 4, 3, 5]
    # Bound to a mesh that has a place of its own.
    place = matrix([0, 5, 0], quaternion(rng), [3, 3, 3])
    G = worlds(file.root)
    file.bind = np.array([np.linalg.inv(G[j]) @ place for j in file.joints])
    file.place = place
    matrices = file.accessor(np.swapaxes(file.bind, 1, 2))
    file.root["skins"] = [{"joints": file.joints, "inverseBindMatrices": matrices}]
    file.v = rng.normal(size=(12, 3)).astype("f4").astype(float)
    file.J = np.array([rng.permutation(4) for _ in range(12)])
    W = rng.random((12, 4))
    file.W = W / W.sum(axis=1, keepdims=True)
    attributes = {"POSITION": file.accessor(file.v), "JOINTS_0": file.accessor(file.J, "u1")}
    attributes["WEIGHTS_0"] = file.accessor(file.W)
    mesh = file.mesh(attributes, np.arange(12))
    # A skinned mesh does not move with its own node.
    file.node(name="body", mesh=mesh, skin=0, translation=[100, 0, 0])
    return file


def animate(file, name, channels):
    """Channels: node, part, interpolation, times, values."""
    animation = {"name": name, "channels": [], "samplers": []}
    for node, part, interpolation, times, values in channels:
        sampler = {"input": file.accessor(times), "output": file.accessor(values), "interpolation": interpolation}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": node, "path": part}})
        animation["samplers"].append(sampler)
    file.root.setdefault("animations", []).append(animation)


def test_a_skin_at_rest_and_moved_as_the_specification_says(character, tmp_path, rng):
    file = character
    turns = np.array([quaternion(rng) for _ in range(3)])
    turns[2] *= -np.sign(
        turns[1] @ turns[2]
    )  # the other sign: the same rotation, and the way to it stays the short one
    turns = turns.tolist()
    moves = rng.normal(size=(2, 3)).tolist()
    channels = [
        (3, "rotation", "LINEAR", [0, 0.5, 2], turns),
        (0, "translation", "LINEAR", [0.5, 1], moves),
        (2, "scale", "STEP", [0, 1], [[1, 1, 1], [1, 2, 3]]),
    ]
    animate(file, "wave", channels)
    parts = file.read(tmp_path)
    s = parts.skeleton
    assert s.names == ("hip", "leg", "arm", "hand")
    assert s.P.tolist() == [-1, 0, 0, 2]  # the arm hangs on the hip through a node that is no joint
    G = worlds(file.root)
    np.testing.assert_allclose(s.C[s.BE[:, 0]], [G[j][:3, 3] for j in file.joints], atol=1e-5)
    np.testing.assert_allclose(parts.mesh.V, transform_points(file.place, file.v), atol=1e-5)
    assert parts.mesh.E.tolist() == np.arange(12).reshape(-1, 3).tolist()
    assert {name: g.tolist() for name, g in parts.mesh.groups.items()} == {"body": [0, 1, 2, 3]}
    np.testing.assert_allclose(
        parts.influences.dense(12, 4, ""), np.take_along_axis(file.W, np.argsort(file.J, axis=1), axis=1), atol=1e-7
    )
    (clip,) = parts.clips
    assert clip.name == "wave"
    assert clip.times.tolist() == [0, 0.5, 1, 2]
    assert not any("binding" in note for note in parts.notes)
    assert any("steps" in note for note in parts.notes)
    given = [
        {3: {"rotation": turns[0]}, 0: {"translation": moves[0]}, 2: {"scale": [1, 1, 1]}},
        {3: {"rotation": turns[1]}, 0: {"translation": moves[0]}, 2: {"scale": [1, 1, 1]}},
        {3: None, 0: {"translation": moves[1]}, 2: {"scale": [1, 2, 3]}},
        {3: {"rotation": turns[2]}, 0: {"translation": moves[1]}, 2: {"scale": [1, 2, 3]}},
    ]
    # A third of the way from 0.5 to 2 s, by the angle between the quaternions.
    q0, q1 = np.array(turns[1]), np.array(turns[2]) * np.sign(np.dot(turns[1], turns[2]))
    angle = np.arccos(q0 @ q1)
    given[2][3] = {"rotation": ((np.sin(angle * 2 / 3) * q0 + np.sin(angle / 3) * q1) / np.sin(angle)).tolist()}
    for frame in range(4):
        truth = skin_vertices(worlds(file.root, given[frame]), file.joints, file.bind, file.J, file.W, file.v)
        np.testing.assert_allclose(posed(parts, 0, frame), truth, atol=2e-5)


def test_the_pose_at_binding_is_the_rest_pose(character, tmp_path, rng):
    file = character
    for node in (2, 3, 5):
        file.root["nodes"][node]["rotation"] = quaternion(rng)
    turn = quaternion(rng)
    animate(file, "wave", [(4, "rotation", "LINEAR", [1], [turn])])
    parts = file.read(tmp_path)
    assert any("pose at binding" in note for note in parts.notes)
    # The root stands as before, so the mesh does, too.
    np.testing.assert_allclose(parts.mesh.V, transform_points(file.place, file.v), atol=1e-5)
    G = worlds(file.root, {4: {"rotation": turn}})
    truth = skin_vertices(G, file.joints, file.bind, file.J, file.W, file.v)
    np.testing.assert_allclose(posed(parts, 0, 0), truth, atol=2e-5)


def test_cubic_splines(character, tmp_path, rng):
    file = character
    times = np.array([0.0, 2])
    move, turn = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 4))
    animate(
        file,
        "swing",
        [
            (1, "translation", "CUBICSPLINE", times, move.reshape(6, 3)),
            (3, "rotation", "CUBICSPLINE", times, turn.reshape(6, 4)),
            (5, "scale", "LINEAR", [0, 0.5, 2], [[1, 1, 1], [2, 2, 2], [1, 1, 1]]),
        ],
    )
    parts = file.read(tmp_path)
    assert parts.clips[0].times.tolist() == [0, 0.5, 2]
    t, h = 0.25, 2.0  # the specification's formula, between keys 2 s apart

    def value(k):
        first = (2 * t**3 - 3 * t**2 + 1) * k[0, 1] + h * (t**3 - 2 * t**2 + t) * k[0, 2]
        return first + (-2 * t**3 + 3 * t**2) * k[1, 1] + h * (t**3 - t**2) * k[1, 0]

    q = value(turn)
    given = {1: {"translation": value(move)}, 3: {"rotation": q / np.linalg.norm(q)}, 5: {"scale": [2, 2, 2]}}
    truth = skin_vertices(worlds(file.root, given), file.joints, file.bind, file.J, file.W, file.v)
    np.testing.assert_allclose(posed(parts, 0, 1), truth, atol=1e-4)


def test_a_single_key_holds_at_all_times(character, tmp_path):
    channels = [(1, "translation", "CUBICSPLINE", [1], [[9, 9, 9], [1, 2, 3], [9, 9, 9]])]
    animate(character, "a", [*channels, (1, "scale", "LINEAR", [0, 2], [[1, 1, 1], [1, 1, 1]])])
    clip = character.read(tmp_path).clips[0]
    assert clip.times.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(clip.B[0], clip.B[2])
    np.testing.assert_array_equal(clip.B[1], clip.B[2])


@pytest.mark.parametrize(("kind", "scale"), [("u1", 255), ("u2", 65535), ("f4", 1)], ids=["bytes", "shorts", "floats"])
@pytest.mark.parametrize("joint_kind", ["u1", "u2"])
def test_all_sets_of_weights(character, tmp_path, rng, kind, scale, joint_kind):
    file = character
    W = np.round(rng.random((12, 8)) * scale * 0.5) if scale > 1 else rng.random((12, 8)).astype("f4")
    W[:, 5] = 0
    J = rng.integers(0, 4, (12, 8))
    J[:, 5] = 200  # where there is no weight nobody looks
    attributes = file.root["meshes"][0]["primitives"][0]["attributes"]
    for s in (0, 1):
        attributes[f"JOINTS_{s}"] = file.accessor(J[:, 4 * s : 4 * s + 4], joint_kind)
        attributes[f"WEIGHTS_{s}"] = file.accessor(W[:, 4 * s : 4 * s + 4], kind, normalized=scale > 1)
    truth = np.zeros((12, 4))
    for i in range(12):
        for k in (0, 1, 2, 3, 4, 6, 7):
            truth[i, J[i, k]] += W[i, k] / scale
    np.testing.assert_allclose(file.read(tmp_path).influences.dense(12, 4, ""), truth, atol=1e-7)


def test_interleaved_sparse_and_quantized(tmp_path, rng):
    file = File(extensionsRequired=["KHR_mesh_quantization"], extensionsUsed=["KHR_mesh_quantization"])
    whole = rng.integers(-128, 128, (5, 3))
    whole[1, 1] = -128
    rows = b"".join(struct.pack("<3bx3f", *p, *n) for p, n in zip(whole.tolist(), np.eye(5, 3).tolist(), strict=True))
    view = file.view(b"\xff" * 4 + rows, byteStride=16)
    accessor = {"bufferView": view, "byteOffset": 4, "componentType": 5120, "count": 5, "type": "VEC3"}
    file.root["accessors"] = [accessor, {**accessor, "normalized": True}]
    at, by = file.view(bytes([1, 4])), file.view(struct.pack("<6f", *range(6)))
    sparse = {"count": 2, "indices": {"bufferView": at, "componentType": 5121}, "values": {"bufferView": by}}
    file.root["accessors"].append({"componentType": 5126, "count": 5, "type": "VEC3", "sparse": sparse})
    based = file.accessor(np.ones((5, 3)), sparse=sparse)
    for position in (0, 1, 2, based):
        file.node(mesh=file.mesh({"POSITION": position}, [0, 1, 2]))
    V = file.read(tmp_path).mesh.V.reshape(4, 5, 3)
    np.testing.assert_array_equal(V[0], whole)
    np.testing.assert_allclose(V[1], np.maximum(whole / 127, -1), atol=1e-15)
    assert V[2].tolist() == [[0, 0, 0], [0, 1, 2], [0, 0, 0], [0, 0, 0], [3, 4, 5]]
    assert V[3].tolist() == [[1, 1, 1], [0, 1, 2], [1, 1, 1], [1, 1, 1], [3, 4, 5]]


def test_strips_fans_and_meshes_without_indices(tmp_path):
    file = File()
    V = file.accessor(np.arange(18.0).reshape(6, 3) ** 2)
    file.node(mesh=file.mesh({"POSITION": V}, [0, 1, 2, 3, 3, 4, 5], mode=5))
    file.node(mesh=file.mesh({"POSITION": V}, mode=6))
    file.node(mesh=file.mesh({"POSITION": V}))
    file.node(mesh=file.mesh({"POSITION": V}, mode=1))
    parts = file.read(tmp_path)
    strip = [[0, 1, 2], [1, 3, 2], [3, 4, 5]]  # the odd ones are turned; those that sew are gone
    fan = [[6, 7, 8], [6, 8, 9], [6, 9, 10], [6, 10, 11]]
    assert parts.mesh.E.tolist() == [*strip, *fan, [12, 13, 14], [15, 16, 17]]
    assert len(parts.mesh.V) == 18
    assert parts.notes == ("points and lines are left out",)
    assert (parts.skeleton, parts.influences, parts.clips) == (None, None, ())


def test_meshes_stand_where_their_nodes_do(tmp_path, rng):
    file = File(scenes=[{"nodes": []}, {"nodes": [0, 3]}], scene=1)
    mesh = file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 2])
    file.root["meshes"][0]["name"] = "wedge"
    turned = matrix([1, 2, 3], quaternion(rng), [1, 2, 3])
    file.node(name="first", children=[1], matrix=turned.T.ravel().tolist())
    file.node(name="second", mesh=mesh, scale=[-1, 1, 1])
    file.node(name="hidden", mesh=mesh)
    file.node(mesh=mesh)
    parts = file.read(tmp_path)
    mirrored = transform_points(turned @ np.diag([-1.0, 1, 1, 1]), TRIANGLE)
    np.testing.assert_allclose(parts.mesh.V, [*mirrored, *TRIANGLE], atol=1e-12)
    assert parts.mesh.E.tolist() == [[2, 1, 0], [3, 4, 5]]  # what is mirrored is turned round
    assert {k: v.tolist() for k, v in parts.mesh.groups.items()} == {"second": [0], "wedge": [0, 1]}


def test_primitives_that_share_their_vertices(tmp_path):
    file = File()
    file.mesh({"POSITION": file.accessor([*TRIANGLE, [1, 1, 1]])}, [0, 1, 2])
    primitives = file.root["meshes"][0]["primitives"]
    primitives.append({**primitives[0], "indices": file.accessor([1, 3, 2], "u1"), "targets": [{}]})
    file.node(mesh=0)
    parts = file.read(tmp_path)
    assert parts.mesh.V.shape == (4, 3)
    assert parts.mesh.E.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert parts.notes == ("morph targets are left out",)


def test_a_flat_mesh_lies_in_the_plane(tmp_path):
    file = File()
    file.node(mesh=file.mesh({"POSITION": file.accessor([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])}, range(3)))
    file.root["meshes"][0]["primitives"].append(
        {"attributes": {"POSITION": 0}, "indices": file.accessor([1, 2, 3], "u2")}
    )
    file.root["meshes"][0]["primitives"].append(
        {"attributes": {"POSITION": 0}, "indices": file.accessor([3, 0, 2], "u2")}
    )
    mesh = file.read(tmp_path).mesh
    assert mesh.V.shape == (4, 2)
    assert mesh.E.tolist() == [[0, 1, 2], [1, 3, 2], [3, 2, 0]]


def test_meshes_without_a_skin_follow_joints(character, tmp_path, rng):
    file = character
    for node in (2, 3):  # no longer the pose at binding
        file.root["nodes"][node]["rotation"] = quaternion(rng)
    sword = file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 2])
    grip = file.node(
        name="grip", translation=[0, 0, 1], children=[file.node(name="sword", mesh=sword, scale=[2, 1, 1])]
    )
    file.root["nodes"][5]["children"] = [grip]
    file.root["nodes"][4]["mesh"] = sword
    animate(file, "a", [(5, "rotation", "LINEAR", [0], [quaternion(rng)]), (grip, "scale", "LINEAR", [0], [[2, 2, 2]])])
    file.node(name="floor", mesh=sword, rotation=quaternion(rng))
    given = {5: {"rotation": file_values(file, 0)}}
    G = worlds(file.root, given)
    parts = file.read(tmp_path)
    U = posed(parts, 0, 0)
    leg, body, blade, floor = U[:3], U[3:15], U[15:18], U[18:]
    np.testing.assert_allclose(leg, transform_points(G[4], TRIANGLE), atol=2e-5)
    np.testing.assert_allclose(body, skin_vertices(G, file.joints, file.bind, file.J, file.W, file.v), atol=2e-5)
    np.testing.assert_allclose(blade, transform_points(G[7], TRIANGLE), atol=2e-5)
    np.testing.assert_allclose(floor, transform_points(G[9], TRIANGLE), atol=2e-5)
    assert any("'floor' hangs on no joint" in note for note in parts.notes)
    assert any("moves nodes above no joint" in note for note in parts.notes)
    assert parts.influences.dense(len(U), 4, "")[18:].tolist() == [[1, 0, 0, 0]] * 3


def file_values(file, animation):
    """The first value of the first channel of an animation."""
    accessor = file.root["accessors"][file.root["animations"][animation]["samplers"][0]["output"]]
    view = file.root["bufferViews"][accessor["bufferView"]]
    return np.frombuffer(file.data, "<f4", 4, view["byteOffset"]).astype(float)


def test_skins_are_united_by_their_joints(character, tmp_path, rng):
    file = character
    # The second skin shares the arm and adds the hand of another mesh place; the third has only the hand's child.
    tip = file.node(name="hand", translation=[0, 1, 0])
    file.root["nodes"][5]["children"] = [tip]
    place = [matrix(rng.normal(size=3), quaternion(rng)) for _ in range(2)]
    G = worlds(file.root)
    lists = [[5, 3], [tip]]
    for joints, own in zip(lists, place, strict=True):
        bind = np.array([np.linalg.inv(G[j]) @ own for j in joints])
        matrices = file.accessor(np.swapaxes(bind, 1, 2))
        file.root["skins"].append({"joints": joints, "inverseBindMatrices": matrices})
        W = np.tile([1.0, 0, 0, 0], (3, 1))
        attributes = {"POSITION": file.accessor(TRIANGLE), "JOINTS_0": file.accessor(np.zeros((3, 4)), "u1")}
        mesh = file.mesh({**attributes, "WEIGHTS_0": file.accessor(W)}, [0, 1, 2])
        file.node(mesh=mesh, skin=len(file.root["skins"]) - 1)
    # Posed otherwise at rest: what is bound stays together all the same.
    file.root["nodes"][5]["rotation"] = quaternion(rng)
    parts = file.read(tmp_path)
    assert parts.skeleton.names == ("hip", "leg", "arm", "hand", "hand_2")
    assert parts.skeleton.P.tolist() == [-1, 0, 0, 2, 3]
    np.testing.assert_allclose(parts.mesh.V[12:15], transform_points(place[0], TRIANGLE), atol=1e-4)
    np.testing.assert_allclose(parts.mesh.V[15:], transform_points(place[1], TRIANGLE), atol=1e-4)
    assert parts.influences.bone[-6:].tolist() == [3, 3, 3, 4, 4, 4]
    assert not any("bound in another pose" in note for note in parts.notes)


def test_a_skin_that_was_bound_in_another_pose(character, tmp_path, rng):
    file = character
    G = worlds(file.root, {3: {"rotation": quaternion(rng)}})
    bind = np.array([np.linalg.inv(G[j]) for j in (1, 3)])
    file.root["skins"].append({"joints": [1, 3], "inverseBindMatrices": file.accessor(np.swapaxes(bind, 1, 2))})
    W = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]])
    J = np.tile([0, 1, 0, 0], (3, 1))
    attributes = {"POSITION": file.accessor(TRIANGLE), "JOINTS_0": file.accessor(J, "u1")}
    file.node(mesh=file.mesh({**attributes, "WEIGHTS_0": file.accessor(W)}, [0, 1, 2]), skin=1)
    animate(file, "a", [(3, "rotation", "LINEAR", [0], [quaternion(rng)])])
    parts = file.read(tmp_path)
    assert any("bound in another pose" in note for note in parts.notes)
    assert any("without any weight" in note for note in parts.notes)
    moved = worlds(file.root, {3: {"rotation": file_values(file, 0)}})
    truth = skin_vertices(moved, [1, 3], bind, J[:2], W[:2], np.array(TRIANGLE)[:2])
    np.testing.assert_allclose(posed(parts, 0, 0)[12:14], truth, atol=2e-5)


def test_names_and_ends(tmp_path):
    file = File()
    file.node(children=[1, 2, 3], name="a")
    file.node(name="a", translation=[1, 0, 0])
    file.node(translation=[0, 1, 0])
    file.node(name="a_end", translation=[0, 0, 7])
    file.root["skins"] = [{"joints": [0, 1, 2]}]
    parts = file.read(tmp_path)
    s = parts.skeleton
    assert s.names == ("a", "a_2", "bone2")
    assert any("'a' became 'a_2'" in note for note in parts.notes)
    # Without inverse bind matrices the joints are bound where the root stands.
    assert s.C[s.BE[:, 0]].tolist() == [[0, 0, 0]] * 3
    assert s.C[s.BE[0, 1]].tolist() == [0, 0, 7]
    assert parts.mesh is None
    assert any("pose at binding" in note for note in parts.notes)


def test_a_skeleton_that_no_mesh_hangs_on(tmp_path):
    file = File(skins=[{"joints": [0]}])
    file.node(name="a")
    file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}))
    parts = file.read(tmp_path)
    assert parts.influences is None
    assert parts.notes == ("no mesh hangs on the skeleton: the file has no weights",)


def test_animations_that_move_no_joint(character, tmp_path):
    file = character
    file.root["animations"] = [
        {"name": "light", "channels": [{"sampler": 0, "target": {"path": "pointer"}}], "samplers": [{}]},
        {"name": "face", "channels": [{"sampler": 0, "target": {"node": 6, "path": "weights"}}], "samplers": [{}]},
    ]
    parts = file.read(tmp_path)
    assert parts.clips == ()
    assert set(parts.notes) == {
        "animation 'light' moves no joint and is left out",
        "animation 'face' moves no joint and is left out",
        "morph targets are animated, which is left out",
    }


class TestWhereBuffersComeFrom:
    def gltf(self, folder, uri, data=None):
        file = File()
        file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}))
        file.json()["buffers"][0]["uri"] = uri
        path = folder / "made.gltf"
        path.write_text(json.dumps(file.root))
        return path, file.data

    @pytest.mark.parametrize("name", ["a b.bin", "below/ä.bin"])
    def test_beside_the_file(self, tmp_path, name):
        path, data = self.gltf(tmp_path, name.replace(" ", "%20"))
        with pytest.raises(FileNotFoundError):
            read_gltf(path)
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
        assert read_gltf(path).mesh.V.tolist() == TRIANGLE
        (tmp_path / name).write_bytes(data[:-1])
        with pytest.raises(FileFormatError, match="buffer 0 claims 36 bytes and has 35"):
            read_gltf(path)

    def test_in_the_file(self, tmp_path):
        _, data = self.gltf(tmp_path, "")
        text = base64.b64encode(data).decode()
        path, _ = self.gltf(tmp_path, f"data:application/octet-stream;base64,{text}")
        assert read_gltf(path).mesh.V.tolist() == TRIANGLE

    @pytest.mark.parametrize(
        "uri",
        [
            *[
                "",
                "/etc/passwd",
                "../secret.bin",
                "a/../../secret.bin",
                "a/../made.gltf",
                "%2e%2e/secret.bin",
                "https://a.b/c.bin",
            ],
            *[
                "file:secret.bin",
                "..\\secret.bin",
                "C:/secret.bin",
                "a\0.bin",
                "\ud800.bin",
                "\n",
                3,
                None,
                [],
                "link.bin",
            ],
            *["data:;base64,AAA", "data:,AAAA", "data:;base64", "data:;base64,ä"],
        ],
    )
    def test_nowhere_else(self, tmp_path, uri):
        folder = tmp_path / "inside"
        folder.mkdir()
        (tmp_path / "secret.bin").write_bytes(bytes(36))
        os.symlink(tmp_path / "secret.bin", folder / "link.bin")
        path, _ = self.gltf(folder, uri)
        with pytest.raises(FileFormatError, match=r"buffer 0|bufferView 0") as caught:
            read_gltf(path)
        assert "\n" not in str(caught.value)


def changed(change):
    """A good file that was changed."""

    def make(file):
        animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
        change(file.root)
        return file

    return make


def put(value, *keys):
    """Put a value at a place in the JSON."""

    def change(root):
        for key in keys[:-1]:
            root = root[key]
        root[keys[-1]] = value

    return changed(change)


def spread(root):
    """A billion zeros."""
    del root["accessors"][1]["bufferView"]
    root["accessors"][1]["count"] = 10**9


def again(root):
    """One channel twice."""
    root["animations"][0]["channels"] *= 2


def lone(root):
    """Joints without weights."""
    del root["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]


def ring(root):
    """Two nodes below each other."""
    root["nodes"] += [{"children": [8]}, {"children": [7]}]


FAR_INDEX = {"count": 1, "indices": {"componentType": 5125, "bufferView": 3}, "values": {"bufferView": 1}}
LIES = {
    "version": (put("1.0", "asset", "version"), "glTF 1.0"),
    "no version": (put({}, "asset"), "of no version"),
    "asset": (put([], "asset"), "'asset' must be an object|asset must be an object"),
    "draco": (put(["KHR_draco_mesh_compression"], "extensionsRequired"), "without compression"),
    "meshopt": (put(["EXT_meshopt_compression"], "extensionsRequired"), "without compression"),
    "extension": (put(["EXT_mesh_gpu_instancing"], "extensionsRequired"), "requires the extension EXT_mesh_gpu"),
    "extensions": (put("EXT", "extensionsRequired"), "list of strings"),
    "count": (put(10**9, "accessors", 1, "count"), "takes 12000000000 bytes of bufferView 1|hold many times more"),
    "huge count": (put(10**400, "accessors", 1, "count"), "'count' is 1000"),
    "small count": (put(13, "accessors", 1, "count"), "takes 156 bytes of bufferView 1, which has 144"),
    "negative count": (put(-1, "accessors", 1, "count"), "whole number"),
    "boolean count": (put(True, "accessors", 1, "count"), "whole number"),
    "missing count": (changed(lambda root: root["accessors"][1].pop("count")), "is missing"),
    "endless zeros": (changed(spread), "many times more"),
    "component": (put(5124, "accessors", 1, "componentType"), "known component type"),
    "type": (put("VEC2", "accessors", 1, "type"), "must be of type VEC3"),
    "type of joints": (put(5126, "accessors", 2, "componentType"), "unsigned integers"),
    "offset": (put(4, "accessors", 1, "byteOffset"), "takes 148 bytes"),
    "stride 0": (put(0, "bufferViews", 1, "byteStride"), "a stride of 0 bytes"),
    "huge stride": (put(2**40, "bufferViews", 1, "byteStride"), "a stride of"),
    "long stride": (put(16, "bufferViews", 1, "byteStride"), "takes 188 bytes"),
    "view": (put(10**6, "bufferViews", 1, "byteLength"), "bufferView 1 .* ends at byte"),
    "view's start": (put(10**18, "bufferViews", 1, "byteOffset"), "whole number|ends at byte"),
    "missing view": (put(99, "accessors", 1, "bufferView"), r"bufferViews\[99\]"),
    "missing buffer": (put(1, "bufferViews", 1, "buffer"), r"buffers\[1\]"),
    "buffer without data": (
        changed(lambda root: (root["bufferViews"][1].update(buffer=1), root.update(buffers=[{}, {"byteLength": 200}]))),
        "buffer 1 has no data",
    ),
    "list of accessors": (put({}, "accessors"), "list of objects"),
    "list of nodes": (put([1], "nodes"), "list of objects"),
    "name": (put(5, "nodes", 0, "name"), "must be a string"),
    "many nodes": (put([{}] * (2**17 + 1), "nodes"), "at most 131072"),
    "circle": (put([1], "nodes", 5, "children"), "node 1 is a child of node 0 and of node 5"),
    "closed circle": (changed(ring), "below itself"),
    "own child": (changed(lambda root: root["nodes"].append({"children": [7]})), "below itself"),
    "two parents": (put([3], "nodes", 6, "children"), "node 3 is a child of node 2 and of node 6"),
    "child": (put([77], "nodes", 6, "children"), "'children' must be a list of indices"),
    "children": (put(3, "nodes", 6, "children"), "'children' must be a list of indices"),
    "scene": (put([{"nodes": [50]}], "scenes"), "scene 0"),
    "scene number": (changed(lambda root: root.update(scenes=[{}], scene=1)), "'scene'"),
    "translation": (put([1, 2], "nodes", 0, "translation"), "3 finite numbers"),
    "null": (put(None, "nodes", 0, "translation"), "3 finite numbers"),
    "word": (put(["1", 2, 3], "nodes", 0, "translation"), "3 finite numbers"),
    "too large": (put([10**400, 0, 0], "nodes", 0, "translation"), "3 finite numbers"),
    "overflow": (put([1e200, 0, 0], "nodes", 0, "scale"), "out of bounds"),
    "zero rotation": (put([0, 0, 0, 0], "nodes", 0, "rotation"), "node 0: the rotation is zero"),
    "matrix": (put([1] * 15, "nodes", 0, "matrix"), "16 finite numbers"),
    "no affine map": (put([*range(1, 17)], "nodes", 6, "matrix"), "last row"),
    "flat root": (put([0, 0, 0], "nodes", 1, "scale"), "root joint: it is singular"),
    "joints": (put([1, 1], "skins", 0, "joints"), "each once"),
    "no joints": (put([], "skins", 0, "joints"), "each once"),
    "joint": (put([1, 99], "skins", 0, "joints"), "'joints' must be a list of indices"),
    "few matrices": (put([1, 4, 3, 5, 0], "skins", 0, "joints"), "5 joints but 4 inverse"),
    "joint of a weight": (put([1, 4, 3], "skins", 0, "joints"), "refers to joint 3 of a skin of 3"),
    "mesh": (put(4, "nodes", 6, "mesh"), "'mesh' is 4"),
    "skin": (put(4, "nodes", 6, "skin"), "'skin' is 4"),
    "primitives": (put(1, "meshes", 0, "primitives"), "list of objects"),
    "mode": (put(-1, "meshes", 0, "primitives", 0, "mode"), "whole number"),
    "attributes": (put([], "meshes", 0, "primitives", 0, "attributes"), "must be an object"),
    "no positions": (put({}, "meshes", 0, "primitives", 0, "attributes"), "no positions"),
    "positions": (put(1.5, "meshes", 0, "primitives", 0, "attributes", "POSITION"), "whole number"),
    "no weights": (changed(lone), "without the other"),
    "sizes": (put(11, "accessors", 2, "count"), "12 positions, 11 JOINTS_0 and 12 WEIGHTS_0"),
    "corners": (put(11, "accessors", 4, "count"), "no whole triangles"),
    "corner": (put(11, "accessors", 1, "count"), "11 positions, 12|refers to vertex 11 of 11"),
    "sparse": (put({}, "accessors", 1, "sparse"), "'count' is missing"),
    "sparse object": (put(7, "accessors", 1, "sparse"), "must be an object"),
    "sparse count": (put({"count": 13}, "accessors", 1, "sparse"), "'count' is 13"),
    "sparse type": (put({"count": 1, "indices": {"componentType": 5126}}, "accessors", 1, "sparse"), "unsigned"),
    "sparse index": (
        put(FAR_INDEX, "accessors", 1, "sparse"),
        "sparse index",
    ),
    "interpolation": (put("CUBIC", "animations", 0, "samplers", 0, "interpolation"), "unknown interpolation 'CUBIC'"),
    "spline": (put("CUBICSPLINE", "animations", 0, "samplers", 0, "interpolation"), "2 keys need 6 values, not 2"),
    "keys": (put(1, "accessors", 5, "count"), "1 keys need 1 values, not 2"),
    "no keys": (put(0, "accessors", 5, "count"), "must increase"),
    "input": (put(6, "animations", 0, "samplers", 0, "input"), "must be of type SCALAR"),
    "sampler": (put(1, "animations", 0, "channels", 0, "sampler"), "'sampler' is 1"),
    "node": (put(99, "animations", 0, "channels", 0, "target", "node"), "'node' is 99"),
    "twice": (changed(again), "animated twice"),
    "moved matrix": (
        changed(lambda root: root["nodes"].__setitem__(3, {"matrix": np.eye(4).ravel().tolist(), "children": [5]})),
        "the rotation of node 3 has a matrix",
    ),
    "nothing": (changed(lambda root: root.update(meshes=[], nodes=[], skins=[], animations=[])), "neither a mesh"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_lies_are_caught(character, tmp_path, lie):
    make, match = LIES[lie]
    refused(tmp_path, make(character), match)


@pytest.mark.parametrize(
    ("accessor", "values", "match"),
    [
        (0, np.full((4, 16), np.nan), "not finite"),
        (0, np.tile(np.diag([1, 1, 0, 1]).ravel(), (4, 1)), "inverse bind matrix 0: it is singular"),
        (0, np.tile(np.ones(16), (4, 1)), "last row"),
        (0, np.tile((np.eye(4) * [1e-30, 1e-30, 1e-30, 1]).ravel(), (4, 1)), None),
        (0, np.array([np.diag([s, s, s, 1]).ravel() for s in (1e37, 1e-37, 1, 1)]), "out of bounds"),
        (1, np.full((12, 3), np.inf), "not finite"),
        (5, [[1.0], [1.0]], "must increase"),
        (5, [[2.0], [1.0]], "must increase"),
        (5, [[np.nan], [1.0]], "not finite"),
        (6, np.zeros((2, 4)), "key 0 is zero"),
    ],
)
def test_numbers_that_lie(character, tmp_path, accessor, values, match):
    file = character
    animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
    file.root["accessors"][accessor] = file.root["accessors"][file.accessor(values)]
    if match is None:
        assert np.isfinite(file.read(tmp_path).mesh.V).all()
    else:
        refused(tmp_path, file, match)


def test_animations_out_of_bounds(character, tmp_path):
    file = character
    file.root["nodes"][0]["scale"] = [1e25] * 3
    del file.root["skins"][0]["inverseBindMatrices"]
    animate(file, "wave", [(1, "scale", "LINEAR", [0], [[1e38] * 3])])
    refused(tmp_path, file, "animation 'wave' at 0.0 s: the transform of 'hip' is out of bounds")


def test_animations_of_many_frames_and_nodes(tmp_path):
    file = File(skins=[{"joints": [*range(1000)]}])
    for _ in range(1000):
        file.node()
    animate(file, "long", [(0, "scale", "LINEAR", np.arange(5000), np.ones((5000, 3)))])
    refused(tmp_path, file, "5000 frames of 1000 nodes, too many")


def test_meshes_repeated_without_end(tmp_path):
    file = File()
    mesh = file.mesh({"POSITION": file.accessor(np.ones((999, 3)))})
    for _ in range(10**4):
        file.node(mesh=mesh)
    refused(tmp_path, file, "many times more numbers than the file has bytes")


def test_corners_beyond_the_vertices(tmp_path):
    file = File()
    file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 3]))
    refused(tmp_path, file, "mesh 0, primitive 0 refers to vertex 3 of 3")


def test_whole_numbers_may_be_written_with_a_point(character, tmp_path):
    character.root["nodes"][6]["mesh"] = 0.0
    assert len(character.read(tmp_path).mesh.V) == 12


def test_names_with_line_ends_stay_on_one_line(character, tmp_path):
    file = character
    file.root["nodes"][3]["name"] = "ar\nm\ud800"
    assert file.read(tmp_path).skeleton.names[2] == "ar?m?"


GOOD = b'{"asset":{"version":"2.0"}}'


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("a.gltf", b"", "empty"),
        ("a.gltf", b"[" * 10**5, "too deep"),
        ("a.gltf", b'{"a":' * 10**5, "too deep"),
        ("a.gltf", b'{"asset": NaN}', "NaN"),
        ("a.gltf", b'\n{"asset": }', "a.gltf:2: this is no JSON"),
        ("a.gltf", b"\xff\xfe", "no JSON"),
        ("a.gltf", b'{"a": ' + b"9" * 10**4 + b"}", "no JSON"),
        ("a.gltf", b"[]", "must be an object"),
        ("a.gltf", GOOD, "neither a mesh"),
        ("a.obj", GOOD, "must end in .gltf or .glb"),
        ("a.glb", GOOD, "no GLB"),
        ("a.glb", b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "GLB version 1"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 2**32 - 1) + bytes(8), "claims 4294967295 bytes"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 24) + struct.pack("<I", 99) + b"JSON{}  ", "claims 99 bytes"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 24) + struct.pack("<I", 4) + b"BIN\0{}  ", "must be JSON"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 12) + bytes(12), "must be JSON"),
        ("a.glb", glb("{"), "a.glb: this is no JSON"),
    ],
)
def test_containers_that_lie(tmp_path, name, content, match):
    refused(tmp_path, content, match, name)


def check(path, content):
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    try:
        parts = read_gltf(path)
    except (FileFormatError, FileNotFoundError):
        return
    if parts.mesh is not None:
        assert np.isfinite(parts.mesh.V).all()
        assert ((parts.mesh.E >= 0) & (len(parts.mesh.V) > parts.mesh.E)).all()
    assert all(np.isfinite(clip.B).all() for clip in parts.clips)


@given(data=st.data())
def test_any_bytes_in_a_good_file(character, tmp_path, data):
    content = bytearray(character.glb())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.sampled_from([0, 1, 4, 60]))] = data.draw(st.binary(max_size=4))
    check(tmp_path / "a.glb", bytes(content))


ODD = [None, True, -1, 0, 1, 2, 3.5, 10**9, 10**40, 1e300, "", "VEC3", "..", [], [0], [1e308] * 3, {}, [{}], [[]]]
VALUES = st.sampled_from([*ODD, {"count": 1}])


def places(value, path=()):
    """All places in a JSON value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, below in inner:
        yield (*path, key)
        yield from places(below, (*path, key))


@given(data=st.data())
def test_any_values_in_a_good_file(character, tmp_path, data):
    file = character
    if "animations" not in file.root:
        animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
    root = json.loads(json.dumps(file.json()))
    for _ in range(data.draw(st.integers(1, 3))):
        keys = data.draw(st.sampled_from([*places(root)]))
        inner = root
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = data.draw(VALUES)
    check(tmp_path / "a.glb", glb(root, file.data))
