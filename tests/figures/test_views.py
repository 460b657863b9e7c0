"""Views and sections: orthonormal axes, pixels where they should be, and cuts against closed forms."""

import numpy as np
import pytest

from nilbs.figures.views import Section, View


@pytest.mark.parametrize("extent", [(1, 2, 3), (3, 2, 1), (2, 1, 3), (1, 1, 1)])
def test_front_view_is_a_rotation_along_the_thinnest_extent(extent):
    V = np.vstack([np.zeros(3), extent])
    for view in (View.front(V), View.front(V).turned()):
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.axes) == pytest.approx(1)
    assert View.front(V).axes[2][np.argmin(extent)] == 1


def test_turned_view_looks_down_from_the_right():
    view = View(np.eye(3)).turned(azimuth=30, elevation=18)
    assert view.axes[2] @ [0, 0, 1] == pytest.approx(np.cos(np.radians(30)) * np.cos(np.radians(18)))
    assert view.axes[2][0] > 0
    assert view.axes[2][1] > 0
    assert view.project(np.array([0.0, 1.0, 0.0]))[0] == pytest.approx(0)  # what was upright stays upright


def test_in_the_plane_a_view_changes_nothing(rng):
    V = rng.normal(size=(20, 2))
    view = View.front(V).turned()
    np.testing.assert_array_equal(view.project(V), V)


@pytest.mark.parametrize("d", [2, 3])
def test_window_is_a_square_around_all_points(d, rng):
    V = rng.normal(size=(50, d))
    view = View.front(V)
    lower, upper = view.window(V, V + 1)
    assert np.ptp(upper - lower) == pytest.approx(0)
    both = view.project(np.vstack([V, V + 1]))
    assert (both > lower).all()
    assert (both < upper).all()


@pytest.mark.parametrize("d", [2, 3])
def test_points_fill_the_extent_and_rows_start_at_the_bottom_left(d, rng):
    V = rng.normal(size=(50, d))
    view = View.front(V)
    section = Section.through(view, V, pixels=11)
    flat = section.image(view.project(section.points()))
    half = section.edge / 22
    left, right, bottom, top = section.extent
    np.testing.assert_allclose(flat[0, 0], [left + half, bottom + half])
    np.testing.assert_allclose(flat[-1, 0], [left + half, top - half])
    np.testing.assert_allclose(flat[0, -1], [right - half, bottom + half])
    if d == 3:
        np.testing.assert_allclose(section.points() @ view.axes[2], V.mean(axis=0) @ view.axes[2])


def sphere(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1 from rings of n points, poles included."""
    polar = np.linspace(0, np.pi, n)[:, None]
    around = np.linspace(0, 2 * np.pi, n, endpoint=False)
    V = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around], -1)
    i = np.arange(n * (n - 1)).reshape(n - 1, n)
    j = np.roll(i, -1, axis=1)
    F = np.concatenate([np.stack([i, i + n, j + n], -1).reshape(-1, 3), np.stack([i, j + n, j], -1).reshape(-1, 3)])
    return V.reshape(-1, 3), F


@pytest.mark.parametrize("height", [0.0, 0.6])
def test_cut_through_a_sphere_is_a_circle(height):
    V, F = sphere(100)
    view = View(np.array([[0.6, 0.8, 0], [0, 0, 1.0], [0.8, -0.6, 0]]))
    section = Section(view, height * view.axes[2], 3.0)
    segments = section.cut(V, F)
    radius = np.sqrt(1 - height**2)
    np.testing.assert_allclose(np.linalg.norm(segments, axis=-1), radius, atol=2e-3)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * np.pi * radius, rel=2e-3)
    assert length < 2 * np.pi * radius  # chords


def test_cut_that_misses_is_empty():
    V, F = sphere(10)
    assert Section(View(np.eye(3)), np.array([0, 0, 2.0]), 1.0).cut(V, F).shape == (0, 2, 2)


def test_cut_in_the_plane_is_the_outline_itself(rng):
    U, F = rng.normal(size=(6, 2)), np.array([[0, 1], [1, 2], [4, 5]])
    np.testing.assert_array_equal(Section.through(View.front(U), U).cut(U, F), U[F])
