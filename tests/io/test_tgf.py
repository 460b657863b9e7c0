import numpy as np
import pytest

from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.skeleton import Skeleton, skeleton_of_bones
from nilbs.io import FileFormatError, read_tgf, write_tgf
from nilbs.io.tgf import read_tgf_rig, write_tgf_skeleton


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
        (TWO, ": the rig has no bone"),
        ("#\n", ": the rig has no bone"),
        (TWO + "3 0 0 0\n#\n1 2 1 0 0\n2 3 0 0 1\n", ":6: joints 2 and 3 are a cage edge, along which weights are not"),
        (TWO + "#\n1 2 1 0 1\n", ":4: joints 1 and 2 are a cage edge"),
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
        assert np.array_equal(C_read[:, :d], C[: len(C_read)])  # joints of no bone would be point handles


def test_names_are_not_held(tmp_path):
    (note,) = write_tgf_skeleton(tmp_path / "a.tgf", Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ["arm"]))
    assert "no names" in note


def rig(tmp_path, text):
    (tmp_path / "a.tgf").write_text(text)
    parts = read_tgf_rig(tmp_path / "a.tgf")
    return parts.skeleton, parts.notes


FOUR = "1 0.5 0.7 0\n2 3 0.7 0\n3 5.5 0.7 0\n4 3 1.2 0\n#\n"


def test_joints_of_no_bone_are_point_handles(tmp_path):
    s, notes = rig(tmp_path, FOUR + "1 2\n2 3\n")
    assert s.names == ("point0", "bone0", "bone1")
    assert s.BE.tolist() == [[3, 3], [0, 1], [1, 2]]
    assert s.P.tolist() == [-1, -1, 1]
    assert s.points.tolist() == [0]
    assert notes == ("joints of no bone are point handles, with weights of their own (1): point0 (joint 4)",)
    s, _ = rig(tmp_path, FOUR)
    assert s.BE.tolist() == [[0, 0], [1, 1], [2, 2], [3, 3]]
    assert s.names == ("point0", "point1", "point2", "point3")


def test_flags_tell_bones_from_other_edges(tmp_path):
    pseudo = "pseudo-edges are left out: 1, in line 8 first"
    for flags in ("0 1 0", "0 1"):
        s, notes = rig(tmp_path, FOUR + f"1 2 1 0 0\n2 3 1 0 0\n2 4 {flags}\n")
        assert s.names == ("point0", "bone0", "bone1")
        assert notes[0] == pseudo
    s, notes = rig(tmp_path, FOUR + "1 2 1 0 0\n2 3 1 0 0\n2 4 0 0 0\n")
    assert notes[0] == "edges that are no bones are left out: 1, in line 8 first"
    # A bone that is a pseudo-edge too; a label alone, or words that are no flags.
    s, notes = rig(tmp_path, FOUR + "1 2 0\n2 3 a 1 0\n2 4 1 1 0\n")
    assert s.names == ("bone0", "bone1", "bone2")
    assert notes == (pseudo,)


def test_point_handles_are_written_as_joints(tmp_path, rng):
    C = rng.normal(size=(5, 3))
    BE = np.array([[3, 3], [4, 4], [0, 1], [1, 2]])
    write_tgf(tmp_path / "a.tgf", C, BE)
    assert np.array_equal(read_tgf(tmp_path / "a.tgf")[1], BE)
    s = skeleton_of_bones(C, BE)
    assert write_tgf_skeleton(tmp_path / "b.tgf", s) == ()
    again = read_tgf_rig(tmp_path / "b.tgf").skeleton
    assert np.array_equal(again.C[again.BE], C[BE])
    assert (again.names, again.P.tolist()) == (s.names, s.P.tolist())
    points = skeleton_of_bones(C, np.repeat(np.arange(5)[:, None], 2, axis=1))
    assert write_tgf_skeleton(tmp_path / "c.tgf", points) == ()
    assert np.array_equal(read_tgf(tmp_path / "c.tgf")[0], C)
    # Where they do not come first they are bones without length, which keep their place.
    late = Skeleton(C, BE[[2, 0, 3, 1]], [-1, -1, 0, -1], s.names)
    write_tgf_skeleton(tmp_path / "d.tgf", late)
    C_read, BE_read = read_tgf(tmp_path / "d.tgf")
    assert np.array_equal(C_read[BE_read], C[late.BE])
    for wrong in (BE[[2, 0, 3, 1]], BE[[1, 0, 2, 3]], [[0, 0], [0, 1]]):
        with pytest.raises(ValueError, match="BE: point handles, a joint twice, come before bones"):
            write_tgf(tmp_path / "e.tgf", C, wrong)


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
