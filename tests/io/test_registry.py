"""The suffix of a file, and its content where the suffix leaves that open, decide what it holds."""

import numpy as np
import pytest

from nilbs.io import FileFormatError, read_bundle, write_mesh, write_tgf, write_transforms, write_weights
from nilbs.io.registry import READABLE, WRITABLE, kind_of


@pytest.mark.parametrize("suffix", [".dmat", ".npz"])
def test_row_sums_separate_weights_from_motions(tmp_path, suffix):
    # 24 rows are a motion of two bones, unless the numbers look like weights.
    path = tmp_path / f"a{suffix}"
    write_weights(path, np.full((24, 2), 0.5))
    assert kind_of(path) == "weights"
    with pytest.raises(FileFormatError, match="holds weights of vertices and no mesh or rig"):
        read_bundle(path)


def test_transforms_are_a_motion(tmp_path):
    write_transforms(tmp_path / "a.dmat", np.tile(np.eye(4), (5, 2, 1, 1)))
    assert kind_of(tmp_path / "a.dmat") == "motion"
    with pytest.raises(FileFormatError, match="holds a motion of bones"):
        read_bundle(tmp_path / "a.dmat")


def test_an_archive_with_a_template_is_a_body_model(tmp_path):
    np.savez(tmp_path / "body.npz", v_template=np.zeros((1, 3)))
    assert kind_of(tmp_path / "body.npz") == "parts"


@pytest.mark.parametrize("data", [b"PK\x05\x06 and no archive", b"\x00"])
def test_what_is_no_archive_is_named(tmp_path, data):
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"a\.npz: damaged \.npz file"):
        kind_of(path)


def test_an_empty_archive_is_named(tmp_path):
    (tmp_path / "a.npz").touch()
    with pytest.raises(FileFormatError, match="the file is empty"):
        kind_of(tmp_path / "a.npz")


@pytest.mark.parametrize(("name", "kind"), [("a.mhw", "weights"), ("a.JSON", "motion"), ("a.bvh", "parts")])
def test_a_suffix_decides_without_a_file(name, kind):
    assert kind_of(name) == kind


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


def test_an_unknown_suffix_names_those_known():
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
