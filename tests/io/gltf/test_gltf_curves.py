"""Animations at any time: read as in the specification written as loops, and written again with the same curves."""

from dataclasses import replace

import numpy as np
import pytest

from nilbs.characters.bundle import load_bundle
from nilbs.characters.motion import motion_of_clips
from nilbs.characters.saving import write_bundle
from nilbs.geometry.curves import Curve, curves_between
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io.bundle import Bundle, Clip
from nilbs.io.bvh import read_bvh, write_bvh
from nilbs.io.gltf import read_gltf
from nilbs.io.gltf_writer import write_gltf

from .files import PARTS, TRIANGLE, File, animate, matrix, quaternion, worlds

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
KINDS = ("step", "linear", "cubicspline")


def curve(part, kind, rng, *, keys):
    """A random curve in single precision."""
    times = np.sort(rng.uniform(0.1, 2, keys))
    values = rng.normal(size=(keys, 3, WIDTHS[part]))
    if part == "scale":
        values[:, 1] = rng.uniform(0.5, 1.5, (keys, 3))
    if part == "rotation":
        values /= np.linalg.norm(values[:, 1:2], axis=2, keepdims=True)
    values = values if kind == "cubicspline" else values[:, 1]
    return Curve(*(array.astype(np.float32).astype(float) for array in (times, values)), kind)


def moving(rng):
    """A skin of joints with other nodes above and between them, and random curves of all kinds, by node and part."""
    file = File()
    #        0 top      1 hip  2 between  3 arm  4 leg  5 fixed  6 foot  7 hand  8 finger
    parent = [None, 0, 1, 2, 1, 4, 5, 3, 7]
    for node in range(len(parent)):
        entry = {"translation": rng.normal(size=3).tolist(), "rotation": quaternion(rng)}
        entry |= {"scale": rng.uniform(0.5, 1.5, 3).tolist()}
        if node == 5:
            entry = {"matrix": matrix(*entry.values()).T.ravel().tolist()}
        below = [child for child, above in enumerate(parent) if above == node]
        file.node(**entry, **({"children": below} if below else {}))
    joints = [3, 1, 4, 6, 7, 8]
    G = worlds(file.root, {node: {"rotation": quaternion(rng)} for node in (3, 4)})  # not the pose at rest
    bind = np.array([np.linalg.inv(G[joint]) for joint in joints]).astype(np.float32).astype(float)
    file.root["skins"] = [{"joints": joints, "inverseBindMatrices": file.accessor(np.swapaxes(bind, 1, 2))}]
    v = (3 * rng.normal(size=(12, 3))).astype(np.float32).astype(float)
    J = np.array([rng.permutation(6)[:4] for _ in v])
    W = rng.random((len(v), 4))
    attributes = {"POSITION": file.accessor(v), "JOINTS_0": file.accessor(J, "u1")}
    attributes["WEIGHTS_0"] = file.accessor(W / W.sum(axis=1, keepdims=True))
    file.node(mesh=file.mesh(attributes, np.arange(12)), skin=0)
    curves = {}
    kinds = [*KINDS] * 9
    for node in (0, 1, 2, 3, 4, 6, 7, 8):
        for part in PARTS:
            if rng.random() < 0.85:
                curves[node, part] = curve(part, kinds.pop(), rng, keys=rng.integers(1, 7))
    curves[0, "scale"] = curve("scale", "linear", rng, keys=3)
    curves[2, "rotation"] = curve("rotation", "cubicspline", rng, keys=4)
    channels = [
        (node, part, c.interpolation.upper(), c.times, c.values.reshape(-1, WIDTHS[part]))
        for (node, part), c in curves.items()
    ]
    animate(file, "wild", channels)
    return file, joints, bind, v, curves


def posed_at(file, joints, bind, v, curves, weights, value, t):
    """The vertices at a time, node by node and joint by joint."""
    given = {}
    for (node, part), c in curves.items():
        given.setdefault(node, {})[part] = value(c, part, t)
    G = worlds(file.root, given)
    U = np.zeros((len(v), 3))
    for j, joint in enumerate(joints):
        U += weights[:, j, None] * (np.column_stack([v, np.ones(len(v))]) @ (G[joint] @ bind[j]).T)[:, :3]
    return U


def places(bundle, B):
    """The vertices of a bundle in poses (t, b, 4, 4)."""
    W = bundle.influences.dense(len(bundle.mesh.V), len(bundle.skeleton.names), "")
    return np.array([linear_blend_skinning(bundle.mesh.V, W, pose) for pose in B])


def size_of(bundle):
    return np.ptp(bundle.mesh.V, axis=0).max()


def test_poses_at_a_thousand_times_are_those_of_the_specification(tmp_path, curve_value, rng):
    file, joints, bind, v, curves = moving(rng)
    parts = file.read(tmp_path)
    (clip,) = parts.clips
    assert {c.interpolation for c in curves.values()} == set(KINDS)
    assert min(len(c.times) for c in curves.values()) == 1
    np.testing.assert_array_equal(clip.times, sorted({t for c in curves.values() for t in c.times}))
    W = parts.influences.dense(len(v), len(joints), "")
    times = np.concatenate([rng.uniform(-0.5, 2.5, 1000), clip.times, [-1e9, 1e9]])
    U = places(parts, clip.curves.at(times))
    expected = np.array([posed_at(file, joints, bind, v, curves, W, curve_value, t) for t in times])
    assert np.abs(U - expected).max() < 1e-6 * size_of(parts)
    np.testing.assert_allclose(clip.curves.at(clip.times), clip.B, atol=1e-12)
    # The same by way of a motion, between its frames; and of one with fewer frames.
    motion = motion_of_clips(parts.clips, parts.skeleton)
    np.testing.assert_array_equal(
        motion.at(seconds=times[:1000]), clip.curves.at(np.clip(times[:1000], *clip.times[[0, -1]]))
    )
    few = motion.take(4)
    middles = 0.75 * few.times[:-1] + 0.25 * few.times[1:]
    np.testing.assert_allclose(few.at(frame=np.arange(3) + 0.25), clip.curves.at(middles), atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_written_again_the_curves_are_the_same(tmp_path, rng, offset):
    file, *_ = moving(rng)
    other = {(node, part): curve(part, "linear", rng, keys=2) for node, part in ((1, "rotation"), (4, "scale"))}
    animate(file, "other", [(n, p, "LINEAR", c.times, c.values) for (n, p), c in other.items()])
    if offset:  # from single precision the offset takes digits, but not from nodes at rest
        file.root["nodes"].append({"children": [0], "translation": [offset, 0, -offset]})
        animation = file.root["animations"][0]
        animation["channels"] = [c for c in animation["channels"] if c["target"]["node"] != 0]
    parts = file.read(tmp_path)
    assert write_gltf(tmp_path / "again.glb", parts) == ()
    again = read_gltf(tmp_path / "again.glb")
    assert again.skeleton.names == parts.skeleton.names
    assert again.skeleton.P.tolist() == parts.skeleton.P.tolist()
    np.testing.assert_allclose(again.skeleton.C, parts.skeleton.C, atol=2e-6 * size_of(parts))
    for clip, found in zip(parts.clips, again.clips, strict=True):
        np.testing.assert_array_equal(found.times, clip.times)
        times = rng.uniform(-0.2, 2.2, 100)
        off = places(again, found.curves.at(times)) - places(parts, clip.curves.at(times))
        assert np.abs(off).max() < 5e-6 * size_of(parts)


def test_a_far_root_with_curves_is_written_near_the_origin(tmp_path, rng):
    file = File(skins=[{"joints": [0]}])
    far = np.array([1e5, -2e5, 3e5])
    file.node(name="root", translation=far.tolist())
    mesh = file.mesh({"POSITION": file.accessor(TRIANGLE), "JOINTS_0": file.accessor(np.zeros((3, 4)), "u1"),
                      "WEIGHTS_0": file.accessor(np.tile([1, 0, 0, 0], (3, 1)))}, [0, 1, 2])  # fmt: skip
    file.node(mesh=mesh, skin=0)
    keys = rng.normal(size=(3, 3, 3))
    keys[:, 1] += far
    animate(file, "fly", [(0, "translation", "CUBICSPLINE", [0, 1, 2], keys.reshape(9, 3))])
    parts = file.read(tmp_path)
    write_gltf(tmp_path / "again.glb", parts)
    again = read_gltf(tmp_path / "again.glb")
    times = np.linspace(0, 2, 21)
    off = places(again, again.clips[0].curves.at(times)) - places(parts, parts.clips[0].curves.at(times))
    assert np.abs(off).max() < 1e-6


@pytest.mark.parametrize("slope", [1, 0])
def test_clips_of_different_nodes_are_written_with_frames_in_between(tmp_path, rng, slope):
    file, *_ = moving(rng)
    for node in range(9):  # no shear, which other nodes could not hold
        entry = file.root["nodes"][node]
        entry.pop("scale", None)
        if "matrix" in entry:
            entry["matrix"] = matrix(q=quaternion(rng)).T.ravel().tolist()
    channels = [(0, "translation"), (1, "rotation"), (2, "rotation"), (3, "rotation"), (7, "translation")]
    curves = {key: curve(key[1], "cubicspline", rng, keys=3) for key in channels if slope or key[1] == "translation"}
    for c in curves.values():  # without slopes, half-way is as if it were linear
        c.values[:, [0, 2]] *= slope
        c.times[:] = [0, 1, 2]
    del file.root["animations"]
    animate(
        file, "a", [(n, p, "CUBICSPLINE", c.times, c.values.reshape(-1, WIDTHS[p])) for (n, p), c in curves.items()]
    )
    parts = file.read(tmp_path)
    (clip,) = parts.clips
    baked = replace(clip, name="b", curves=None)
    (note,) = write_gltf(tmp_path / "again.glb", replace(parts, clips=(clip, baked)))
    assert note.startswith("clip 'a' is written with ")
    again = read_gltf(tmp_path / "again.glb")
    times = rng.uniform(*clip.times[[0, -1]], 100)
    off = places(again, again.clips[0].curves.at(times)) - places(parts, clip.curves.at(times))
    assert np.abs(off).max() < 3e-5 * size_of(parts)
    assert len(again.clips[1].times) == len(clip.times)


def test_clips_of_other_nodes_at_rest(tmp_path, rng):
    s = skeleton_of_joints([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [-1, 0, 1], ["a", "b", "c"])
    times = np.arange(4) / 8
    theta = rng.normal(size=(4, 3, 3))
    curves = curves_between(s.C, s.BE, s.P, times, forward_kinematics(s.C, s.BE, s.P, theta))
    still = curves_between(s.C, s.BE, s.P, times[:1], np.tile(np.eye(4), (1, 3, 1, 1)))
    turned = replace(still, rotation=np.array([quaternion(rng) for _ in range(3)]))
    bent = replace(turned, rotation=np.concatenate([still.rotation[:1], turned.rotation[1:]]))
    named = {"a": curves, "b": turned, "c": still, "d": bent}
    clips = {name: Clip(name, s, times, c.at(times), curves=c) for name, c in named.items()}
    back = []
    # The first one's nodes are written; those of b would turn the character at rest.
    for order in ("abc", "bc", "cd", "ca"):
        chosen = tuple(clips[name] for name in order)
        assert write_gltf(tmp_path / "a.glb", Bundle(skeleton=s, clips=chosen)) == ()
        back.append(read_gltf(tmp_path / "a.glb"))
        np.testing.assert_allclose(back[-1].skeleton.C, s.C, atol=1e-6)
        for found, clip in zip(back[-1].clips, chosen, strict=True):
            assert found.times[0] == 0
            np.testing.assert_allclose(found.curves.at(times), clip.B, atol=1e-6)
    np.testing.assert_array_equal(back[0].clips[0].times, times)


def test_the_rest_pose_of_a_bvh_file_stays_when_it_is_written(tmp_path, rng):
    s = skeleton_of_joints([[0, 0, 0], [1, 0, 0]], [-1, 0], ["a", "b"])
    B = forward_kinematics(s.C, s.BE, s.P, rng.normal(size=(3, 2, 3)), root_translation=rng.normal(size=(3, 3)))
    write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(3) / 8, B))
    parts = read_bvh(tmp_path / "a.bvh")
    assert write_gltf(tmp_path / "a.glb", parts) == ()
    again = read_gltf(tmp_path / "a.glb")
    np.testing.assert_allclose(again.skeleton.C, s.C, atol=1e-6)
    times = rng.uniform(0, 0.25, 20)
    np.testing.assert_allclose(again.clips[0].curves.at(times), parts.clips[0].curves.at(times), atol=1e-6)


# A rig in centimetres below an armature of scale 0.01, as Mixamo's are: rest places and turns of six joints, and the
# keys of the first two at 1 s. Matrices in single precision are not quite orthogonal.
MOVES = [
    [0, 0, 100], [-32.47761917114258, 7.4850850105285645, 0.5375004410743713],
    [8.605462074279785, -31.808998107910156, 5.024413585662842],
    [-16.461423873901367, 28.87873077392578, 2.480242967605591],
    [22.337881088256836, -11.04217529296875, 22.140472412109375],
    [-16.38487434387207, -28.154226303100586, -7.07011604309082],
]  # fmt: skip
TURNS = [
    [-0.31134384870529175, 0.6284922361373901, 0.4517654478549957, 0.5513351559638977],
    [0.6454275250434875, 0.6285168528556824, -0.4054364562034607, 0.15495538711547852],
    [0.9142075181007385, 0.37225180864334106, -0.12782877683639526, 0.09650378674268723],
    [0.6731031537055969, 0.542251706123352, -0.22729924321174622, -0.44858691096305847],
    [-0.43297556042671204, -0.13308627903461456, 0.6519343256950378, 0.6081133484840393],
    [0.9655939340591431, -0.09916269034147263, -0.19623784720897675, 0.1388733983039856],
]
THEN = [
    [0.006035896018147469, 0.3184075355529785, 0.7054864764213562, 0.6331421732902527],
    [0.7808603048324585, 0.4492964446544647, -0.3544958531856537, 0.25044476985931396],
]


def test_joints_of_a_rig_in_single_precision_stay_together(tmp_path):
    file = File()
    file.node(name="Armature", scale=[0.01] * 3, rotation=[-np.sqrt(0.5), 0, 0, np.sqrt(0.5)], children=[1])
    for k, (move, turn) in enumerate(zip(MOVES, TURNS, strict=True)):
        below = {"children": [k + 2]} if k < 5 else {}
        file.node(name=f"j{k}", translation=move, rotation=turn, **below)
    bind = [np.linalg.inv(G) for G in list(worlds(file.root).values())[1:]]
    file.root["nodes"][2]["scale"] = [1.0000019073486328] * 3
    matrices = file.accessor(np.swapaxes(bind, 1, 2))
    file.root["skins"] = [{"joints": list(range(1, 7)), "inverseBindMatrices": matrices}]
    v = np.array([[-0.25, 3, 0.25], [0.25, 3, -0.25], [-0.25, 3, -0.25]])
    attributes = {"POSITION": file.accessor(v), "JOINTS_0": file.accessor([[5, 0, 0, 0]] * 3, "u1")}
    attributes["WEIGHTS_0"] = file.accessor([[1, 0, 0, 0]] * 3)
    file.node(mesh=file.mesh(attributes, [0, 1, 2]), skin=0)
    animate(file, "bend", [(k + 1, "rotation", "LINEAR", [0, 1], [TURNS[k], THEN[k]]) for k in (0, 1)])
    parts = file.read(tmp_path)
    s = parts.skeleton
    motion = motion_of_clips(parts.clips, s)
    R = motion.B[..., :3, :3]
    assert 1e-6 < np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < 1e-5
    half = places(parts, motion.at(seconds=[0.5]))[0, 0]
    np.testing.assert_allclose(half, [-0.593, 2.396, 1.318], atol=6e-4)
    times = np.linspace(0, 1, 50)
    joint = np.column_stack([s.C[s.BE[1:, 0]], np.ones(5)])[..., None]
    for found in (motion, replace(motion, curves=())):  # where there are only frames, too
        B = found.at(seconds=times)
        apart = (B[:, 1:] - B[:, s.P[1:]]) @ joint
        assert np.abs(apart).max() < 1e-5
    np.testing.assert_allclose(replace(motion, curves=()).at(seconds=times), motion.at(seconds=times), atol=1e-5)


def test_a_scaled_bone_turns_about_its_own_joint(tmp_path):
    file = File()
    for node, y in enumerate((3, 0.7, 0.7)):
        file.node(translation=[0, y, 0], **({"children": [node + 1]} if node < 2 else {}))
    bind = np.tile(np.eye(4), (3, 1, 1))
    bind[:, 1, 3] = [-3, -3.7, -4.4]
    file.root["skins"] = [{"joints": [0, 1, 2], "inverseBindMatrices": file.accessor(np.swapaxes(bind, 1, 2))}]
    v = np.array([[-0.25, 5, 0.25], [0.25, 5, 0.25], [0.25, 5, -0.25]])
    attributes = {"POSITION": file.accessor(v), "JOINTS_0": file.accessor([[2, 0, 0, 0]] * 3, "u1")}
    attributes["WEIGHTS_0"] = file.accessor([[1, 0, 0, 0]] * 3)
    file.node(mesh=file.mesh(attributes, [0, 1, 2]), skin=0)
    quarter = [[0, 0, 0, 1], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]]
    animate(
        file, "bend", [(1, "rotation", "LINEAR", [0, 1], quarter), (1, "scale", "LINEAR", [0, 1], [[1] * 3, [1.5] * 3])]
    )
    parts = file.read(tmp_path)
    motion = motion_of_clips(parts.clips, parts.skeleton)
    for found in (motion, replace(motion, curves=())):
        U = places(parts, found.at(seconds=[0.5]))[0]
        np.testing.assert_allclose(U[0], [-0.3125, 4.628, 1.370], atol=6e-4)
        y, z = 1.25 * np.sqrt(0.5) * np.array([1.3 - 0.25, 1.3 + 0.25])  # 45 degrees about x, at 3.7
        np.testing.assert_allclose(U[0], [-0.3125, 3.7 + y, z], atol=1e-6)


@pytest.mark.parametrize("name", ["fox", "snake", "spider", "dragon"])
def test_all_clips_of_creatures_read_and_written_again(data, tmp_path, rng, name):
    parts = load_bundle([data / "creatures" / f"{name}.glb"])
    (written,) = write_bundle(parts, [tmp_path / "again.glb"])
    assert written.notes == ()
    again = load_bundle([tmp_path / "again.glb"])
    assert [clip.name for clip in again.clips] == [clip.name for clip in parts.clips]
    for clip, found in zip(parts.clips, again.clips, strict=True):
        np.testing.assert_array_equal(found.times, clip.times)
        times = rng.uniform(clip.times[0] - 0.1, clip.times[-1] + 0.1, 50)
        off = places(again, found.curves.at(times)) - places(parts, clip.curves.at(times))
        assert np.abs(off).max() < 1e-5 * size_of(parts)
    motion = motion_of_clips(parts.clips, parts.skeleton)
    for seconds in (0, 1 / 24):
        assert np.abs(motion.at(seconds=seconds) - motion[0]).max() < 0.01
