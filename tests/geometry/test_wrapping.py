import numpy as np
import pytest

from nilbs.geometry.diagnosis import enclosed_volume, solid_defects, surface_report
from nilbs.geometry.distance import closest_points
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.winding import occupancy
from nilbs.geometry.wrapping import wrap, wrapping_surface

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_F = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SHEET, SHEET_F = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])


def box(d: int, size: list[float]) -> tuple[np.ndarray, np.ndarray]:
    if d == 3:
        return CUBE * size, CUBE_F
    return SHEET[:, :2] * size[:2], np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


def ball(d: int, cells: int = 24) -> tuple[np.ndarray, np.ndarray]:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), cells)
    return isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)


def wrapped(V: np.ndarray, F: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """A wrap, after the checks that hold for all: it is a clean solid and contains the surface."""
    V_wrap, F_wrap = wrapping_surface(V, F, resolution=resolution)
    assert solid_defects(V_wrap, F_wrap) == []
    cell = np.ptp(V, axis=0).max() / resolution
    # Except over holes, it is no further from the surface than its own thickness.
    lower, upper = V.min(axis=0) - 1.1 * cell, V.max(axis=0) + 1.1 * cell
    assert (V_wrap >= lower).all()
    assert (V_wrap <= upper).all()
    return V_wrap, F_wrap


def turned(V: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    q = np.linalg.qr(rng.normal(size=(V.shape[1],) * 2))[0]
    q[:, 0] *= np.linalg.det(q)
    return V @ q


@DIMENSIONS
@pytest.mark.parametrize("resolution", [24, 48])
def test_a_solid_keeps_its_shape(d: int, resolution: int, rng: np.random.Generator) -> None:
    V, F = ball(d)
    V = turned(V, rng) * np.array([1.0, 0.7, 0.5])[:d]
    V_wrap, F_wrap = wrapped(V, F, resolution)
    assert np.ptp(V, axis=0).max() / resolution > 2 * np.abs(closest_points(V, F, V_wrap)[0]).max()
    # The blur removes a little at convex places, less than a cell everywhere.
    true, cell = enclosed_volume(V, F), np.ptp(V, axis=0).max() / resolution
    area = d * true / 0.5
    assert true - 0.3 * cell * area < enclosed_volume(V_wrap, F_wrap) < true


@DIMENSIONS
def test_levels_are_distances_near_flat_places_and_right_in_sign(d: int, rng: np.random.Generator) -> None:
    V, F = box(d, [1, 0.8, 0.6])
    grid, levels = wrap(V, F, resolution=40)
    x = grid.points()
    values = levels.ravel()
    # In the middle of a side, some cells from its edges.
    middle = np.abs(x[:, 1] - 0.4) < 0.2
    if d == 3:
        middle &= np.abs(x[:, 2] - 0.3) < 0.1
    middle &= np.abs(x[:, 0]) < 2 / 40
    assert middle.sum() > 20
    np.testing.assert_allclose(values[middle], -x[middle, 0], atol=0.1 / 40)
    clear = closest_points(V, F, x)[0] > 1.5 / 40
    np.testing.assert_array_equal(values[clear] < 0, occupancy(V, F, x[clear]))


@pytest.mark.parametrize("resolution", [23, 24, 48])
@pytest.mark.parametrize("tilted", [False, True])
def test_a_sheet_becomes_a_plate(resolution: int, tilted: bool, rng: np.random.Generator) -> None:
    V = turned(SHEET, rng) if tilted else SHEET
    V_wrap, F_wrap = wrapped(V, SHEET_F, resolution)
    report = surface_report(V_wrap, F_wrap)
    assert report.components == 1
    # Half a cell to a cell on either side, whose area is 1.
    cell = np.ptp(V, axis=0).max() / resolution
    assert cell < report.volume < 2.5 * cell
    assert closest_points(V, SHEET_F, V_wrap)[0].max() < 1.1 * cell
    # Every place of the sheet is inside.
    s = np.stack(np.meshgrid(*[np.linspace(0.05, 0.95, 30)] * 2), axis=-1).reshape(-1, 2)
    assert occupancy(V_wrap, F_wrap, V[0] + s @ (V[[1, 3]] - V[0])).all()


def test_an_open_curve_becomes_a_band() -> None:
    V, F = box(2, [1, 1])
    V_wrap, F_wrap = wrapped(V, F[1:2], 48)
    assert surface_report(V_wrap, F_wrap).components == 1
    assert 1 / 48 < enclosed_volume(V_wrap, F_wrap) < 2.5 / 48


@pytest.mark.parametrize("resolution", [24, 48])
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("thickness", [0.001, 0.005, 0.01, 0.02, 0.04])
def test_a_plate_of_any_thickness_stays_in_one_piece(
    thickness: float, tilted: bool, resolution: int, rng: np.random.Generator
) -> None:
    # Thinner than a cell, a plate may or may not hold nodes of the grid.
    V, F = box(3, [1, 0.7, thickness])
    V_wrap, F_wrap = wrapped(turned(V, rng) if tilted else V, F, resolution)
    report = surface_report(V_wrap, F_wrap)
    assert report.components == 1
    assert 0.5 * 0.7 * thickness < report.volume < 0.7 * (thickness + 2.5 / resolution)


@DIMENSIONS
def test_two_boxes_close_together_stay_apart(d: int) -> None:
    V, F = box(d, [1, 0.9, 0.8])
    apart = np.array([1 + 2.5 * 2 / 60, 0, 0])[:d]
    V_wrap, F_wrap = wrapped(np.concatenate([V, V + apart]), np.concatenate([F, F + len(V)]), 60)
    assert surface_report(V_wrap, F_wrap).components == 2
    assert enclosed_volume(V_wrap, F_wrap) == pytest.approx(2 * enclosed_volume(V, F), rel=0.05)


@DIMENSIONS
def test_boxes_that_cross_become_one(d: int) -> None:
    V, F = box(d, [1, 0.9, 0.8])
    V_wrap, F_wrap = wrapped(np.concatenate([V, V + 0.2]), np.concatenate([F, F + len(V)]), 60)
    assert surface_report(V_wrap, F_wrap).components == 1
    common = np.prod(np.array([0.8, 0.7, 0.6])[:d])
    assert enclosed_volume(V_wrap, F_wrap) == pytest.approx(2 * enclosed_volume(V, F) - common, rel=0.03)


@pytest.mark.parametrize("height", [0.85, 0.6])
def test_a_hole_in_a_ball_is_closed(height: float) -> None:
    V, F = ball(3)
    V_wrap, F_wrap = wrapped(V, F[V[F].mean(axis=1)[:, 2] < height], 40)
    report = surface_report(V_wrap, F_wrap)
    assert report.components == 1
    # The lid over the hole is where the winding number is one half: between the boundary edges' plane and the ball.
    cap = np.pi * (0.9 - height) ** 2 * (3 * 0.9 - (0.9 - height)) / 3
    whole = enclosed_volume(V, F)
    assert 0.97 * (whole - cap) < report.volume < whole


def test_flipped_doubled_and_degenerate_facets_do_no_harm(rng: np.random.Generator) -> None:
    V, F = ball(3, 16)
    clean = wrapping_surface(V, F, resolution=30)
    for damaged in (np.concatenate([F, F[:1, [0, 0, 1]], F[:1, [2, 2, 2]]]), F[:, ::-1], F[rng.permutation(len(F))]):
        V_wrap, F_wrap = wrapped(V, damaged, 30)
        assert enclosed_volume(V_wrap, F_wrap) == pytest.approx(enclosed_volume(*clean), rel=1e-3)
    extra = np.concatenate([F, F[rng.permutation(len(F))[:40]]])
    assert enclosed_volume(*wrapped(V, extra, 30)) == pytest.approx(enclosed_volume(*clean), rel=0.02)


def test_vertices_that_no_facet_uses_do_not_count() -> None:
    V, F = ball(3, 12)
    far = np.concatenate([V, [[99.0, 99, 99]]])
    for a, b in zip(wrapping_surface(far, F, resolution=20), wrapping_surface(V, F, resolution=20), strict=True):
        np.testing.assert_array_equal(a, b)


@DIMENSIONS
@pytest.mark.parametrize(("scale", "shift"), [(2.0**-20, 0.0), (2.0**20, 0.0), (1.0, 2.0**10)])
def test_neither_unit_nor_place_changes_the_wrap(d: int, scale: float, shift: float) -> None:
    V, F = ball(d, 12)
    F = F[3:]
    V_wrap, F_wrap = wrapping_surface(V, F, resolution=24)
    V_there, F_there = wrapping_surface(scale * V + shift, F, resolution=24)
    np.testing.assert_array_equal(F_there, F_wrap)
    np.testing.assert_allclose((V_there - shift) / scale, V_wrap, atol=1e-6)


def test_wrong_arguments_are_refused() -> None:
    for call in (wrap, wrapping_surface):
        with pytest.raises(ValueError, match=r"^F is empty: there is nothing to wrap$"):
            call(SHEET, SHEET_F[:0])
        with pytest.raises(ValueError, match=r"^F\[0\] = \[0, 1, 4\] does not index the 4 vertices$"):
            call(SHEET, [[0, 1, 4]])
        with pytest.raises(ValueError, match=r"^V\[0, 0\] is nan"):
            call(SHEET * np.nan, SHEET_F)
        with pytest.raises(ValueError):
            call(np.ones((3, 3)), [[0, 1, 2]])
