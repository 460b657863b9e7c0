from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import nilbs
from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.compiled import set_threads
from nilbs.engine.skinning import SparseSkinning
from nilbs.engine.surface_tree import SurfaceTree, _shape
from nilbs.geometry.distance import closest_points


def soup(d: int, m: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Unrelated facets, some of them large."""
    F = np.arange(m * d).reshape(m, d)
    middles, size = rng.normal(size=(m, 1, d)), rng.choice([0.05, 0.3, 2], (m, 1, 1))
    return (middles + size * rng.normal(size=(m, d, d))).reshape(-1, d), F


def grid(d: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet or a line of unit steps, whose vertices are shared."""
    if d == 2:
        return np.stack([np.arange(k + 1.0), np.zeros(k + 1)], axis=1), np.stack(
            [np.arange(k), np.arange(1, k + 1)], axis=1
        )
    V = np.stack([*np.mgrid[: k + 1, : k + 1], np.zeros((k + 1, k + 1))], axis=-1).reshape(-1, 3).astype(float)
    i = (np.arange(k)[:, None] * (k + 1) + np.arange(k)).ravel()
    return V, np.concatenate([np.stack([i, i + k + 1, i + k + 2], 1), np.stack([i, i + k + 2, i + 1], 1)])


def assert_agrees(found: ClosestPoints, U: np.ndarray, F: np.ndarray, x: np.ndarray) -> None:
    size = max(np.ptp(U, axis=0).max(), np.abs(U).max(), np.abs(x).max())
    distance, _, _ = closest_points(U, F, x)
    np.testing.assert_allclose(found.distance, distance, rtol=0, atol=1e-12 * size)
    # The place is on the facet, at that distance; the weights are those of the facet's corners.
    np.testing.assert_allclose(np.linalg.norm(x - found.point, axis=1), found.distance, rtol=0, atol=1e-13 * size)
    corners = np.einsum("nk,nkd->nd", found.barycentric, U[F[found.facet]])
    np.testing.assert_allclose(corners, found.point, rtol=0, atol=1e-13 * size)
    assert found.barycentric.min() >= -1e-15
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-14)


def assert_same(a: ClosestPoints, b: ClosestPoints) -> None:
    for name, one, other in zip(ClosestPoints._fields, a, b, strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)


def taken(found: ClosestPoints, rows: np.ndarray | slice) -> ClosestPoints:
    return ClosestPoints(*(values[rows] for values in found))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("m", [1, 2, 4, 5, 31, 33, 130, 1100])
def test_it_agrees_with_its_twin(d: int, m: int, rng: np.random.Generator) -> None:
    V, F = soup(d, m, rng)
    near = V[rng.integers(len(V), size=300)] + 0.02 * rng.normal(size=(300, d))
    x = np.concatenate([near, rng.uniform(-4, 4, (300, d)), 30 * rng.normal(size=(50, d)), V])
    found = SurfaceTree(V, F).posed(V).closest(x)
    assert (found.distance.dtype, found.facet.dtype) == (np.float64, np.int64)
    assert (found.point.shape, found.barycentric.shape) == (x.shape, x.shape)
    assert_agrees(found, V, F, x)


@pytest.mark.parametrize("d", [2, 3])
def test_the_rest_shape_changes_no_distance(d: int, rng: np.random.Generator) -> None:
    V, F = grid(d, 20)
    tree = SurfaceTree(V, F)
    for _ in range(2):  # a pose leaves nothing behind
        U = rng.normal(size=V.shape)
        x = rng.normal(size=(500, d))
        assert_agrees(tree.posed(U).closest(x), U, F, x)
    assert_agrees(tree.posed(V).closest(x), V, F, x)


@pytest.mark.parametrize("d", [2, 3])
def test_triangles_without_area(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 60, rng)
    V = V.reshape(-1, d, d)
    V[:20] = V[:20, :1]  # points
    t = rng.uniform(-1, 2, (20, d - 2, 1))
    V[20:40, 2:] = V[20:40, :1] + t * (V[20:40, 1:2] - V[20:40, :1])  # segments, corners in any order
    V[40:50, 2:] = V[40:50, 1:2] + 1e-9 * rng.normal(size=(10, d - 2, d))  # slivers
    V = V.reshape(-1, d)
    x = np.concatenate([V, rng.normal(size=(1000, d)), V + 1e-3 * rng.normal(size=V.shape)])
    surface = SurfaceTree(V, F).posed(V)
    assert_agrees_with_loop(surface.closest(x), V, F, x)


def assert_agrees_with_loop(found: ClosestPoints, V: np.ndarray, F: np.ndarray, x: np.ndarray) -> None:
    """The least distance over samples of each facet is an upper bound, and close to it; the place is on the facet."""
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", found.barycentric, V[F[found.facet]]), found.point, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(x - found.point, axis=1), found.distance, atol=1e-13)
    assert found.barycentric.min() >= -1e-15
    for p, distance in zip(x, found.distance, strict=True):
        assert distance <= least_distance(p, V[F]) + 1e-9


def least_distance(p: np.ndarray, corners: np.ndarray) -> float:
    """To the edges of all facets, and to the insides of those that have one."""
    least = np.inf
    k = corners.shape[1]
    for i in range(k):
        a, e = corners[:, i], corners[:, (i + 1) % k] - corners[:, i]
        square = (e**2).sum(axis=1)
        t = np.clip(((p - a) * e).sum(axis=1) / np.where(square > 0, square, 1), 0, 1)
        least = min(least, np.linalg.norm(p - a - t[:, None] * e, axis=1).min())
    if k == 3:
        for a, b, c in corners:
            if np.linalg.norm(np.cross(b - a, c - a)) > 1e-6:
                v, w = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), p - a, rcond=None)[0]
                if v >= 0 and w >= 0 and v + w <= 1:
                    least = min(least, np.linalg.norm(p - a - v * (b - a) - w * (c - a)))
    return float(least)


@pytest.mark.parametrize("d", [2, 3])
def test_an_answer_depends_on_its_point_alone(d: int, rng: np.random.Generator) -> None:
    V, F = grid(d, 24)
    # Many points are as close to several facets; more of them than a thread works on at a time.
    x = np.concatenate([rng.integers(-2, 27, (2000, d)) * 1.0, rng.uniform(-2, 27, (3000, d))])
    surface = SurfaceTree(V, F).posed(V)
    together = surface.closest(x)
    assert_agrees(together, V, F, x)
    order = rng.permutation(len(x))
    assert_same(surface.closest(x[order]), taken(together, order))
    assert_same(surface.closest(x[1234:]), taken(together, slice(1234, None)))
    for i in range(0, len(x), 97):
        assert_same(surface.closest(x[i : i + 1]), taken(together, slice(i, i + 1)))
    for count in (1, 2, 3):
        set_threads(count)
        try:
            assert_same(surface.closest(x), together)
            assert_same(SurfaceTree(V, F).posed(V).closest(x), together)
        finally:
            set_threads(None)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(surface.closest, [x] * 8):
            assert_same(found, together)


@pytest.mark.parametrize("d", [2, 3])
def test_of_equal_facets_the_first_is_found(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 70, rng)
    x = rng.uniform(-3, 3, (400, d))
    once = SurfaceTree(V, F).posed(V).closest(x)
    assert_same(SurfaceTree(V, np.tile(F, (5, 1))).posed(V).closest(x), once)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("scale", [1e-60, 1e-12, 1e9, 1e60])
def test_any_unit_of_length(d: int, scale: float, rng: np.random.Generator) -> None:
    V, F = soup(d, 50, rng)
    x = rng.uniform(-3, 3, (400, d))
    found, scaled = (SurfaceTree(V * s, F).posed(V * s).closest(x * s) for s in (1, scale))
    np.testing.assert_allclose(scaled.distance / scale, found.distance, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(scaled.point / scale, found.point, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_points_and_bodies_far_away(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 50, rng)
    direction = rng.normal(size=(20, d))
    for far in (1e3, 1e6, 1e12, 1e25):
        x = far * direction
        np.testing.assert_allclose(
            SurfaceTree(V, F).posed(V).closest(x).distance, closest_points(V, F, x)[0], rtol=1e-12
        )
    x = rng.uniform(-3, 3, (400, d))
    near = SurfaceTree(V, F).posed(V).closest(x).distance
    moved = SurfaceTree(V, F).posed(V + 1e6).closest(x + 1e6).distance
    np.testing.assert_allclose(moved, near, rtol=0, atol=1e-8)


@pytest.mark.parametrize("d", [2, 3])
def test_a_vertex_that_no_facet_uses_changes_nothing(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 50, rng)
    x = rng.uniform(-3, 3, (100, d))
    stray = np.concatenate([V, np.full((1, d), 1e12)])
    assert_same(SurfaceTree(stray, F).posed(stray).closest(x), SurfaceTree(V, F).posed(V).closest(x))


@pytest.mark.parametrize("d", [2, 3])
def test_all_vertices_in_one_place(d: int) -> None:
    V, F = np.ones((d, d)), np.tile(np.arange(d), (40, 1))
    found = SurfaceTree(V, F).posed(V).closest(np.array([[1.0] * d, [1.0] * (d - 1) + [3.0]]))
    np.testing.assert_allclose(found.distance, [0, 2], atol=1e-15)
    np.testing.assert_array_equal(found.facet, [0, 0])


@pytest.mark.parametrize("d", [2, 3])
def test_points_that_are_not_finite_have_no_place(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 50, rng)
    x = rng.uniform(-3, 3, (60, d))
    surface = SurfaceTree(V, F).posed(V)
    expected = surface.closest(x)
    bad = np.arange(0, 60, 7)
    x[bad, rng.integers(d, size=len(bad))] = rng.permutation(np.resize([np.nan, np.inf, -np.inf], len(bad)))
    found = surface.closest(x)
    good = np.setdiff1d(np.arange(60), bad)
    assert_same(taken(found, good), taken(expected, good))
    assert_no_place(taken(found, bad))


def assert_no_place(found: ClosestPoints) -> None:
    assert (found.distance == np.inf).all()
    assert (found.facet == -1).all()
    assert np.isnan(found.point).all()
    assert np.isnan(found.barycentric).all()


@pytest.mark.parametrize("d", [2, 3])
def test_places_within_reach(d: int, rng: np.random.Generator) -> None:
    V, F = soup(d, 200, rng)
    x = rng.uniform(-4, 4, (3000, d))
    surface = SurfaceTree(V, F).posed(V)
    everywhere = surface.closest(x)
    reach = float(np.median(everywhere.distance))
    found, near = surface.closest(x, within=reach), everywhere.distance <= reach
    assert_same(taken(found, near), taken(everywhere, near))
    assert_no_place(taken(found, ~near))


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_to_find_and_nothing_to_do(d: int) -> None:
    x = np.zeros((2, d))
    found = SurfaceTree(np.empty((0, d)), np.empty((0, d), dtype=int)).posed(np.empty((0, d))).closest(x)
    assert_no_place(found)
    assert found.point.shape == found.barycentric.shape == (2, d)
    V, F = grid(d, 3)
    for tree in (SurfaceTree(V, F), SurfaceTree(V, F[:0])):
        found = tree.posed(V).closest(x[:0])
        assert [values.shape for values in found] == [(0,), (0,), (0, d), (0, d)]


def test_every_node_has_its_own_number() -> None:
    for count in [*range(1, 600), 4095, 4096, 4097, 5000]:
        leaves, offset, levels = _shape(count)
        assert count <= leaves < 2 * count + 8
        children = {8 * i + k + offset for i in range(levels[-1]) for k in range(8)}
        # The root's first children may be missing; all others are numbered after it, leaves last.
        assert {i for i in children if i > 0} == set(range(1, levels[-1] + leaves))
        # A level's children are the next level, so that all of a level can be fitted at once.
        ends = [*levels, levels[-1] + leaves]
        assert [8 * i + offset for i in levels[1:]] == ends[2:]


def test_a_wrong_shape_is_named() -> None:
    V, F = grid(3, 3)
    with pytest.raises(ValueError, match=r"F\[0\]"):
        SurfaceTree(V, F + 100)
    tree = SurfaceTree(V, F)
    with pytest.raises(ValueError, match=r"U must be \(16, 3\), got \(15, 3\)"):
        tree.posed(V[1:])
    with pytest.raises(ValueError, match="U"):
        tree.posed(np.where(V == 1, np.nan, V))
    with pytest.raises(ValueError, match=r"x must be \(n, d\) = \(n, 3\), got \(5, 2\)"):
        tree.posed(V).closest(np.zeros((5, 2)))


def test_the_elephant_in_motion(data: Path, rng: np.random.Generator) -> None:
    folder = data / "elephant"
    c = nilbs.load_character(*(folder / f"elephant{end}" for end in (".obj", ".tgf", "-weights.dmat")))
    motion = nilbs.load_motion(folder / "elephant-anim.dmat", c)
    tree, skinning = SurfaceTree(c.V, c.F), SparseSkinning(c.V, c.W)
    for frame in (0, 150, 400):
        U = skinning.posed(motion.B[frame])
        np.testing.assert_allclose(U, c.skin(motion.B[frame]), rtol=0, atol=1e-12 * c.L)
        near = U[rng.integers(len(U), size=3000)] + 0.006 * c.L * rng.normal(size=(3000, 3))
        x = np.concatenate([near, rng.uniform(U.min(axis=0), U.max(axis=0), (2000, 3)), U])
        assert_agrees(tree.posed(U).closest(x), U, c.F, x)
