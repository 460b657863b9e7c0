import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from nilbs.geometry.intersections import degenerate_facets, self_intersections, t_junctions
from nilbs.geometry.rotations import rotation_matrices

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_F = np.array([triangle for a, b, c, e in SIDES for triangle in ([a, b, c], [a, c, e])])


def meet(V, f, g):
    """A slow twin: whether two facets share a point that is not at their common vertices, as a linear program."""
    d = V.shape[1]
    A = np.concatenate([V[f].T, -V[g].T], axis=1)
    ones = np.kron(np.eye(2), np.ones(d))
    elsewhere = np.array([-1.0 * (v not in g) for v in f] + [-1.0 * (v not in f) for v in g])
    best = linprog(elsewhere, A_eq=np.concatenate([A, ones]), b_eq=np.append(np.zeros(d), [1, 1]), bounds=(0, 1))
    return best.status == 0 and best.fun < -1e-7


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("shared", [0, 1, 2])
@pytest.mark.parametrize("turned", [False, True])
def test_pairs_on_a_lattice_against_a_slow_twin(d, shared, turned, rng):
    """On a lattice facets often touch, lie in one plane and cover each other."""
    if shared == d:
        pytest.skip("two edges with the same ends")
    R = rotation_matrices(rng.normal(size=3 if d == 3 else 1))
    R = R if turned else np.eye(d)
    tried = found = 0
    while tried < 150:
        V = rng.integers(0, 3, size=(2 * d - shared, d)).astype(float)
        if rng.random() < 0.3:
            V[:, -1] = 1
        f, g = np.arange(d), np.arange(d) + d - shared
        F = np.array([rng.permutation(f), rng.permutation(g)])
        if degenerate_facets(V, F).any() or len(np.unique(V, axis=0)) < len(V):
            continue
        tried += 1
        pairs, complete = self_intersections(V @ R.T + 1, F)
        assert complete
        expected = meet(V, f.tolist(), g.tolist())
        assert (len(pairs) == 1) == expected, V
        found += expected
    assert 5 < found < 145


@pytest.mark.parametrize("d", [2, 3])
def test_all_pairs_of_a_soup_against_a_slow_twin(d, rng):
    V = rng.normal(size=(24, d))
    F = np.array([rng.choice(24, d, replace=False) for _ in range(14)])
    expected = [
        [i, j]
        for i, j in itertools.combinations(range(14), 2)
        if set(F[i]) != set(F[j]) and meet(V, F[i].tolist(), F[j].tolist())
    ]
    assert expected
    assert self_intersections(V, F)[0].tolist() == expected


@pytest.mark.parametrize("scale", [1e-200, 1e-4, 1e4])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_neither_the_unit_nor_the_place_matters(scale, offset, rng):
    V = np.concatenate([CUBE, CUBE @ rotation_matrices(rng.normal(size=3)).T + 0.3])
    F = np.concatenate([CUBE_F, CUBE_F + 8])
    pairs, _ = self_intersections(V, F)
    assert len(pairs) > 5
    assert np.array_equal(self_intersections((V + offset) * scale, F)[0], pairs)


def test_a_flat_finely_divided_plane_is_clear_of_itself(rng):
    x = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.arange(400).reshape(20, 20)
    a, b, c, e = (part.ravel() for part in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]))
    F = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, e], 1)])
    x[:, :2] += rng.uniform(-0.2, 0.2, size=(400, 2))
    for R in (np.eye(3), rotation_matrices(rng.normal(size=3))):
        assert len(self_intersections(x @ R.T, F)[0]) == 0
    # One corner pulled across its neighbour folds the plane onto itself.
    x[210, :2] += [1.5, 0]
    assert len(self_intersections(x, F)[0]) > 0


@pytest.mark.parametrize(("x", "expected"), [(-1, 0), (1, 1)])
def test_triangles_that_share_a_corner_and_stand_across_each_other(x, expected):
    V = np.array([[0.0, 0, 0], [1, -1, 0], [1, 1, 0], [x, 0.1, -1], [x, 0.1, 1]])
    assert len(self_intersections(V, [[0, 1, 2], [0, 3, 4]])[0]) == expected


@pytest.mark.parametrize(("height", "expected"), [(1e-12, 1), (0.0, 1), (1e-6, 0)])
def test_a_tip_that_stands_on_the_middle_of_a_triangle(height, expected):
    V = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [1, 1, height], [1, 1.5, 1], [1.5, 1, 1]])
    assert len(self_intersections(V, [[0, 1, 2], [3, 4, 5]])[0]) == expected
    assert len(self_intersections(V, [[5, 3, 4], [1, 0, 2]])[0]) == expected


def test_bodies_that_touch():
    F = np.concatenate([CUBE_F, CUBE_F + 8])
    for apart, touching in ((0.01, False), (1e-7, False), (1e-12, True), (0, True)):
        beside = np.concatenate([CUBE, CUBE @ np.diag([1, 0.5, 0.5]) + [1 + apart, 0.3, 0.2]])
        assert (len(self_intersections(beside, F)[0]) > 0) == touching, apart


def test_a_surface_that_is_cut_along_a_seam_does_not_touch_itself_there():
    V = CUBE[CUBE_F].reshape(-1, 3)
    assert len(self_intersections(V, np.arange(36).reshape(12, 3))[0]) == 0


def test_duplicate_and_degenerate_facets_are_no_intersections():
    F = np.concatenate([CUBE_F, CUBE_F[:1, ::-1], [[0, 0, 1]]])
    pairs, _ = self_intersections(CUBE, F)
    assert len(pairs) == 0
    assert [x.shape for x in self_intersections(CUBE, F[-1:])[:1]] == [(0, 2)]


def test_too_many_intersections_end_the_search(rng, monkeypatch):
    V, F = rng.normal(size=(300, 3)), np.arange(300).reshape(100, 3)
    every, complete = self_intersections(V, F)
    assert complete
    monkeypatch.setattr("nilbs.geometry.boxes._CHUNK", 1000)
    monkeypatch.setattr("nilbs.geometry.intersections._ENOUGH", 100)
    some, complete = self_intersections(V, F)
    assert not complete
    assert 100 <= len(some) < len(every)
    assert {tuple(pair) for pair in some.tolist()} < {tuple(pair) for pair in every.tolist()}


def test_too_many_overlapping_boxes_end_the_search(monkeypatch):
    """Long thin triangles side by side, whose boxes all overlap although they do not touch."""
    step = np.arange(200)[:, None, None] * np.array([0.01, 0, 0])
    V = (np.array([[0.0, 0, 0], [10, 10, 10], [10, 10.001, 10]]) + step).reshape(-1, 3)
    F = np.arange(600).reshape(200, 3)
    assert [len(x) if i == 0 else x for i, x in enumerate(self_intersections(V, F))] == [0, True]
    monkeypatch.setattr("nilbs.geometry.intersections._PAIRS_PER_FACET", 1)
    monkeypatch.setattr("nilbs.geometry.boxes._CHUNK", 1000)
    assert self_intersections(V, F)[1] is False


def test_degenerate_facets():
    V = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [0, 1e-8, 0], [0, 1e-10, 0], [1, 0, 0]])
    F = [[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 5, 0], [0, 1, 1]]
    assert degenerate_facets(V, F).tolist() == [True, False, True, True, True]
    assert degenerate_facets(V[:, :2], [[0, 1], [1, 5], [2, 2]]).tolist() == [False, True, True]
    assert degenerate_facets(V, np.zeros((0, 3), int)).shape == (0,)


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets(d):
    pairs, complete = self_intersections(np.zeros((2, d)), np.zeros((0, d), int))
    assert pairs.shape == (0, 2)
    assert complete


def test_wrong_arguments():
    with pytest.raises(ValueError, match="does not index the 8 vertices"):
        self_intersections(CUBE, [[0, 1, 8]])
    with pytest.raises(ValueError, match="F must be"):
        self_intersections(CUBE, [[0, 1]])


def test_t_junctions():
    # Two rows of squares that share a line on which one row has more vertices.
    V = np.array(
        [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0], [0, -1, 0], [2, -1, 0], [0, 0, 0], [2, 0, 0]]
    )
    upper = [[0, 1], [1, 2], [2, 4], [4, 3], [3, 0]]
    lower = [[7, 8], [8, 6], [6, 5], [5, 7]]
    R = rotation_matrices([0.3, -0.2, 0.9])
    for scale in (1e-6, 1, 1e6):
        assert t_junctions((V @ R.T + 7) * scale, upper + lower).tolist() == [1]
    assert t_junctions(V + np.array([0, 0, 1.0]), upper).tolist() == []
    assert t_junctions(V, np.zeros((0, 2), int)).tolist() == []
    # An end on another edge's line but beyond the edge is none, nor is one beside it.
    V = np.array([[0.0, 0, 0], [1, 0, 0], [1.5, 0, 0], [2, 1, 0], [0.5, 1e-6, 0], [0, 3, 0]])
    assert t_junctions(V, [[0, 1], [2, 3], [4, 5]]).tolist() == []
