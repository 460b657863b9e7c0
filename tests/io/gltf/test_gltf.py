"""Reading glTF: what is read agrees with the specification written as loops."""

import struct

import numpy as np
import pytest

from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skinning import linear_blend_skinning

from .files import TRIANGLE, File, animate, matrix, quaternion, worlds


def skin_vertices(G, joints, bind, J, W, v):
    """The specification's skinning, as loops."""
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


def test_a_skin_at_rest_and_moved_as_in_the_specification(character, tmp_path, rng):
    file = character
    turns = np.array([quaternion(rng) for _ in range(3)])
    turns[2] *= -np.sign(turns[1] @ turns[2])  # the other sign: the same rotation, reached on the short way
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
    J[:, 5] = 200  # joints without weight are not read
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
    strip = [[0, 1, 2], [1, 3, 2], [3, 4, 5]]  # odd triangles are turned, degenerate ones are left out
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
    assert parts.mesh.E.tolist() == [[2, 1, 0], [3, 4, 5]]  # mirrored triangles are turned
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
    # Another pose at rest: what is bound stays together.
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
