"""Motions of bodies of the SMPL family."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.characters.bundle import load_bundle
from nilbs.characters.motion import load_motion
from nilbs.geometry.rotations import rotation_matrices, transform_points
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io import FileFormatError, read_bundle
from nilbs.io.amass import read_amass
from nilbs.io.registry import needs_rig
from nilbs.io.smpl import JOINTS, joint_parents

SIZES = [22, 24, 52, 55]


def motion(rng, k=24, t=4, **changed):
    arrays = {
        "poses": rng.normal(size=(t, 3 * k)),
        "trans": rng.normal(size=(t, 3)),
        "mocap_framerate": np.array(120.0),
        "gender": np.array("female"),
        "betas": rng.normal(size=16),
        "dmpls": rng.normal(size=(t, 8)),
    } | changed
    return {name: value for name, value in arrays.items() if value is not None}


@pytest.fixture
def save(tmp_path):
    def write(arrays, name="walk.npz"):
        path = tmp_path / name
        path.unlink(missing_ok=True)
        np.savez(path, **arrays)
        return path

    return write


def body(rng, k):
    """A body model with its joints at random places."""
    J = rng.normal(size=(k, 3))
    tree = np.array([joint_parents(k), range(k)]).astype(np.uint32)
    V, W = rng.normal(size=(60, 3)), rng.dirichlet(np.ones(k), 60)
    return {"v_template": V, "f": rng.integers(0, 60, (90, 3)), "weights": W, "kintree_table": tree, "J": J}


def smpl(V, W, J, parents, pose, trans):
    """Posed vertices by the equations of the SMPL paper, without correctives: G_k = G_parent [R_k, J_k - J_parent]."""
    G = []
    for k, parent in enumerate(parents):
        local = np.eye(4)
        local[:3, :3] = rotation_matrices(pose[3 * k : 3 * k + 3])
        local[:3, 3] = J[k] - (J[parent] if parent >= 0 else 0)
        G.append(local if parent < 0 else G[parent] @ local)
    moved = [M[:3, :3] @ (V - joint).T + M[:3, 3:] for M, joint in zip(G, J, strict=True)]
    return np.einsum("nk,kcn->nc", W, moved) + trans


@pytest.mark.parametrize("k", SIZES[1:])
def test_a_body_moves_as_its_model_has_it(save, rng, k):
    model, moves = body(rng, k), motion(rng, k)
    bundle = load_bundle([save(moves), save(model, "body.npz")])  # in any order
    (clip,) = bundle.clips
    assert bundle.skeleton.names == JOINTS[k]
    assert clip.skeleton is bundle.skeleton
    assert np.array_equal(clip.times, np.arange(4) / 120)
    V, W = bundle.mesh.V, bundle.influences.dense(60, k, "")
    for pose, trans, B in zip(moves["poses"], moves["trans"], clip.B, strict=True):
        U = smpl(V, W, model["J"], joint_parents(k), pose, trans)
        np.testing.assert_allclose(linear_blend_skinning(V, W, B), U, atol=1e-9)
    assert np.array_equal(load_motion(save(moves), bundle.skeleton).B, clip.B)


def test_joints_that_one_of_the_two_lacks(save, rng):
    model, moves = save(body(rng, 24), "body.npz"), motion(rng, 52)
    lines: list[str] = []
    bundle = load_bundle([save(moves), model], report=lines.append)
    assert any("30 of 52 joints are none of the rig's" in line for line in lines)
    (clip,) = bundle.clips
    body_alone = {**moves, "poses": moves["poses"][:, :66]}
    assert np.array_equal(load_motion(save(body_alone), bundle.skeleton).B, clip.B)
    assert np.abs(clip.B[:, 22] - clip.B[:, 20]).max() < 1e-12  # the hand stays at the wrist


@pytest.mark.parametrize("k", SIZES)
def test_without_a_body_a_mean_person_moves(save, rng, k):
    moves = motion(rng, k)
    parts = read_bundle(save(moves))
    (clip,) = parts.clips
    s = parts.skeleton
    assert s.names == JOINTS[k]
    assert s.P.tolist() == joint_parents(k)
    assert parts.is_motion
    assert clip.name == "walk"
    assert 1.4 < np.ptp(s.C[:, 1]) < 1.7
    left = [name for name in s.names if name.startswith("left")]
    at = {name: s.C[s.BE[bone, 0]] for bone, name in enumerate(s.names)}
    assert all((at[name] == at[name.replace("left", "right")] * [-1, 1, 1]).all() for name in left)
    assert all(at[name][0] > 0 for name in left)
    root = transform_points(clip.B[:, 0], np.tile(s.C[0], (4, 1)))
    np.testing.assert_allclose(root, s.C[0] + moves["trans"], atol=1e-12)
    assert parts.notes == ("betas and dmpls, the shape of the recorded person, are left out",)


def test_another_rig_follows_by_the_names_of_its_bones(save, rng, tmp_path):
    s = read_bundle(save(motion(rng, 22))).skeleton
    words = {
        "pelvis": "Hips",
        "spine1": "Spine",
        "spine2": "Spine1",
        "spine3": "Spine2",
        "neck": "Neck",
        "head": "Head",
    }
    limbs = {"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder"}
    limbs |= {"shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand"}
    for side in ("left", "right"):
        words |= {f"{side}_{joint}": f"mixamorig:{side.title()}{name}" for joint, name in limbs.items()}
    rig = skeleton_of_joints(s.C[s.BE[:, 0]] * 100, s.P, [words[name] for name in s.names])
    poses = 0.5 * rng.normal(size=(4, 22, 3))
    followed = load_motion(save(motion(rng, 22, poses=poses.reshape(4, -1))), rig)
    exact = read_bundle(tmp_path / "walk.npz").clips[0].B
    np.testing.assert_allclose(followed.B[..., :3, :3], exact[..., :3, :3], atol=1e-9)


@pytest.mark.parametrize(
    ("changed", "note", "seconds"),
    [
        ({"mocap_framerate": None, "mocap_frame_rate": np.array([60])}, None, 1 / 60),
        ({"mocap_framerate": np.float32(25)}, None, 1 / 25),
        ({"mocap_framerate": None}, "it holds no frame rate: 30 frames a second are assumed", 1 / 30),
        ({"trans": None}, "it holds no trans: the body stays in its place", 1 / 120),
        ({"poses": np.zeros((3, 22, 3)), "trans": np.zeros((3, 3))}, None, 1 / 120),
        ({"gender": np.array(None, dtype=object), "labels": np.array([print], dtype=object)}, None, 1 / 120),
    ],
)
def test_what_files_differ_in(save, rng, changed, note, seconds):
    parts = read_amass(save(motion(rng, **changed)))
    assert parts.clips[0].times[1] == seconds
    assert note is None or note in parts.notes


def test_a_body_in_another_tree_is_retargeted_to(save, rng):
    path = save(motion(rng, 22))
    s = read_amass(path).skeleton
    assert read_amass(path, rig=s).skeleton is s
    other = skeleton_of_joints(s.C[s.BE[:, 0]], np.where(np.arange(22) == 5, 4, s.P), s.names)
    assert read_amass(path, rig=other).skeleton is not other
    assert needs_rig(path)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"poses": np.zeros((4, 70))},
            "poses must be a row of 66, 72, 156, 165 numbers a frame, this file holds (4, 70)",
        ),
        ({"poses": np.zeros((4, 63))}, "poses must be a row of 66, 72, 156, 165 numbers a frame"),
        ({"poses": np.zeros(72)}, "poses must be a row"),
        ({"poses": np.zeros((0, 72))}, "poses must be a row"),
        ({"poses": np.zeros((4, 24, 4))}, "poses must be a row"),
        ({"poses": np.zeros((4, 24, 3, 3))}, "poses must be a row"),
        ({"poses": np.full((4, 72), np.nan)}, "poses holds a number that is not finite"),
        ({"poses": np.array([[print] * 72], dtype=object)}, "poses is not a plain array of numbers but a pickle"),
        ({"poses": np.zeros((2**18, 66), dtype=np.int8)}, "262144 frames of 22 joints are too many"),
        ({"trans": np.zeros((3, 3))}, "trans must be (4, 3), this file holds (3, 3)"),
        ({"poses": np.full((4, 72), 1e308)}, "the body turns or moves farther than numbers go"),
        ({"mocap_framerate": np.array(0.0)}, "mocap_framerate must be above zero, this file holds 0"),
        ({"mocap_framerate": np.array([1.0, 2.0])}, "mocap_framerate must be one number, this file holds (2,)"),
        ({"mocap_framerate": np.array("120")}, "mocap_framerate is not a plain array of numbers"),
    ],
)
def test_wrong_motions(save, rng, changed, message):
    with pytest.raises(FileFormatError) as caught:
        read_amass(save(motion(rng, **changed)))
    assert f"walk.npz: {message}" in str(caught.value)


def test_weights_in_an_archive_are_no_motion(save, rng):
    with pytest.raises(FileFormatError, match=r"w\.npz: the file holds no motion"):
        load_motion(save({"W": rng.random((3, 22))}, "w.npz"), read_amass(save(motion(rng, 22))).skeleton)


def test_a_motion_is_the_rig_only_where_there_is_no_other(save, rng):
    model, moves = save(body(rng, 24), "body.npz"), save(motion(rng, 24))
    bundle = load_bundle([moves, model])
    assert bundle.taken == {str(moves): ["motion"], str(model): ["mesh", "rig", "weights"]}
    assert load_bundle([moves]).taken == {str(moves): ["rig", "motion"]}


@given(data=st.data())
def test_a_damaged_file_is_read_or_refused(save, data):
    path = save(motion(np.random.default_rng(0), 22, 2))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.sampled_from([0, 1, 8, 500]))] = data.draw(st.binary(max_size=8))
    path.unlink()
    path.write_bytes(content)
    message = None
    try:
        parts = read_amass(path)
    except FileFormatError as error:
        message = str(error)
    assert ("walk.npz: " in message) if message else np.isfinite(parts.clips[0].B).all()
