import itertools

import numpy as np
import pytest

from nilbs.geometry.polygons import cut_polygons
from nilbs.geometry.rotations import rotation_matrices


def areas(V, F):
    a, b = V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def enclosed(V):
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in itertools.pairwise([*V, V[0]])) / 2


def star(k, rng):
    """A polygon around the origin, concave in most places."""
    angle = np.arange(k) * 2 * np.pi / k
    radius = rng.uniform(0.2, 1, size=k)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def comb(teeth):
    """A polygon that no corner sees completely."""
    x = np.arange(2 * teeth + 1) / teeth
    low = np.stack([x, np.where(np.arange(len(x)) % 2, 0.1, 1)], axis=1)
    return np.concatenate([low[::-1], [[0, 0], [2, 0]]])


COMB = comb(20)
RECTANGLE = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [0, 1]])
SPIRAL = np.array([[0.0, 0], [5, 0], [5, 5], [1, 5], [1, 2], [3, 2], [3, 3], [2, 3], [2, 4], [4, 4], [4, 1], [0, 1]])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("V", [COMB, RECTANGLE, SPIRAL, SPIRAL[::-1], RECTANGLE[::-1]])
def test_simple_polygons_are_covered_once(V, d, rng):
    for shift in range(len(V)):
        U = np.roll(V, shift, axis=0)
        placed = U if d == 2 else np.insert(U, 2, 1, axis=1) @ rotation_matrices(rng.normal(size=3)).T
        F, face, crossed = cut_polygons(placed, np.arange(len(V)), [len(V)])
        area = areas(U, F) * np.sign(enclosed(U))
        assert F.shape == (len(V) - 2, 3)
        assert not crossed.any()
        assert not face.any()
        assert area.min() > 1e-3
        assert area.sum() == pytest.approx(abs(enclosed(U)))


def test_random_polygons_are_covered_once(rng):
    for k in range(4, 30):
        V = star(k, rng)
        F, _, crossed = cut_polygons(V, np.arange(k), [k])
        assert not crossed.any()
        assert areas(V, F).min() >= -1e-12
        assert areas(V, F).sum() == pytest.approx(enclosed(V))


def test_every_concave_quadrilateral(rng):
    V = np.array([[0, 0], [1, 1], [0, 3], [-1, 1]]) + 0.1 * rng.normal(size=(500, 4, 2))
    V[:, 2] = V[:, 0] + [0, 0.5]  # between the other three, so that the outline is simple
    F, _, crossed = cut_polygons(V.reshape(-1, 2), np.arange(2000), np.full(500, 4))
    assert not crossed.any()
    twice = areas(V.reshape(-1, 2), F).reshape(500, 2)
    assert (twice > 0).all()
    assert twice.sum(axis=1) == pytest.approx([enclosed(v) for v in V])


def test_polygons_of_several_sizes_keep_their_order(rng):
    parts = [star(k, rng) for k in (3, 7, 4, 3, 12, 5)]
    counts = [len(part) for part in parts]
    F, face, _ = cut_polygons(np.concatenate(parts), np.arange(sum(counts)), counts)
    assert face.tolist() == np.repeat(np.arange(6), np.array(counts) - 2).tolist()
    start = np.cumsum(counts) - counts
    for i, part in enumerate(parts):
        alone, _, _ = cut_polygons(part, np.arange(len(part)), [len(part)])
        assert np.array_equal(F[face == i] - start[i], alone)


def test_a_polygon_need_not_be_flat():
    V = [[0, 0, 0], [1, 0, 0.3], [1, 1, 0], [0, 1, 0.3]]
    assert cut_polygons(V, [0, 1, 2, 3], [4])[0].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("scale", [1e-300, 1e-5, 1.0, 1e300])
def test_the_unit_does_not_matter(scale):
    V = np.insert(SPIRAL, 2, 1, axis=1)
    F, _, crossed = cut_polygons(V * scale, np.arange(12), [12])
    assert not crossed.any()
    assert np.array_equal(F, cut_polygons(V, np.arange(12), [12])[0])


def test_small_polygons_far_from_the_origin():
    V = np.insert(SPIRAL, 2, 1, axis=1)
    F, _, crossed = cut_polygons(V + 1e8, np.arange(12), [12])
    assert not crossed.any()
    assert areas(SPIRAL, F).min() > 0.1


@pytest.mark.parametrize(
    "V",
    [
        [[0, 0], [1, 1], [1, 0], [0, 1]],  # the two halves cancel
        [[0, 0], [3, 3], [3, 0], [0, 1]],
        [[0, 0], [4, 0], [4, 4], [2, -1], [0, 4]],
        [[0, 0], [3, 0], [3, 3], [0, 3], [0, 0], [1, 1], [1, 2], [2, 2], [2, 1], [3, 4]],
    ],
)
def test_polygons_that_cross_themselves(V):
    F, _, crossed = cut_polygons(V, np.arange(len(V)), [len(V)])
    assert crossed.tolist() == [True]
    assert F.shape == (len(V) - 2, 3)


def test_a_polygon_without_area_is_not_crossed():
    F, _, crossed = cut_polygons(np.ones((5, 3)), np.arange(5), [5])
    assert not crossed.any()
    assert F.shape == (3, 3)


def test_few_corners_and_no_polygons():
    F, face, crossed = cut_polygons(np.eye(3), [0, 1, 0, 1, 2], [0, 2, 3])
    assert (F.tolist(), face.tolist(), crossed.tolist()) == ([[0, 1, 2]], [2], [False] * 3)
    F, face, crossed = cut_polygons(np.zeros((0, 3)), [], [])
    assert (F.shape, face.shape, crossed.shape) == ((0, 3), (0,), (0,))


def test_a_hole_on_a_bridge_is_left_open():
    """Polygons with holes, as exporters write them: out to the hole, around it and back along the same edge."""
    V = np.array([[0.0, 0], [3, 0], [3, 3], [0, 3], [1, 1], [1, 2], [2, 2], [2, 1]])
    corners = [0, 1, 2, 3, 0, 4, 5, 6, 7, 4]
    F, _, crossed = cut_polygons(V, corners, [10])
    assert not crossed.any()
    assert areas(V, F).min() > 0
    assert areas(V, F).sum() == pytest.approx(8)


def test_a_polygon_that_takes_too_many_steps_is_given_up(monkeypatch, rng):
    V = star(10_000, rng)
    monkeypatch.setattr("nilbs.geometry.polygons._STEPS", 100_000)
    assert cut_polygons(V, np.arange(len(V)), [len(V)])[2].all()


def test_wrong_arguments():
    with pytest.raises(ValueError, match="counts must add up to the 3 corners"):
        cut_polygons(np.eye(3), [0, 1, 2], [4])
    with pytest.raises(ValueError, match="does not index the 3 vertices"):
        cut_polygons(np.eye(3), [0, 1, 3], [3])
