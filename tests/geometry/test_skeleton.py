import numpy as np
import pytest

from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints

C = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0.0]])


@pytest.mark.parametrize("d", [2, 3])
def test_a_skeleton_keeps_its_arguments(d: int) -> None:
    s = Skeleton(C[:, :d].tolist(), [[0, 1], [1, 2], [1, 1]], [-1, 0, 0], ["a", "b", "c"], [[0, 3]])
    assert s.d == d
    np.testing.assert_array_equal(s.C, C[:, :d])
    for name, value in (("BE", [[0, 1], [1, 2], [1, 1]]), ("P", [-1, 0, 0]), ("forks", [[0, 3]])):
        np.testing.assert_array_equal(getattr(s, name), value)
        assert getattr(s, name).dtype == np.int64
    assert s.names == ("a", "b", "c")
    with pytest.raises(AttributeError):
        s.P = s.P


def test_segments_are_the_bones_and_then_the_forks() -> None:
    s = Skeleton(C, [[0, 1], [1, 2], [3, 3]], [-1, 0, 0], "abc", [[0, 3], [1, 3]])
    ends, bone = s.segments()
    assert ends.tolist() == [[0, 1], [1, 2], [3, 3], [0, 3], [1, 3]]
    assert bone.tolist() == [0, 1, 2, 0, 1]
    ends, bone = Skeleton(C, [[0, 1], [1, 2]], [-1, 0], "ab").segments()
    assert (ends.tolist(), bone.tolist()) == ([[0, 1], [1, 2]], [0, 1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"C": np.zeros((4, 4))}, r"^C has d = 4; d must be 2 or 3$"),
        ({"C": C * np.array([1, np.nan, 1])}, r"^C\[0, 1\] is nan"),
        ({"BE": np.zeros((0, 2)), "P": [], "names": []}, "^the rig has no bone$"),
        ({"BE": [[0, 1, 2], [0, 1, 2]]}, r"^BE must be \(b, 2\)"),
        ({"BE": [[0, 1], [1, 4]]}, r"^BE\[1\] = \[1, 4\] does not index the 4 joints$"),
        ({"P": [-1]}, r"^P must be \(b,\) = \(2,\), got \(1,\)$"),
        ({"P": [-1, 2]}, r"does not index"),
        ({"P": [1, 0]}, r"cycle"),
        ({"P": [-1, 1]}, r"cycle"),
        ({"forks": [[2, 0]]}, r"^forks\[:, 0\]\[0\] = \[2\] does not index the 2 bones$"),
        ({"forks": [[0, 4]]}, r"^forks\[:, 1\]\[0\] = \[4\] does not index the 4 joints$"),
        ({"names": ["a"]}, r"^names must be \(b,\) = \(2,\), got \(1,\)$"),
        ({"names": ["arm", "arm"]}, r"^two bones have the name 'arm'$"),
    ],
)
def test_wrong_skeletons_are_refused(changes: dict, message: str) -> None:
    given = {"C": C, "BE": [[0, 1], [1, 2]], "P": [-1, 0], "names": ["a", "b"]} | changes
    with pytest.raises(ValueError, match=message):
        Skeleton(**given)


def tree(parents: list[int], rng: np.random.Generator, d: int = 3) -> Skeleton:
    names = [f"joint {j}" for j in range(len(parents))]
    return skeleton_of_joints(rng.normal(size=(len(parents), d)), parents, names)


@pytest.mark.parametrize("d", [2, 3])
def test_a_chain_of_joints_is_a_chain_of_bones(d: int, rng: np.random.Generator) -> None:
    s = tree([-1, 0, 1, 2], rng, d)
    assert s.C.shape == (4, d)
    assert s.BE.tolist() == [[0, 1], [1, 2], [2, 3], [3, 3]]
    assert s.P.tolist() == [-1, 0, 1, 2]
    assert s.forks.tolist() == []
    assert s.names == ("joint 0", "joint 1", "joint 2", "joint 3")


def test_a_bone_leads_to_the_longest_chain_and_the_other_children_are_forks(rng: np.random.Generator) -> None:
    # Joint 0 has the children 1, 2 and 3; below 2 there is a chain of two joints, below 3 of one.
    s = tree([-1, 0, 0, 0, 2, 4, 3], rng)
    assert s.BE.tolist() == [[0, 2], [1, 1], [2, 4], [3, 6], [4, 5], [5, 5], [6, 6]]
    assert s.forks.tolist() == [[0, 1], [0, 3]]
    # Joints may come in any order, children before parents.
    s = tree([1, 2, -1, 2], rng)
    assert s.BE.tolist() == [[0, 0], [1, 0], [2, 1], [3, 3]]
    assert s.forks.tolist() == [[2, 3]]
    assert tree([-1, 0, 0], rng).BE.tolist() == [[0, 1], [1, 1], [2, 2]]


def test_several_roots_and_a_joint_alone(rng: np.random.Generator) -> None:
    assert tree([-1, -1, 1], rng).BE.tolist() == [[0, 0], [1, 2], [2, 2]]
    assert tree([-1], rng).BE.tolist() == [[0, 0]]


def test_given_ends() -> None:
    positions = np.array([[0, 0], [1, 0], [2, 0], [1, 1.0]])
    given = {2: np.array([3, 0]), 0: np.array([0, -1])}
    s = skeleton_of_joints(positions, [-1, 0, 1, 1], "abcd", ends=given)
    np.testing.assert_array_equal(s.C[:4], positions)
    np.testing.assert_array_equal(s.C[s.BE[2]], [[2, 0], [3, 0]])
    # A joint with a given end leads to none of its children: all of them are forks.
    np.testing.assert_array_equal(s.C[s.BE[0]], [[0, 0], [0, -1]])
    assert s.forks.tolist() == [[0, 1], [1, 3]]
    assert s.BE[[1, 3]].tolist() == [[1, 2], [3, 3]]


def test_wrong_joints_are_refused() -> None:
    x = np.zeros((2, 3))
    for parents, names, message in (
        ([1, 0], "ab", "cycle"),
        ([-1, 5], "ab", "does not index"),
        ([-1], "ab", r"^parents must be \(b,\) = \(2,\), got \(1,\)$"),
        ([-1, 0], "aa", "^two bones have the name 'a'$"),
        ([-1, 0], "abc", r"^names must be \(b,\) = \(2,\), got \(3,\)$"),
    ):
        with pytest.raises(ValueError, match=message):
            skeleton_of_joints(x, parents, names)
    with pytest.raises(ValueError, match=r"^the rig has no bone$"):
        skeleton_of_joints(np.zeros((0, 3)), [], [])


def test_a_chain_of_many_joints(rng: np.random.Generator) -> None:
    n = 20_000
    s = skeleton_of_joints(rng.normal(size=(n, 3)), np.arange(n) - 1, [str(j) for j in range(n)])
    np.testing.assert_array_equal(s.BE[:-1, 1], np.arange(1, n))
