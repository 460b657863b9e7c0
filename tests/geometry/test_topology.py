import numpy as np
import pytest

from nilbs.geometry.topology import group_labels, ridges

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_edges_of_a_tetrahedron():
    r = ridges(TETRAHEDRON)
    assert r.corners.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert r.count.tolist() == [2] * 6
    assert r.corners[r.ridge[1]].tolist() == [[0, 1], [1, 3], [0, 3]]
    assert r.sign[1].tolist() == [1, 1, -1]
    first, second, alike = r.neighbours()
    assert sorted(zip(first.tolist(), second.tolist(), strict=True)) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert alike.all()


def test_ends_of_edges():
    r = ridges([[0, 1], [1, 2], [3, 2], [3, 4]])
    assert r.corners.tolist() == [[0], [1], [2], [3], [4]]
    assert r.count.tolist() == [1, 2, 2, 2, 1]
    assert [x.tolist() for x in r.neighbours()] == [[0, 1, 2], [1, 2, 3], [True, False, False]]


def test_three_facets_at_an_edge_are_no_neighbours():
    assert len(ridges([[0, 1, 2], [1, 0, 3], [0, 1, 4]]).neighbours()[0]) == 0


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets(d):
    r = ridges(np.zeros((0, d), int))
    assert r.corners.shape == (0, d - 1)
    assert len(r.neighbours()[0]) == 0


def test_groups():
    assert len(group_labels([], [], 0)) == 0
    label = group_labels([5, 1], [1, 3], 6)
    assert label[1] == label[3] == label[5]
    assert len(set(label.tolist())) == 4


def test_wrong_arguments():
    with pytest.raises(ValueError, match="F must be"):
        ridges([0, 1, 2])
