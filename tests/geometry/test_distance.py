import numpy as np
import pytest

from nilbs.geometry.distance import closest_points, signed_distance


def box(d: int) -> tuple[np.ndarray, np.ndarray]:
    """The cube [-1, 1]^d, outward."""
    if d == 2:
        return np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    V = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return V, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def box_distance(x: np.ndarray) -> np.ndarray:
    """Closed form: the distance of the part outside, or minus the distance to the nearest side."""
    q = np.abs(x) - 1
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


@pytest.mark.parametrize("d", [2, 3])
def test_a_box_has_its_closed_form(d: int, rng: np.random.Generator) -> None:
    V, F = box(d)
    x = rng.uniform(-3, 3, (3000, d))
    np.testing.assert_allclose(signed_distance(V, F, x), box_distance(x), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_closest_points_lie_on_their_facets_at_their_distance(d: int, rng: np.random.Generator) -> None:
    V, F = box(d)
    x = rng.uniform(-3, 3, (500, d))
    distance, facet, point = closest_points(V, F, x)
    assert facet.dtype == np.int64
    np.testing.assert_allclose(np.linalg.norm(x - point, axis=1), distance, atol=1e-14)
    np.testing.assert_allclose(distance, np.abs(box_distance(x)), atol=1e-12)
    alone = [closest_points(V, F[[f]], p[None])[0][0] for f, p in zip(facet, point, strict=True)]
    np.testing.assert_allclose(alone, 0, atol=1e-14)


def test_a_segment_beyond_its_ends() -> None:
    distance, _, point = closest_points([[0, 0], [2, 0]], [[0, 1]], [[-3, 4], [1, 2], [5, -4]])
    np.testing.assert_allclose(distance, [5, 2, 5])
    np.testing.assert_allclose(point, [[0, 0], [1, 0], [2, 0]])


@pytest.mark.parametrize("d", [2, 3])
def test_where_two_boxes_overlap_is_inside_and_unscaled(d: int) -> None:
    V, F = box(d)
    shift = np.eye(d)[0]
    both, facets = np.concatenate([V, V + shift]), np.concatenate([F, F + len(V)])
    # Facets of one box inside the other still count for the length.
    x = np.array([[0.5], [0.1], [-0.5]]) * shift
    np.testing.assert_allclose(signed_distance(both, facets, x), [-0.5, -0.1, -0.5], atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_inside_out_keeps_its_sign(d: int) -> None:
    V, F = box(d)
    np.testing.assert_allclose(signed_distance(V, F[:, ::-1], np.zeros((1, d))), [-1])


@pytest.mark.parametrize("d", [2, 3])
def test_moving_the_world_changes_nothing(d: int, rng: np.random.Generator) -> None:
    V, F = box(d)
    x = rng.uniform(-2, 2, (300, d))
    R, _ = np.linalg.qr(rng.normal(size=(d, d)))
    R[:, 0] *= np.linalg.det(R)
    t = rng.normal(size=d)
    moved = signed_distance(V @ R.T + t, F, x @ R.T + t)
    np.testing.assert_allclose(moved, signed_distance(V, F, x), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_without_facets_everything_is_infinitely_far(d: int) -> None:
    x, F = np.zeros((2, d)), np.empty((0, d), dtype=int)
    distance, facet, point = closest_points(np.empty((0, d)), F, x)
    np.testing.assert_array_equal(distance, [np.inf, np.inf])
    np.testing.assert_array_equal(facet, [-1, -1])
    assert point.shape == (2, d)
    assert np.isnan(point).all()
    np.testing.assert_array_equal(signed_distance(np.empty((0, d)), F, x), [np.inf, np.inf])


@pytest.mark.parametrize("d", [2, 3])
def test_no_points(d: int) -> None:
    V, F = box(d)
    assert [a.shape for a in closest_points(V, F, np.empty((0, d)))] == [(0,), (0,), (0, d)]
    assert signed_distance(V, F, np.empty((0, d))).shape == (0,)


def test_wrong_arguments_are_named() -> None:
    V, F = box(3)
    with pytest.raises(ValueError, match=r"x must be \(p, d\) = .*, got \(4, 2\)"):
        closest_points(V, F, np.zeros((4, 2)))
    with pytest.raises(ValueError, match="does not index the 8 vertices"):
        closest_points(V, F + 1, np.zeros((4, 3)))
