import numpy as np
import pytest

from nilbs.geometry.distance import closest_points
from nilbs.geometry.sampling import element_samples, facet_samples, near_surface_samples, uniform_samples

N = 20_000


def surface(d: int) -> tuple[np.ndarray, np.ndarray]:
    """Two facets of measure 1 and 3, and one of none."""
    if d == 2:
        return np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 3.0]]), np.array([[0, 0], [0, 1], [1, 2], [2, 2]])
    V = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 6.0]])
    return V, np.array([[0, 0, 1], [0, 1, 2], [0, 2, 3], [3, 3, 3]])


def volume(d: int) -> tuple[np.ndarray, np.ndarray]:
    """Two elements of measure 1 : 3, the first turned inside out."""
    V = np.concatenate([np.zeros((1, d)), np.eye(d), -3 * np.eye(d)[:1]])
    first = np.arange(d + 1)
    second = np.concatenate([[0, d + 1], np.arange(2, d + 1)])
    return V, np.array([first[::-1], second])


@pytest.mark.parametrize("d", [2, 3])
def test_a_box_is_filled_evenly(d: int, rng: np.random.Generator) -> None:
    lower, upper = np.array([-1.0, 2.0, 0.0])[:d], np.array([1.0, 3.0, 0.5])[:d]
    x = uniform_samples(lower, upper, N, rng=rng)
    assert x.shape == (N, d)
    assert ((x >= lower) & (x <= upper)).all()
    np.testing.assert_allclose(x.mean(axis=0), (lower + upper) / 2, atol=0.02)
    np.testing.assert_allclose(x.var(axis=0), (upper - lower) ** 2 / 12, rtol=0.05)


@pytest.mark.parametrize("d", [2, 3])
def test_facets_are_drawn_by_area(d: int, rng: np.random.Generator) -> None:
    V, F = surface(d)
    x, facet = facet_samples(V, F, N, rng=rng)
    np.testing.assert_allclose(np.bincount(facet, minlength=4) / N, [0, 0.25, 0.75, 0], atol=0.015)
    for f in (1, 2):
        mine = x[facet == f]
        np.testing.assert_allclose(closest_points(V, F[[f]], mine)[0], 0, atol=1e-12)
        np.testing.assert_allclose(mine.mean(axis=0), V[F[f]].mean(axis=0), atol=0.1)


class Extreme(np.random.Generator):
    """A generator that always draws one end of its range."""

    value = 0.0

    def random(self, size: int) -> np.ndarray:  # type: ignore[override]
        return np.full(size, self.value)


@pytest.mark.parametrize(("value", "facet"), [(0.0, 1), (np.nextafter(1, 0), 2)])
def test_extreme_random_numbers_hit_no_facet_without_area(value: float, facet: int) -> None:
    rng = Extreme(np.random.PCG64(0))
    rng.value = value
    _, drawn = facet_samples(*surface(2), 3, rng=rng)
    np.testing.assert_array_equal(drawn, facet)


def test_a_triangle_is_filled_evenly(rng: np.random.Generator) -> None:
    x, _ = facet_samples([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], N, rng=rng)
    # A quarter of the area lies in each of the four triangles between the middles of the edges.
    parts = [x[:, 0] > 0.5, x[:, 1] > 0.5, x[:, 0] + x[:, 1] < 0.5]
    np.testing.assert_allclose([part.mean() for part in parts], 0.25, atol=0.015)


@pytest.mark.parametrize("d", [2, 3])
def test_elements_are_drawn_by_volume_whatever_their_orientation(d: int, rng: np.random.Generator) -> None:
    V, T = volume(d)
    x, element, barycentric = element_samples(V, T, N, rng=rng)
    np.testing.assert_allclose(np.bincount(element) / N, [0.25, 0.75], atol=0.015)
    np.testing.assert_allclose(barycentric.sum(axis=1), 1, atol=1e-14)
    assert (barycentric >= 0).all()
    np.testing.assert_allclose(x, [w @ V[T[e]] for w, e in zip(barycentric, element, strict=True)], atol=1e-14)
    # The mean of a simplex's barycentric coordinates, and their variance, where the points fill it evenly.
    np.testing.assert_allclose(barycentric.mean(axis=0), 1 / (d + 1), atol=0.01)
    np.testing.assert_allclose(barycentric.var(axis=0), d / ((d + 1) ** 2 * (d + 2)), rtol=0.06)


@pytest.mark.parametrize("d", [2, 3])
def test_noise_has_its_standard_deviation(d: int, rng: np.random.Generator) -> None:
    V = 1e4 * np.eye(d)
    x = near_surface_samples(V, np.arange(d)[None], N, std=0.5, rng=rng)
    off = (x - V[0]) @ np.ones(d) / np.sqrt(d)
    np.testing.assert_allclose([off.mean(), off.std()], [0, 0.5], atol=0.02)
    x = near_surface_samples(V, np.arange(d)[None], 10, std=0.0, rng=rng)
    np.testing.assert_allclose(closest_points(V, np.arange(d)[None], x)[0], 0, atol=1e-8)


def test_one_seed_gives_one_answer() -> None:
    V, F = surface(3)
    first, second, other = (near_surface_samples(V, F, 5, std=1.0, rng=np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("d", [2, 3])
def test_zero_points_of_any_mesh(d: int, rng: np.random.Generator) -> None:
    V, F, T = np.empty((0, d)), np.empty((0, d), dtype=int), np.empty((0, d + 1), dtype=int)
    assert uniform_samples(np.zeros(d), np.ones(d), 0, rng=rng).shape == (0, d)
    assert [a.shape for a in facet_samples(V, F, 0, rng=rng)] == [(0, d), (0,)]
    assert [a.shape for a in element_samples(V, T, 0, rng=rng)] == [(0, d), (0,), (0, d + 1)]
    assert near_surface_samples(V, F, 0, std=1.0, rng=rng).shape == (0, d)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_to_sample_is_an_error(d: int, rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="cannot sample a surface of no extent"):
        facet_samples(np.ones((d, d)), np.arange(d)[None], 3, rng=rng)
    with pytest.raises(ValueError, match="cannot sample a volume mesh of no extent"):
        element_samples(np.empty((0, d)), np.empty((0, d + 1), dtype=int), 3, rng=rng)


def test_wrong_arguments_are_named(rng: np.random.Generator) -> None:
    V, F = surface(2)
    with pytest.raises(ValueError, match="upper must not be below lower"):
        uniform_samples([0, 0], [1, -1], 3, rng=rng)
    with pytest.raises(ValueError, match=r"upper must be \(d,\) = \(2,\)"):
        uniform_samples([0, 0], [1, 1, 1], 3, rng=rng)
    with pytest.raises(ValueError, match="n must not be negative"):
        uniform_samples([0, 0], [1, 1], -1, rng=rng)
    with pytest.raises(ValueError, match="n must not be negative"):
        facet_samples(V, F, -1, rng=rng)
    for std in (-1.0, np.nan):
        with pytest.raises(ValueError, match="std must not be negative"):
            near_surface_samples(V, F, 3, std=std, rng=rng)
    with pytest.raises(ValueError, match=r"T.*does not index"):
        element_samples(V, [[0, 1, 9]], 3, rng=rng)
