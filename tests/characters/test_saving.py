"""Characters that are written and read again pose as before, whatever the format."""

import os
from dataclasses import replace

import numpy as np
import pytest

from nilbs.characters.bundle import load_bundle
from nilbs.characters.gingerbread import gingerbread
from nilbs.characters.motion import Motion, clips_of, load_motion, motion_of_clips, random_motion
from nilbs.characters.saving import save_character, write_bundle
from nilbs.geometry.kinematics import forward_kinematics, smooth_random_rotations
from nilbs.geometry.plane import in_space
from nilbs.geometry.skeleton import Skeleton, skeleton_of_bones, skeleton_of_joints
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io import FileFormatError, read_bundle, read_dmat, read_mesh, read_transforms, read_weights
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh

CLOSE = 1e-5  # of the size


def tree(rng):
    """Joints with forks, an end of its own, and a second root."""
    positions = rng.uniform(-1, 1, size=(7, 3))
    names = ["hip", "spine", "left leg", "right leg", "head", "prop", "handle"]
    return skeleton_of_joints(positions, [-1, 0, 0, 0, 1, -1, 5], names, ends={4: [0, 0, 2.0], 2: [0.5, 0.5, -2.0]})


def parents_apart(rng):
    """Bones whose parents are given: none ends where its child starts."""
    C = rng.uniform(-1, 1, size=(8, 3))
    return Skeleton(C, [[0, 1], [2, 3], [4, 5], [6, 7]], [-1, 0, 1, 0], ("bone0", "bone1", "bone2", "bone3"))


def chain(rng):
    return Skeleton(rng.uniform(-1, 1, size=(3, 3)), [[1, 2], [0, 1]], [1, -1], ("bone0", "bone1"))


@pytest.fixture(params=[tree, parents_apart, chain])
def parts(request, rng):
    """A mesh, a skeleton, weights and a motion, all random, all different from their rest."""
    skeleton = request.param(rng)
    b = len(skeleton.BE)
    V, E = rng.uniform(-1, 1, size=(30, 3)), rng.permuted(np.tile(np.arange(30), (12, 1)), axis=1)[:, :3]
    W = rng.dirichlet(np.full(b, 0.3), size=30)
    W[:, :] = np.where(W < 0.01, 0, W)
    W /= W.sum(axis=1, keepdims=True)
    B = poses(skeleton, rng)
    clip = Clip("wave", skeleton, np.arange(len(B)) / 25, B)
    return Bundle(Mesh(V, E), skeleton, Influences.of_matrix(W), (clip,))


def weights_of(bundle):
    """The matrix of a bundle's weights."""
    return bundle.influences.dense(*bundle.influences.shape, "a bundle")


def poses(skeleton, rng, frames=5):
    d = skeleton.d
    theta = smooth_random_rotations(skeleton.P, d, frames, amplitude=0.5, rng=rng)
    return forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta, root_translation=rng.normal(size=(frames, d)))


def posed(V, W, B):
    return np.array([linear_blend_skinning(V if B.shape[-1] == 3 else in_space(V), W, pose) for pose in B])


def assert_same_places(U, U_read, V):
    assert U.shape == U_read.shape
    assert np.abs(U - U_read).max() <= CLOSE * np.ptp(V, axis=0).max()


@pytest.mark.parametrize("name", ["a.glb", "a.GLTF"])
def test_gltf(parts, tmp_path, name):
    (written,) = write_bundle(parts, [tmp_path / name])
    assert list(read_bundle(tmp_path / name).mesh.groups) == ["a"]
    assert written.holds == ("mesh", "rig", "weights", "motion")
    rigged = load_bundle([tmp_path / name])
    skeleton, (clip,) = parts.skeleton, parts.clips
    assert rigged.skeleton.names == skeleton.names
    assert rigged.skeleton.P.tolist() == skeleton.P.tolist()
    assert np.abs(rigged.skeleton.C[rigged.skeleton.BE] - skeleton.C[skeleton.BE]).max() <= 1e-6
    assert np.abs(rigged.clips[0].times - clip.times).max() <= 1e-6
    assert rigged.clips[0].name == "wave"
    expected = posed(parts.mesh.V, weights_of(parts), clip.B)
    assert_same_places(expected, posed(rigged.mesh.V, weights_of(rigged), rigged.clips[0].B), parts.mesh.V)


def test_obj_and_rignet(parts, tmp_path, rng):
    written = write_bundle(parts, [tmp_path / "a.obj", tmp_path / "a_rig.txt"])
    assert [file.holds for file in written] == [("mesh",), ("rig", "weights")]
    rigged = load_bundle([tmp_path / "a.obj", tmp_path / "a_rig.txt"])
    skeleton, B = parts.skeleton, parts.clips[0].B
    assert rigged.skeleton.P.tolist() == skeleton.P.tolist()
    assert (rigged.skeleton.C[rigged.skeleton.BE] == skeleton.C[skeleton.BE]).all()
    assert (rigged.mesh.V == parts.mesh.V).all()
    assert_same_places(
        posed(parts.mesh.V, weights_of(parts), B), posed(rigged.mesh.V, weights_of(rigged), B), rigged.mesh.V
    )


def test_bvh(parts, tmp_path):
    write_bundle(parts, [tmp_path / "a.bvh"])
    (clip,) = read_bundle(tmp_path / "a.bvh").clips
    skeleton = parts.skeleton
    # The file lists joints below one another, in an order of its own.
    order = [clip.skeleton.names.index(name) for name in skeleton.names]
    above = {name: -1 if p < 0 else skeleton.names[p] for name, p in zip(skeleton.names, skeleton.P, strict=True)}
    names = clip.skeleton.names
    assert above == {name: -1 if p < 0 else names[p] for name, p in zip(names, clip.skeleton.P, strict=True)}
    assert np.abs(clip.times - parts.clips[0].times).max() <= 1e-6
    V, W = parts.mesh.V, weights_of(parts)
    assert_same_places(posed(V, W, parts.clips[0].B), posed(V, W, clip.B[:, order]), V)


def test_a_rig_alone_is_a_bvh_at_rest(parts, tmp_path):
    (written,) = write_bundle(Bundle(skeleton=parts.skeleton), [tmp_path / "a.bvh"])
    assert written.holds == ("rig",)
    (clip,) = read_bundle(tmp_path / "a.bvh").clips
    assert np.abs(clip.B - np.eye(4)).max() <= 1e-9
    assert len(clip.B) == 1


def test_tgf_and_dmat(parts, tmp_path):
    names = ("a.ply", "a.tgf", "a-weights.dmat", "a-motion.dmat")
    written = write_bundle(parts, [tmp_path / name for name in names])
    assert [file.holds for file in written] == [("mesh",), ("rig",), ("weights",), ("motion",)]
    rigged = load_bundle([tmp_path / name for name in names[:3]])
    skeleton, B = parts.skeleton, read_transforms(tmp_path / "a-motion.dmat")
    assert (rigged.skeleton.C[rigged.skeleton.BE] == skeleton.C[skeleton.BE]).all()
    assert_same_places(
        posed(rigged.mesh.V, weights_of(parts), parts.clips[0].B),
        posed(rigged.mesh.V, weights_of(rigged), B),
        rigged.mesh.V,
    )


@pytest.mark.parametrize(("kind", "roots"), [(tree, [0, 2, 3, 5]), (chain, [1]), (parents_apart, [0, 1, 2, 3])])
def test_tgf_keeps_the_parents_that_end_where_children_start(kind, roots, rng, tmp_path):
    skeleton = kind(rng)
    (written,) = write_bundle(Bundle(skeleton=skeleton), [tmp_path / "a.tgf"])
    P = read_bundle(tmp_path / "a.tgf").skeleton.P
    assert np.flatnonzero(P < 0).tolist() == roots
    assert (P[P >= 0] == skeleton.P[P >= 0]).all()
    lost = len(roots) - int((skeleton.P < 0).sum())
    assert any("read as roots" in note for note in written.notes) == (lost > 0)
    assert any("holds no names" in note for note in written.notes) == (kind is tree)


def test_tgf_keeps_joints_that_fit_as_they_are(tmp_path):
    _, _, C, BE = gingerbread(2)
    skeleton = skeleton_of_bones(C, BE)
    write_bundle(Bundle(skeleton=skeleton), [tmp_path / "a.tgf"])
    read = read_bundle(tmp_path / "a.tgf").skeleton
    assert (in_space(np.asarray(C)) == read.C).all()
    assert (read.BE == BE).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("names", [("a.glb",), ("a.obj", "a.txt"), ("a.ply", "a.tgf", "a.npz")])
def test_a_character_poses_as_before(characters, d, names, tmp_path, rng):
    c = characters[d]
    save_character(c, *(tmp_path / name for name in names))
    rigged = load_bundle([tmp_path / name for name in names])
    assert rigged.mesh.V.shape[1] == d
    V, W = (c.V_volume, c.W_volume) if d == 2 else (c.V, c.W)
    B = poses(c.skeleton, rng)
    assert_same_places(posed(V, W, B), posed(rigged.mesh.V, weights_of(rigged), B), V)
    assert len(rigged.mesh.E) == len(c.T if d == 2 else c.F)


def test_a_motion_goes_with_its_character(characters, tmp_path):
    c = characters[2]
    motion = random_motion(c, frames=4)
    save_character(c, tmp_path / "a.glb", tmp_path / "a.bvh", motion=motion)
    (clip,) = read_bundle(tmp_path / "a.glb").clips
    (bvh,) = read_bundle(tmp_path / "a.bvh").clips
    U = posed(c.V_volume, c.W_volume, motion.B)
    for read in (clip, bvh):
        order = [read.skeleton.names.index(name) for name in c.skeleton.names]
        U_read = posed(c.V_volume, c.W_volume, read.B[:, order])
        assert np.abs(U_read[..., 2]).max() <= 1e-6
        assert_same_places(U, U_read[..., :2], c.V)


def test_several_clips_are_one_after_the_other_in_a_file_of_one_motion(parts, tmp_path):
    clips = tuple(replace(parts.clips[0], name=name) for name in ("walk", "run"))
    names = ("a.bvh", "a-motion.dmat")
    for file in write_bundle(replace(parts, clips=clips), [tmp_path / name for name in names]):
        assert file.notes[0] == (
            "it holds one motion: all 2 were written, one after the other (walk, run); --clip chooses one"
        )
    t = len(clips[0].B)
    (bvh,) = read_bundle(tmp_path / "a.bvh").clips
    assert np.abs(bvh.B[:t] - bvh.B[t:]).max() <= 1e-9
    assert np.ptp(np.diff(bvh.times)) <= 1e-9
    assert read_dmat(tmp_path / "a-motion.dmat").shape[1] == 2 * t
    faster = (clips[0], replace(clips[1], times=clips[1].times / 2))
    with pytest.raises(ValueError, match=r"a\.bvh: .* at a constant rate; or choose one of walk, run"):
        write_bundle(replace(parts, clips=faster), [tmp_path / "a.bvh"])
    other = replace(parts.skeleton, names=tuple(f"{name}2" for name in parts.skeleton.names))
    with pytest.raises(ValueError, match="it holds one skeleton, and 'walk' and 'run' are of different ones"):
        write_bundle(replace(parts, clips=(clips[0], replace(clips[1], skeleton=other))), [tmp_path / "a.bvh"])
    write_bundle(replace(parts, clips=clips), [tmp_path / "a.glb"])
    assert [clip.name for clip in read_bundle(tmp_path / "a.glb").clips] == ["walk", "run"]


def test_the_name_separates_weights_from_a_motion(parts, tmp_path):
    with pytest.raises(ValueError, match=r"call it \.\.\.-weights\.dmat or"):
        write_bundle(parts, [tmp_path / "a.dmat"])
    write_bundle(Bundle(influences=parts.influences), [tmp_path / "a.dmat"])
    assert (read_weights(tmp_path / "a.dmat") == weights_of(parts)).all()
    write_bundle(Bundle(skeleton=parts.skeleton, clips=parts.clips), [tmp_path / "a.dmat"])
    assert read_dmat(tmp_path / "a.dmat").shape == (12 * len(parts.skeleton.BE), 5)
    write_bundle(parts, [tmp_path / "elephant-anim.dmat"])
    assert (read_dmat(tmp_path / "elephant-anim.dmat") == read_dmat(tmp_path / "a.dmat")).all()


@pytest.mark.parametrize(
    ("name", "present", "message"),
    [
        ("a.obj", "skeleton", "there is no mesh to write"),
        ("a.tgf", "mesh", "there is no rig to write"),
        ("a.txt", "mesh", "there is no rig to write"),
        ("a.bvh", "mesh", "there is no rig to write"),
        ("a.npz", "skeleton", "there are no weights to write"),
        ("a-motion.dmat", "skeleton", "there is no motion to write"),
        ("a.glb", "influences", "there is no mesh and no rig to write"),
    ],
)
def test_data_that_a_format_needs_but_lacks(parts, tmp_path, name, present, message):
    with pytest.raises(ValueError, match=rf"{name}: {message}"):
        write_bundle(Bundle(**{present: getattr(parts, present)}), [tmp_path / name])
    assert os.listdir(tmp_path) == []


def test_a_skin_needs_weights(parts, tmp_path):
    with pytest.raises(ValueError, match="there are no weights to write: give their file, or solve for them"):
        write_bundle(replace(parts, influences=None), [tmp_path / "a.glb"])


def test_all_files_are_written_or_none(parts, tmp_path):
    (tmp_path / "a.obj").write_text("before")
    with pytest.raises(ValueError, match="no weights to write"):
        write_bundle(Bundle(parts.mesh), [tmp_path / "a.obj", tmp_path / "a.npz"])
    assert (tmp_path / "a.obj").read_text() == "before"
    assert os.listdir(tmp_path) == ["a.obj"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no device that is always full")
def test_a_full_disk_leaves_the_other_file_alone(parts, tmp_path):
    (tmp_path / "a.ply").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        write_bundle(Bundle(parts.mesh), [tmp_path / "a.obj", tmp_path / "a.ply"])
    assert caught.value.filename == str(tmp_path / "a.ply")
    assert os.listdir(tmp_path) == ["a.ply"]


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("random, amplitude 0.4 rad", None),
        ("walk.BVH", "walk"),
        ("a.b.json", "a.b"),
        ("hero.glb, run", None),
    ],
)
def test_a_motion_is_called_by_its_file_or_by_what_made_it(source, name):
    skeleton = skeleton_of_joints(np.zeros((1, 3)), [-1], ["root"])
    motion = Motion(np.eye(4)[None, None], [0], source, skeleton=skeleton)
    assert clips_of(motion, skeleton)[0].name == (source if name is None else name)


def test_clips_keep_their_names_and_frames(characters, tmp_path):
    c = characters[3]
    walk, run = (
        Clip(name, c.skeleton, np.arange(n) / 10, random_motion(c, frames=n, seed=n).B, "a.glb")
        for name, n in (("walk", 3), ("run", 4))
    )
    save_character(c, tmp_path / "a.glb", motion=motion_of_clips([walk, run], c.skeleton))
    for read, clip in zip(read_bundle(tmp_path / "a.glb").clips, (walk, run), strict=True):
        assert read.name == clip.name
        np.testing.assert_allclose(read.times, clip.times, atol=1e-6)
        np.testing.assert_allclose(read.B, clip.B, atol=1e-5)


def test_paths_are_checked_before_anything_is_written(parts, tmp_path):
    with pytest.raises(FileFormatError, match="must end in"):
        write_bundle(parts, [tmp_path / "a.obj", tmp_path / "a.doc"])
    with pytest.raises(OSError, match="the folder does not exist"):
        write_bundle(parts, [tmp_path / "a.obj", tmp_path / "no" / "a.ply"])
    with pytest.raises(ValueError, match="the same file is named twice"):
        write_bundle(parts, [tmp_path / "a.obj", tmp_path / "." / "a.obj"])
    assert os.listdir(tmp_path) == []


def test_a_mesh_alone(tmp_path):
    write_bundle(Bundle(Mesh(np.eye(3), np.array([[0, 1, 2]]))), [tmp_path / "a.ply", tmp_path / "a.glb"])
    assert read_mesh(tmp_path / "a.ply")[1].tolist() == [[0, 1, 2]]
    assert read_bundle(tmp_path / "a.glb").skeleton is None


@pytest.mark.parametrize("names", [("a.glb",), ("a.obj", "a_rig.txt", "a.bvh"), ("a.ply", "a.tgf", "a.npz", "a.dmat")])
def test_the_elephant_walks_as_before(data, tmp_path, names):
    folder = data / "elephant"
    rigged = load_bundle([folder / f"elephant{end}" for end in (".obj", ".tgf", "-weights.dmat")])
    motion = load_motion(folder / "elephant-anim.dmat", rigged.skeleton).take(20)
    names = [name.replace("a.dmat", "a-motion.dmat") for name in names]
    write_bundle(replace(rigged, clips=clips_of(motion, rigged.skeleton)), [tmp_path / name for name in names])
    files = [tmp_path / name for name in names if not name.endswith((".bvh", "motion.dmat"))]
    read = load_bundle(files)
    again = load_motion(tmp_path / names[-1], read.skeleton)
    U, U_read = (posed(b.mesh.V, weights_of(b), m.B) for b, m in ((rigged, motion), (read, again)))
    assert_same_places(U, U_read, rigged.mesh.V)


def test_makehumans_person_walks_as_before(data, tmp_path):
    folder = data / "makehuman"
    rigged = load_bundle([folder / "base.obj", folder / "default.mhskel"], group="body")
    assert (rigged.mesh.V.shape, weights_of(rigged).shape) == ((13380, 3), (13380, 163))
    motion = load_motion(folder / "walk1.bvh", rigged.skeleton)
    write_bundle(replace(rigged, clips=clips_of(motion, rigged.skeleton)), [tmp_path / "a.glb"])
    read = load_bundle([tmp_path / "a.glb"])
    assert read.skeleton.names == rigged.skeleton.names
    # Between frames the hips do not move in straight lines: there are more frames in the file.
    own, between = np.flatnonzero(np.isin(np.float32(read.clips[0].times), np.float32(motion.times))), slice(None)
    assert len(own) == 14 < len(read.clips[0].B) < 2 * 14
    for frames, B in ((own, motion.B), (between, motion.at(seconds=read.clips[0].times))):
        U, U_read = posed(rigged.mesh.V, weights_of(rigged), B), posed(read.mesh.V, weights_of(read), read.clips[0].B)
        assert_same_places(U, U_read[frames], rigged.mesh.V)
