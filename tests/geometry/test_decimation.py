import numpy as np
import pytest

from nilbs.geometry.copyleft.decimation import decimated
from nilbs.geometry.diagnosis import enclosed_volume, solid_defects
from nilbs.geometry.distance import closest_points
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface


def torus(cells: int = 40) -> tuple[np.ndarray, np.ndarray]:
    grid = Grid.box(np.array([[-1.1, -1.1, -0.4], [1.1, 1.1, 0.4]]), cells)
    x = grid.points()
    return isosurface(np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.75, x[:, 2]) - 0.3, grid)


@pytest.mark.parametrize("facets", [2000, 600])
def test_a_surface_with_fewer_triangles_keeps_its_shape_and_topology(facets: int) -> None:
    V, F = torus()
    assert len(F) > 4000
    V_few, F_few = decimated(V, F, facets)
    assert len(F_few) == facets
    assert F_few.dtype == np.int64
    assert not solid_defects(V_few, F_few)
    # A torus has as many vertices as edges less triangles.
    assert len(np.unique(F_few)) == len(V_few) == len(F_few) // 2
    assert closest_points(V, F, V_few)[0].max() < 0.02
    assert enclosed_volume(V_few, F_few) == pytest.approx(2 * np.pi**2 * 0.75 * 0.3**2, rel=0.04)


def test_flat_sides_need_few_triangles() -> None:
    n = 12
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij"))
    F = np.concatenate([np.stack([i, i + n, i + n + 1], axis=1), np.stack([i, i + n + 1, i + 1], axis=1)])
    V_few, F_few = decimated(np.stack([x, y, 0 * x], axis=1), F, 60)
    assert len(F_few) <= 60
    np.testing.assert_allclose(V_few[:, 2], 0, atol=1e-12)
    corners = V_few[F_few]
    assert (
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2 > 0.9
    )


def test_topology_comes_before_the_number_of_triangles() -> None:
    # No edge of two tetrahedra can be collapsed without collapsing one of them.
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    F = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    V_few, F_few = decimated(np.concatenate([V, V + 5]), np.concatenate([F, F + 4]), 2)
    assert len(F_few) == 8
    assert not solid_defects(V_few, F_few)


def test_a_surface_that_has_no_more_is_returned_as_it_is() -> None:
    V, F = torus(12)
    for facets in (len(F), len(F) + 1):
        V_few, F_few = decimated(V, F, facets)
        np.testing.assert_array_equal(V_few, V)
        np.testing.assert_array_equal(F_few, F)
    V_few, F_few = decimated(np.zeros((0, 3)), np.zeros((0, 3)), 0)
    assert (V_few.shape, F_few.shape) == ((0, 3), (0, 3))


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^V must be \(n, 3\).*got \(4, 2\)$"):
        decimated(np.zeros((4, 2)), [[0, 1, 2]], 0)
    with pytest.raises(ValueError, match=r"^F\[0\] = \[0, 1, 4\] does not index the 4 vertices$"):
        decimated(np.zeros((4, 3)), [[0, 1, 4]], 0)
