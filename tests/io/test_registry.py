"""The kind of a file follows from its suffix, and from its content if several kinds have the suffix."""

import json

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_bundle, write_mesh, write_tgf, write_transforms, write_weights
from nilbs.io.registry import READABLE, WRITABLE


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_row_sums_separate_weights_from_motions(tmp_path, suffix):
    # 24 rows could be a motion of two bones.
    path, W = tmp_path / f"a{suffix}", np.full((24, 3), 0.5)
    W[:, 2] = 0
    write_weights(path, W)
    bundle = read_bundle(path)
    assert bundle.motion is bundle.mesh is bundle.skeleton is None
    assert bundle.influences.shape == (24, 3)
    assert (bundle.influences.dense(24, 3, path) == W).all()


def test_transforms_are_a_motion(tmp_path):
    B = np.tile(np.eye(4), (5, 2, 1, 1))
    write_transforms(tmp_path / "a.dmat", B)
    bundle = read_bundle(tmp_path / "a.dmat")
    assert bundle.influences is None
    assert (bundle.motion == B).all()


def test_motions_by_name(tmp_path):
    (tmp_path / "a.JSON").write_text('{"frames": [{"hip": [0, 0, 90]}, {}]}')
    motion = read_bundle(tmp_path / "a.JSON").motion
    assert (motion.names, motion.theta.shape) == (("hip",), (2, 1, 3))


def test_weights_by_name_need_the_names(tmp_path):
    (tmp_path / "a.mhw").write_text(json.dumps({"weights": {"high": [[4, 1]]}}))
    influences = read_bundle(tmp_path / "a.mhw", names=("low", "high")).influences
    assert (influences.vertex, influences.bone, influences.shape) == (4, 1, None)
    with pytest.raises(FileFormatError, match=r"a\.mhw: its weights are of bones by name"):
        read_bundle(tmp_path / "a.mhw")


@pytest.mark.parametrize("data", [b"PK\x05\x06 and no archive", b"\x00"])
def test_a_file_that_is_no_archive_is_named(tmp_path, data):
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"a\.npz: damaged \.npz file"):
        read_bundle(path)


def test_an_empty_archive_is_named(tmp_path):
    (tmp_path / "a.npz").touch()
    with pytest.raises(FileFormatError, match="the file is empty"):
        read_bundle(tmp_path / "a.npz")


def test_a_mesh(tmp_path):
    write_mesh(tmp_path / "a.obj", [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    parts = read_bundle(tmp_path / "a.obj")
    assert parts.mesh.V.shape == (3, 2)
    assert parts.mesh.E.tolist() == [[0, 1, 2]]
    assert parts.skeleton is None


def test_a_rig_of_libigl_has_parents_and_names(tmp_path):
    write_tgf(tmp_path / "a.tgf", [[0, 0], [1, 0], [2, 1]], [[1, 2], [0, 1]])
    skeleton = read_bundle(tmp_path / "a.tgf").skeleton
    assert skeleton.P.tolist() == [1, -1]
    assert skeleton.names == ("bone0", "bone1")


def test_joints_that_are_means_of_vertices_need_the_mesh(tmp_path):
    with pytest.raises(FileFormatError, match="give the mesh file too"):
        read_bundle(tmp_path / "a.mhskel")


def test_the_error_of_an_unknown_suffix_lists_the_others():
    with pytest.raises(FileFormatError, match=r"must end in \.obj or .*\.glb"):
        read_bundle("a.docx")


def test_every_suffix_that_is_written_can_be_read():
    assert set(WRITABLE) <= set(READABLE)


def test_fbx_goes_to_its_reader(tmp_path):
    (tmp_path / "a.fbx").write_text("no fbx")
    with pytest.raises(FileFormatError, match=r"a\.fbx: .*FBX"):
        read_bundle(tmp_path / "a.fbx")


def test_a_body_model_goes_to_its_reader(tmp_path):
    np.savez(tmp_path / "body.npz", v_template=np.eye(3))
    with pytest.raises(FileFormatError, match=r"body\.npz: .*(weights|kintree_table|J_regressor|f\b)"):
        read_bundle(tmp_path / "body.npz")
