import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.geometry.skeleton import Skeleton
from nilbs.io import FileFormatError
from nilbs.io.rignet import read_rignet, write_rignet


@pytest.fixture
def rig(tmp_path):
    def read(text):
        path = tmp_path / "a_rig.txt"
        path.unlink(missing_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_rignet(path)

    return read


CAT = """joints hip 0 0 0
joints leg 1 0 0
joints leg_dup_0 1 0 0
joints tail 0 1 2.5e-1
root hip
skin 0 hip 1
skin 2 leg 0.25 tail 0.75
hier hip leg
hier hip tail
hier leg leg_dup_0
"""


def test_a_rig(rig):
    parts = rig(CAT)
    s, i = parts.skeleton, parts.influences
    assert s.names == ("hip", "leg", "leg_dup_0", "tail")
    assert s.C.tolist() == [[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0.25]]
    assert s.P.tolist() == [-1, 0, 1, 0]
    assert s.BE.tolist() == [[0, 1], [1, 2], [2, 2], [3, 3]]
    assert s.forks.tolist() == [[0, 3]]
    assert i.dense(3, 4, "a").tolist() == [[1, 0, 0, 0], [0, 0, 0, 0], [0, 0.25, 0, 0.75]]
    assert parts.notes == ()
    assert parts.mesh is None
    assert parts.clips == ()


def test_lines_in_any_order_and_with_any_spaces(rig):
    reversed_lines = "\r\n \t\r\n".join(line.replace(" ", "\t ") for line in CAT.splitlines()[::-1])
    parts, same = rig(reversed_lines), rig(CAT)
    # Joints stand in the file's order, so they are compared by name.
    order = [parts.skeleton.names.index(name) for name in same.skeleton.names]
    assert np.array_equal(parts.skeleton.C[order], same.skeleton.C)
    assert np.array_equal(parts.influences.dense(3, 4, "a")[:, order], same.influences.dense(3, 4, "a"))


def test_names_of_any_bytes(rig):
    parts = rig("joints Hüfte:1/#{} 0 0 0\n".encode() + b"joints H\xff 0 0 1\njoints H\xfe 0 0 2\n")
    assert parts.skeleton.names == ("Hüfte:1/#{}", "Hÿ", "Hþ")
    assert parts.influences is None
    assert parts.notes[0] == "its text is not UTF-8: it was read as Windows-1252"


def test_several_roots_are_noted(rig):
    parts = rig(CAT + "joints hat 5 5 5\njoints brim 6 5 5\nhier hat brim\n")
    assert parts.skeleton.P.tolist() == [-1, 0, 1, 0, -1, 4]
    assert parts.notes == ("joints without a parent, taken as roots: 'hat'",)


def test_unnormalised_and_repeated_weights_are_handed_on(rig):
    i = rig("joints a 0 0 0\njoints b 1 0 0\nskin 1 a 0.5 b 3 a -1\nskin 1 b 1\nskin 0\n").influences
    assert i.dense(2, 2, "a").tolist() == [[0, 0], [-0.5, 4]]


def test_a_leaf_called_end_is_where_its_parent_ends(rig):
    lines = "joints a 0 0 0\njoints a_end 0 2 0\njoints b_end 7 7 7\nhier a a_end\nhier a b_end\nroot a\n"
    s = rig(lines).skeleton
    assert s.names == ("a", "b_end")
    assert s.C[s.BE].tolist() == [[[0, 0, 0], [0, 2, 0]], [[7, 7, 7], [7, 7, 7]]]
    assert s.forks.tolist() == [[0, 1]]
    # Before the bones of the file, it shifts their numbers.
    ends = "joints a_end 0 2 0\njoints a 0 0 0\njoints b 7 7 7\nhier a a_end\nhier a b\nroot a\nskin 0 b 0.5\n"
    parts = rig(ends)
    assert parts.skeleton.names == ("a", "b")
    assert parts.skeleton.P.tolist() == [-1, 0]
    assert parts.influences.bone.tolist() == [1]
    # One with weights, or with a child, is a bone.
    assert rig(lines + "skin 0 a_end 1\n").skeleton.names == ("a", "a_end", "b_end")
    assert rig(lines + "joints c 0 3 0\nhier a_end c\n").skeleton.names == ("a", "a_end", "b_end", "c")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("root a\n", ": the rig has no joint"),
        ("joints a 0 0\n", ":1: joints needs a name without spaces and three numbers"),
        ("joints a b 0 0 0\n", ":1: joints needs"),
        ("joints a 0 0 nan\n", ":1: 'nan' is not a finite number"),
        ("joints a 0 0 1e999\n", ":1: '1e999' is not a finite number"),
        ("joints a 0 0 1_0\n", ":1: '1_0' is not a finite number"),
        ("joints\n", ":1: joints needs"),
        (CAT + "joints leg 0 0 0\n", ":11: a second joint 'leg'"),
        ("skin 0 nose 1\n" + CAT, ":1: the file has no joint 'nose'"),
        (CAT + "hier hip nose\nhier nose ear\n", ":11: the file has no joint 'nose'"),
        (CAT + "hier nose hip\n", ":11: the file has no joint 'nose'"),
        (CAT + "root nose\n", ":11: the file has no joint 'nose'"),
        (CAT + "root\n", ":11: root needs the name of a joint"),
        (CAT + "hier hip\n", ":11: hier needs a parent and its child"),
        (CAT + "hier tail leg\n", ":11: joint 'leg' has two parents, here and in line 8"),
        (CAT + "hier tail hip\n", ":11: joint 'hip' is its own ancestor"),
        (CAT + "hier hip hip\n", ":11: joint 'hip' is its own ancestor"),
        (CAT + "root tail\n", ":9: the root 'tail' has a parent"),
        (CAT + "skin\n", ":11: skin needs a vertex"),
        (CAT + "skin -1 hip 1\n", ":11: skin needs a vertex"),
        (CAT + "skin 1 hip\n", ":11: skin needs a vertex"),
        (CAT + "skin 1 hip x\n", ":11: 'x' is not a finite number"),
        (CAT + "skin 1 hip inf\n", ":11: 'inf' is not a finite number"),
        (CAT + "skin " + "9" * 30 + " hip 1\n", ":11: skin needs a vertex"),
        (CAT + "v 0 0 0\n", ":11: a line of a rig starts with joints, root, hier or skin, not 'v'"),
        (CAT + "\0\n", ":11: binary data"),
        ("", ": the file is empty"),
    ],
)
def test_errors_name_file_and_line(rig, text, message):
    with pytest.raises(FileFormatError) as caught:
        rig(text)
    assert f"a_rig.txt{message}" in str(caught.value)


def test_a_long_chain_in_a_circle(rig):
    n = 3000
    text = "".join(f"joints {i} 0 0 0\nhier {i} {(i + 1) % n}\n" for i in range(n))
    with pytest.raises(FileFormatError, match="is its own ancestor"):
        rig(text)


def segments(skeleton):
    C = np.pad(skeleton.C, ((0, 0), (0, 3 - skeleton.d)))
    return C[skeleton.BE]


# Chains and forks, ends elsewhere, bones without length (a leaf and an inner one), parents that end elsewhere.
RIGS = {
    "tgf": (np.array([[0, 1], [1, 2], [1, 3], [3, 4]]), [-1, 0, 0, 2]),
    "no length": (np.array([[0, 1], [1, 1], [3, 4], [4, 4]]), [-1, 0, 0, 2]),
    "apart": (np.array([[0, 1], [2, 3], [4, 5], [2, 0]]), [-1, 0, 1, 1]),
    "roots": (np.array([[0, 1], [2, 2], [3, 4]]), [-1, -1, -1]),
    "inner without length": (np.array([[0, 0], [1, 2], [2, 2]]), [-1, 0, 1]),
    "fork": (np.array([[0, 1], [1, 1], [2, 2]]), [-1, 0, 0]),
    "child first": (np.array([[1, 2], [0, 1]]), [1, -1]),
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("form", RIGS)
def test_round_trip_is_exact(tmp_path, rng, form, d):
    BE, P = RIGS[form]
    names = [f"bone {i}" for i in range(len(BE))]
    s = Skeleton(rng.normal(size=(6, d)) * 10.0 ** rng.integers(-200, 200, size=(6, d)), BE, P, names)
    W = rng.dirichlet(np.ones(len(BE)), size=5)
    W[2] = 0
    notes = write_rignet(tmp_path / "a_rig.txt", s, W)
    parts = read_rignet(tmp_path / "a_rig.txt")
    assert parts.skeleton.names == tuple(name.replace(" ", "_") for name in names)
    assert np.array_equal(parts.skeleton.P, s.P)
    assert np.array_equal(segments(parts.skeleton), segments(s))
    assert np.array_equal(parts.influences.dense(5, len(BE), "a"), W)
    assert parts.notes == ()
    assert len(notes) == 1
    # Once more, from what was read: nothing changes.
    assert write_rignet(tmp_path / "b_rig.txt", parts.skeleton, W) == ()
    assert (tmp_path / "b_rig.txt").read_bytes() == (tmp_path / "a_rig.txt").read_bytes()


def test_a_bone_that_is_called_as_an_end_stays_a_bone(tmp_path):
    s = Skeleton([[0, 0, 0], [0, 1, 0]], [[0, 1], [1, 1]], [-1, 0], ["a", "a_end"])
    write_rignet(tmp_path / "a.txt", s)
    parts = read_rignet(tmp_path / "a.txt")
    assert parts.skeleton.names == ("a", "a_end")
    assert np.array_equal(segments(parts.skeleton), segments(s))
    assert parts.influences is None
    clash = Skeleton([[0, 0, 0], [0, 1, 0], [5, 5, 5]], [[0, 2], [1, 1]], [-1, 0], ["a", "a_end"])
    with pytest.raises(ValueError, match="bone 'a' needs a joint 'a_end' where it ends"):
        write_rignet(tmp_path / "b.txt", clash)
    assert not (tmp_path / "b.txt").exists()


def test_write_rignet_checks_its_arguments(tmp_path):
    s = Skeleton([[0, 0]], [[0, 0]], [-1], ["a"])
    with pytest.raises(ValueError, match="W must be"):
        write_rignet(tmp_path / "a.txt", s, np.ones((3, 2)))


def test_names_that_the_file_cannot_hold(tmp_path):
    names = ["a b", "a_b", "", "a\nb", "x\0y", "\ud800"]
    s = Skeleton(np.eye(3), [[0, 0]] * 6, [-1] * 6, names)
    (note,) = write_rignet(tmp_path / "a.txt", s)
    read = read_rignet(tmp_path / "a.txt").skeleton.names
    assert read == ("a_b", "a_b_2", "_", "a_b_3", "x_y", "__2")
    assert "'a b' became 'a_b'" in note


WORDS = ["joints", "root", "skin", "hier", "a", "b", "b_end", "0", "1", "-1", "nan", "1e999", "\n", "\n", "\n"]


@given(
    data=st.lists(st.sampled_from(WORDS), max_size=40).map(lambda words: " ".join(words).encode()) | st.binary(),
    good=st.booleans(),
    cut=st.integers(0, len(CAT)),
)
def test_anything_is_read_or_refused(rig, data, good, cut):
    parts = message = None
    try:
        parts = rig((CAT.encode()[:cut] if good else b"") + data)
    except FileFormatError as error:
        message = str(error)
    if parts is None:
        assert "a_rig.txt" in message
        assert "\n" not in message
    else:
        assert np.isfinite(parts.skeleton.C).all()
        if parts.influences:
            assert parts.influences.bone.max(initial=0) < len(parts.skeleton.P)
