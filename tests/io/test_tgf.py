import numpy as np
import pytest

from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.skeleton import Skeleton
from nilbs.io import FileFormatError, read_tgf, write_tgf
from nilbs.io.tgf import write_tgf_skeleton


@pytest.fixture
def tgf(tmp_path):
    def read(text):
        path = tmp_path / "a.tgf"
        path.write_bytes(text.encode())
        return read_tgf(path)

    return read


@pytest.mark.parametrize("d", [2, 3])
def test_round_trip_is_exact(tmp_path, rng, d):
    C = rng.normal(size=(6, d)) * 10.0 ** rng.integers(-300, 300, size=(6, d))
    BE = np.array([[0, 1], [1, 2], [1, 4], [5, 3]])
    write_tgf(tmp_path / "a.tgf", C, BE)
    C_read, BE_read = read_tgf(tmp_path / "a.tgf")
    assert np.array_equal(C_read[:, :d], C)
    assert not C_read[:, d:].any()
    assert np.array_equal(BE_read, BE)


def test_joints_are_found_by_their_index_and_other_columns_are_left_out(tgf):
    C, BE = tgf("7 1 2 3 nan 3.9e-323 x\r\n\r\n3 4 5 6\r\n#\r\n3 7 0\r\n# the rest\r\n1\r\n#\r\n9 9\r\n")
    assert C.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert BE.tolist() == [[1, 0]]


TWO = "1 0 0 0\n2 1 0 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TWO + "#\n#\n", ": the rig has no bone"),
        (TWO, ": the rig has no bone"),
        ("#\n", ": the rig has no bone"),
        ("1 0 0\n", ":1: a joint needs an index and three coordinates"),
        ("x 0 0 0\n", ":1: a joint needs an index"),
        ("-1 0 0 0\n", ":1: a joint needs an index"),
        ("1 0 0 nan\n", ":1: 'nan' is not a finite number"),
        (TWO + "3 0 1e999 0\n", ":3: '1e999' is not a finite number"),
        (TWO + "3 0 1_0 0\n", ":3: '1_0' is not a finite number"),
        (TWO + "1 0 0 1\n", ":3: a second joint 1"),
        (TWO + "#\n1 3\n", ":4: the bone refers to joint 3, which the file does not have"),
        (TWO + "#\n1\n", ":4: a bone needs the indices of two joints"),
        (TWO + "#\n1 -2\n", ":4: a bone needs"),
        (TWO + "#\n2 2\n", ":4: bones run in a circle"),
        (TWO + "#\n1 2\n2 1\n", ":4: bones run in a circle"),
        (TWO + "3 1 1 0\n4 2 2 2\n#\n1 2\n2 3\n3 1\n3 4\n", ":7: bones run in a circle"),
        (TWO + "3 1 1 0\n#\n1 3\n\n2 3\n", ":7: joint 3 is the end of two bones, here and in line 5"),
        (TWO + "#\n1 \0\n", ":4: binary data"),
    ],
)
def test_errors_name_file_and_line(tgf, text, message):
    with pytest.raises(FileFormatError) as caught:
        tgf(text)
    assert f"a.tgf{message}" in str(caught.value)


def test_bones_without_length_are_bones(tgf):
    C, BE = tgf(TWO + "3 1 0 0\n4 1 0 0\n#\n1 2\n2 3\n3 4\n")
    assert C[1:].tolist() == [[1, 0, 0]] * 3
    assert BE.tolist() == [[0, 1], [1, 2], [2, 3]]


# Name: bones, parents, and those whose parent the file cannot hold.
SKELETONS = {
    "as the file has it": ([[0, 1], [1, 2], [1, 3], [4, 5]], [-1, 0, 0, -1], []),
    "child first": ([[1, 2], [0, 1]], [1, -1], []),
    "without length": ([[0, 1], [1, 1], [1, 2]], [-1, 0, 0], []),
    "two end at one joint": ([[0, 1], [2, 1], [1, 3]], [-1, -1, 1], []),
    "joints in a circle": ([[0, 1], [1, 0]], [-1, 0], []),
    "roots where others end": ([[0, 1], [1, 2]], [-1, -1], []),
    "apart": ([[0, 1], [2, 3], [3, 4], [0, 5]], [-1, 0, 1, 1], [1, 3]),
    "one place, two joints": ([[0, 1], [6, 2]], [-1, 0], []),
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("form", SKELETONS)
def test_skeletons_whose_joints_are_not_shared(tmp_path, rng, form, d):
    BE, P, lost = SKELETONS[form]
    C = rng.normal(size=(7, d))
    C[6] = C[1]
    s = Skeleton(C, BE, P, [f"bone{bone}" for bone in range(len(BE))])
    notes = write_tgf_skeleton(tmp_path / "a.tgf", s)
    C_read, BE_read = read_tgf(tmp_path / "a.tgf")
    assert np.array_equal(C_read[BE_read][..., :d], C[s.BE])
    assert bone_parents(BE_read).tolist() == [-1 if bone in lost else parent for bone, parent in enumerate(P)]
    assert len(notes) == bool(lost)
    assert all(f"'bone{bone}'" in notes[0] for bone in lost)
    if form in ("as the file has it", "child first"):
        assert np.array_equal(BE_read, BE)
        assert np.array_equal(C_read[:, :d], C)


def test_names_are_not_held(tmp_path):
    (note,) = write_tgf_skeleton(tmp_path / "a.tgf", Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ["arm"]))
    assert "no names" in note


def test_a_long_chain_is_read(tgf):
    n = 20_000
    joints = "".join(f"{i} {i} 0 0\n" for i in range(n))
    bones = "".join(f"{i} {i + 1}\n" for i in reversed(range(n - 1)))
    C, BE = tgf(joints + "#\n" + bones)
    assert (len(C), len(BE)) == (n, n - 1)


def test_write_tgf_checks_its_arguments(tmp_path):
    with pytest.raises(ValueError, match="BE"):
        write_tgf(tmp_path / "a.tgf", np.eye(3), [[0, 3]])


@pytest.mark.parametrize(("name", "joints"), [("arm", 5), ("elephant", 25)])
def test_real_rigs(data, name, joints):
    C, BE = read_tgf(data / name / f"{name}.tgf")
    assert C.shape == (joints, 3)
    assert len(BE) == joints - 1
