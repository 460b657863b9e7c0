import numpy as np
import pytest

from nilbs.io.bundle import Bundle, Influences, Mesh, select_group
from nilbs.io.errors import FileFormatError


def test_weights_that_are_named_twice_count_with_their_sum() -> None:
    sparse = Influences(np.array([0, 2, 0, 0]), np.array([1, 0, 1, 0]), np.array([0.25, 3.0, 0.5, -1.0]))
    np.testing.assert_array_equal(sparse.dense(4, 2, "a.txt"), [[-1, 0.75], [0, 0], [3, 0], [0, 0]])
    none = Influences(*(np.zeros(0, dtype=kind) for kind in (int, int, float)))
    np.testing.assert_array_equal(none.dense(2, 3, "a.txt"), np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("vertex", "bone", "message"),
    [
        ([0, 4], [0, 0], "a.txt: a weight of vertex 4, but there are only 4: it is of another mesh"),
        ([0, -1], [0, 0], "a.txt: a weight of vertex -1, but there are only 4: it is of another mesh"),
        ([0, 0], [2, 0], "a.txt: a weight of bone 2, but there are only 2"),
        ([0, 0], [0, -3], "a.txt: a weight of bone -3, but there are only 2"),
    ],
)
def test_weights_of_what_does_not_exist_are_refused(vertex: list[int], bone: list[int], message: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        Influences(np.array(vertex), np.array(bone), np.ones(2)).dense(4, 2, "a.txt")
    assert str(caught.value) == message


def test_a_group_keeps_its_faces_and_the_vertices_that_they_use() -> None:
    V = np.arange(15.0).reshape(5, 3)
    mesh = Mesh(V, np.array([[0, 1, 2], [4, 2, 1], [3, 1, 2]]), {"body": np.array([2, 1]), "none": np.zeros(0, int)})
    part, E, kept = select_group(mesh, "body")
    assert kept.tolist() == [1, 2, 3, 4]
    np.testing.assert_array_equal(part, V[1:])
    np.testing.assert_array_equal(part[E], V[[[3, 1, 2], [4, 2, 1]]])
    part, E, kept = select_group(mesh, "none")
    assert (part.shape, E.shape, kept.shape) == ((0, 3), (0, 3), (0,))


def test_edges_have_groups_too() -> None:
    mesh = Mesh(np.eye(2), np.array([[0, 1], [1, 0]]), {"back": np.array([1])})
    assert select_group(mesh, "back")[1].tolist() == [[1, 0]]


@pytest.mark.parametrize(
    ("groups", "known"), [({}, "none"), ({"a": np.zeros(1, int), "b": np.zeros(1, int)}, "'a', 'b'")]
)
def test_a_group_that_is_not_there_is_named_with_those_that_are(groups: dict, known: str) -> None:
    with pytest.raises(ValueError, match=f"^the mesh has no group 'hat'; its groups are: {known}$"):
        select_group(Mesh(np.eye(3), np.array([[0, 1, 2]]), groups), "hat")


def test_what_a_file_does_not_hold_is_missing() -> None:
    parts = Bundle()
    assert parts.mesh is parts.skeleton is parts.influences is None
    assert parts.clips == parts.notes == ()
    # No mesh shares its groups with another.
    assert Mesh(np.eye(3), np.array([[0, 1, 2]])).groups is not Mesh(np.eye(3), np.array([[0, 1, 2]])).groups
