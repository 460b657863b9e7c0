from collections.abc import Callable

import numpy as np
import pytest

from nilbs.geometry.copyleft import tetrahedra
from nilbs.geometry.diagnosis import enclosed_volume, solid_defects
from nilbs.geometry.domain import Domain, blocks, volume_domain, welded
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.winding import occupancy

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_F = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SQUARE, SQUARE_T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
NOWHERE = np.zeros((0, 3))
WRAPPED = "the mesh is not a clean solid ({}): weights are solved in a volume wrapped around it"


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few elements and coarse wraps, for speed: nothing tested here depends on their number."""
    monkeypatch.setattr("nilbs.geometry.domain.SPACING", 0.08)
    monkeypatch.setattr("nilbs.geometry.domain.ELEMENTS", 2000)
    monkeypatch.setattr("nilbs.geometry.domain.RESOLUTIONS", (36, 24))
    monkeypatch.setattr("nilbs.geometry.domain.BLOCKS", 20)


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], list[int]]:
    """Make TetGen refuse the first surfaces; return a list of the sizes of all surfaces that it gets."""

    fill = tetrahedra.conforming_tetrahedra

    def arrange(times: int) -> list[int]:
        sizes: list[int] = []

        def refusing(V: np.ndarray, F: np.ndarray, *rest: object, **options: float) -> tuple[np.ndarray, np.ndarray]:
            sizes.append(len(F))
            if len(sizes) <= times:
                raise ValueError("TetGen could not fill the surface")
            return fill(V, F, *rest, **options)

        monkeypatch.setattr(tetrahedra, "conforming_tetrahedra", refusing)
        return sizes

    return arrange


def ball(cells: int = 20) -> tuple[np.ndarray, np.ndarray]:
    grid = Grid.cube(np.array([[-1.0] * 3, [1.0] * 3]), cells)
    return isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)


def assert_sound(domain: Domain) -> float:
    """Check what holds for every domain; return its volume."""
    volumes = element_volumes(domain.V, domain.T)
    assert volumes.min() > 0
    assert set(np.unique(boundary_facets(domain.T))) <= set(range(domain.surface))
    return float(volumes.sum())


def turned(F: np.ndarray) -> set[tuple[int, ...]]:
    """Facets with the smallest index first, so that only their direction is left."""
    return {tuple(np.roll(facet, -int(np.argmin(facet))).tolist()) for facet in F}


def test_a_clean_solid_is_kept_as_it_is_and_holds_the_points_inside() -> None:
    V, F = ball()
    inside = np.array([[0.2, 0.3, 0.4], [0.1, -0.2, 0.0]])
    outside, on_the_skin = np.array([[1.5, 0.5, 0.5]]), V[F].mean(axis=1)[:1] * 0.9995
    domain = volume_domain(V, F, np.concatenate([outside, inside, on_the_skin]))
    n = len(V)
    assert domain.notes == ()
    assert domain.surface == n
    np.testing.assert_allclose(domain.V[:n], V, atol=1e-8)
    np.testing.assert_allclose(domain.V[n : n + 2], inside, atol=1e-8)
    assert set(range(n + 2)) <= set(domain.T.ravel().tolist())
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F))
    assert turned(boundary_facets(domain.T)) == turned(F)
    for point in np.concatenate([outside, on_the_skin]):
        assert np.linalg.norm(domain.V - point, axis=1).min() > 1e-4


def test_a_surface_of_few_triangles_is_refined() -> None:
    domain = volume_domain(CUBE, CUBE_F, np.array([[0.5, 0.5, 0.5]]))
    assert domain.notes == ()
    np.testing.assert_allclose(domain.V[:8], CUBE, atol=1e-8)
    assert assert_sound(domain) == pytest.approx(1)
    skin = domain.V[boundary_facets(domain.T)]
    assert np.linalg.norm(skin - np.roll(skin, 1, axis=1), axis=2).max() < 0.1 * np.sqrt(3)
    # Bulky bodies have larger elements, so that no body has too many.
    assert len(domain.V) < 20_000


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e5)])
def test_neither_unit_nor_place_changes_the_volume(scale: float, shift: float) -> None:
    V, F = ball()
    points = np.array([[0.1, 0.2, 0.3]])
    domain = volume_domain(V, F, points)
    there = volume_domain(scale * V + shift, F, scale * points + shift)
    assert assert_sound(Domain((there.V - shift) / scale, there.T, there.surface, ())) == pytest.approx(
        assert_sound(domain), rel=1e-6
    )
    n = len(V) + 1
    np.testing.assert_allclose((there.V[:n] - shift) / scale, domain.V[:n], atol=1e-8)


def test_a_surface_cut_along_seams_is_sewn_and_vertices_without_a_face_are_left_out() -> None:
    V, F = ball()
    soup, corners = V[F.ravel()], np.arange(3 * len(F)).reshape(-1, 3)
    domain = volume_domain(np.concatenate([[[9.0, 9, 9]], soup]), corners + 1, NOWHERE)
    assert domain.notes == ()
    assert domain.surface == len(V)
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F))


def test_facets_that_face_the_wrong_way_are_no_defect(rng: np.random.Generator) -> None:
    V, F = ball()
    flipped = F.copy()
    which = rng.permutation(len(F))[: len(F) // 20]
    flipped[which] = flipped[which, ::-1]
    domain = volume_domain(V, flipped, NOWHERE)
    assert domain.notes == ()
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F))


def test_a_large_clean_surface_is_decimated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nilbs.geometry.domain.SURFACE_LIMIT", 300)
    monkeypatch.setattr("nilbs.geometry.domain.DECIMATED", 400)
    monkeypatch.setattr("nilbs.geometry.domain.FEW_POINTS", 0)
    V, F = ball(20)
    domain = volume_domain(V, F, NOWHERE)
    assert domain.notes == ("the surface is large: weights are solved inside one with 400 triangles",)
    assert domain.surface < 300
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F), rel=0.03)


def test_few_points_need_fewer_triangles_and_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nilbs.geometry.domain.SURFACE_LIMIT", 300)
    monkeypatch.setattr("nilbs.geometry.domain.DECIMATED", 800)
    monkeypatch.setattr("nilbs.geometry.domain.FEW_POINTS", 3)
    V, F = ball(20)
    points = np.array([[0.1, 0.2, 0.0], [0.2, 0.0, -0.3], [-0.3, 0.1, 0.1]])
    # Without a point the weights are given, and may be steep anywhere.
    none, few, many = (volume_domain(V, F, points[:count]) for count in (0, 2, 3))
    for domain, facets in ((none, 800), (few, 320), (many, 800)):
        assert domain.notes == (f"the surface is large: weights are solved inside one with {facets} triangles",)
        assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F), rel=0.06)
    assert len(few.T) < 0.5 * len(many.T)


def test_a_surface_with_a_hole_is_wrapped() -> None:
    V, F = ball()
    point = np.array([[0.1, 0.0, 0.2]])
    domain = volume_domain(V, F[V[F].mean(axis=1)[:, 2] < 0.8], point)
    assert domain.notes == (WRAPPED.format("1 hole"),)
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F), rel=0.1)
    # The wrap is a clean solid and holds the point.
    assert not solid_defects(domain.V, boundary_facets(domain.T))
    assert np.linalg.norm(domain.V - point, axis=1).min() < 1e-8


def test_two_bodies_that_cross_are_wrapped_into_one() -> None:
    V, F = np.concatenate([CUBE, CUBE + np.array([0.5, 0.31, 0.42])]), np.concatenate([CUBE_F, CUBE_F + 8])
    domain = volume_domain(V, F, NOWHERE)
    assert "self-intersection" in domain.notes[0]
    assert assert_sound(domain) == pytest.approx(2 - 0.5 * 0.69 * 0.58, rel=0.05)


def test_every_fallback(refuse: Callable[[int], list[int]], monkeypatch) -> None:
    monkeypatch.setattr("nilbs.geometry.domain.SURFACE_LIMIT", 10)
    monkeypatch.setattr("nilbs.geometry.domain.DECIMATED", 500)
    monkeypatch.setattr("nilbs.geometry.domain.FEW_POINTS", 0)
    V, F = ball(20)
    true = enclosed_volume(V, F)
    notes = (
        "the surface is large: weights are solved inside one with 500 triangles",
        WRAPPED.format("it could not be filled"),
        "a coarser wrap was needed",
        "no finer volume could be filled: weights are solved in blocks",
    )
    # The decimated surface; a wrap; a coarser one; blocks.
    for times in range(4):
        sizes = refuse(times)
        domain = volume_domain(V, F, np.array([[0.0, 0.1, 0.2]]))
        assert domain.notes == notes[: times + 1]
        assert sizes == [500] * min(times + 1, 3)
        assert assert_sound(domain) == pytest.approx(true, rel=0.6 if times == 3 else 0.15)
    # Blocks hold all of the surface.
    assert occupancy(domain.V, boundary_facets(domain.T), V).all()


def test_a_volume_with_slivers_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    fill, times = tetrahedra.conforming_tetrahedra, []

    def flattening(*given: np.ndarray, **options: float) -> tuple[np.ndarray, np.ndarray]:
        V_volume, T = fill(*given, **options)
        times.append(len(T))
        return (V_volume, np.concatenate([T, T[:1, [0, 1, 2, 2]]])) if len(times) == 1 else (V_volume, T)

    monkeypatch.setattr(tetrahedra, "conforming_tetrahedra", flattening)
    domain = volume_domain(*ball(), NOWHERE)
    assert domain.notes == (WRAPPED.format("it could not be filled"),)
    assert_sound(domain)


@pytest.mark.parametrize("which", [slice(None), slice(3, 5)])
def test_a_solid_that_faces_inward_is_turned(which: slice) -> None:
    F = CUBE_F.copy()
    F[which] = F[which, ::-1]
    domain = volume_domain(CUBE, F, NOWHERE)
    assert domain.notes == ()
    assert assert_sound(domain) == pytest.approx(1)


def test_a_clean_solid_that_cannot_be_filled_is_wrapped(refuse: Callable[[int], list[int]]) -> None:
    V, F = ball()
    sizes = refuse(1)
    domain = volume_domain(V, F, NOWHERE)
    assert sizes[0] == len(F)
    assert assert_sound(domain) == pytest.approx(enclosed_volume(V, F), rel=0.1)


def test_a_flat_mesh_is_refined_as_it_is() -> None:
    points = np.array([[0.2, 0.3], [0.6, 0.7], [3.0, 3.0]])
    domain = volume_domain(SQUARE, SQUARE_T, points)
    assert domain.notes == ()
    assert domain.surface == 4
    np.testing.assert_allclose(domain.V[:4], SQUARE, atol=1e-12)
    np.testing.assert_allclose(domain.V[4:6], points[:2], atol=1e-12)
    assert element_volumes(domain.V, domain.T).min() > 0
    assert element_volumes(domain.V, domain.T).sum() == pytest.approx(1)


@pytest.mark.parametrize("again", [SQUARE_T, SQUARE_T[:, ::-1], SQUARE_T[:1, ::-1]])
def test_repeated_flat_triangles_count_once(again: np.ndarray) -> None:
    for T in (np.concatenate([SQUARE_T, again]), np.concatenate([again, SQUARE_T])):
        domain = volume_domain(SQUARE, T, NOWHERE[:, :2])
        assert element_volumes(domain.V, domain.T).sum() == pytest.approx(1)


def test_flat_triangles_without_shared_corners_are_joined() -> None:
    domain = volume_domain(SQUARE[SQUARE_T.ravel()], np.arange(6).reshape(2, 3), NOWHERE[:, :2])
    assert domain.surface == 4
    outline = domain.V[boundary_facets(domain.T)]
    assert (np.isclose(outline, 0) | np.isclose(outline, 1)).any(axis=2).all()


@pytest.mark.parametrize(
    ("V", "E", "message"),
    [
        (CUBE, CUBE_F[:0], "^the mesh has no triangle$"),
        (CUBE, [[0, 1, 8]], r"^E\[0\] = \[0, 1, 8\] does not index the 8 vertices$"),
        (np.ones((4, 3)), [[0, 1, 2], [1, 2, 3]], "^no triangle of the mesh has any area$"),
        (CUBE * [1, 0, 0], CUBE_F, "^no triangle of the mesh has any area$"),
        (CUBE, CUBE_F[:, [0, 1, 1]], "^no triangle of the mesh has any area$"),
        (SQUARE * [1, 0], SQUARE_T, "^no triangle of the mesh has any area$"),
        (SQUARE, SQUARE_T[:, [0, 0, 2]], "^no triangle of the mesh has any area$"),
        (np.full((8, 3), np.nan), CUBE_F, r"^V\[0, 0\] is nan"),
    ],
)
def test_a_mesh_without_inside_and_surface_is_refused(V: np.ndarray, E: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        volume_domain(V, E, np.zeros((0, V.shape[1])))


def test_points_of_another_dimension_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^points must be \(s, d\)"):
        volume_domain(CUBE, CUBE_F, NOWHERE[:, :2])


def test_vertices_in_one_place_become_one_in_their_order(rng: np.random.Generator) -> None:
    V, F = ball()
    again = np.concatenate([V + 1e-9 * rng.uniform(-1, 1, V.shape), V])
    upper = rng.random(F.shape) < 0.5
    order = np.unique(np.where(upper, F + len(V), F))
    joined, E = welded(again, np.where(upper, F + len(V), F), tolerance=1e-6)
    assert len(joined) == len(V)
    np.testing.assert_allclose(joined[E], V[F], atol=1e-8)
    # The first that is used of each stays, and they stay in order.
    first = {int(v) % len(V): None for v in order}
    np.testing.assert_array_equal(joined, again[[next(int(v) for v in order if v % len(V) == k) for k in first]])


@pytest.mark.parametrize(
    ("E", "left"),
    [
        ([[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [0, 1, 3]]),
        ([[0, 1, 2], [1, 2, 0], [0, 1, 3]], [[0, 1, 2], [0, 1, 3]]),  # twice the same way
        ([[0, 1, 2], [2, 1, 0], [0, 1, 3]], [[0, 1, 2], [0, 1, 3]]),  # and the other way
        ([[2, 1, 0], [0, 1, 2], [1, 2, 0], [3, 1, 0]], [[2, 1, 0], [3, 1, 0]]),
        ([[0, 1, 1], [2, 2, 2], [3, 1, 0]], [[2, 1, 0]]),  # collapsed
        ([[0, 4, 2], [0, 1, 4]], [[0, 1, 2]]),  # collapsed, because corners 1 and 4 lie in one place
        ([], []),
    ],
)
def test_the_first_of_faces_with_the_same_vertices_stays(E: list, left: list) -> None:
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
    joined, found = welded(V, np.array(E, dtype=int).reshape(-1, 3))
    assert len(joined) == len(np.unique(found))
    assert len(found) == len(left)
    assert turned(found) == turned(np.array(left))


def test_edges_are_welded_too() -> None:
    V, E = welded([[0, 0], [1, 0], [1, 0], [2, 0], [9, 9]], [[0, 1], [2, 3], [3, 2], [1, 2], [1, 0], [0, 2]])
    assert V.tolist() == [[0, 0], [1, 0], [2, 0]]
    assert E.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize("shape", [(4, 5, 6), (3, 3, 7)])
def test_blocks_fill_every_cell_with_a_corner_inside(shape: tuple[int, int, int], rng: np.random.Generator) -> None:
    levels = rng.uniform(-1, 6, shape)
    V, T = blocks(Grid(np.array([1.0, 2, 3]), 0.5, shape), levels)
    cells = sum(
        (levels[i : i + 2, j : j + 2, k : k + 2] < 0).any()
        for i in range(shape[0] - 1)
        for j in range(shape[1] - 1)
        for k in range(shape[2] - 1)
    )
    assert len(T) == 6 * cells
    np.testing.assert_allclose(element_volumes(V, T), 0.5**3 / 6)
    # Neighbours agree on the diagonals of the sides that they share: no facet inside is left over.
    F = boundary_facets(T)
    assert np.unique(F).tolist() == list(range(len(np.unique(F))))
    assert enclosed_volume(V, F) == pytest.approx(cells * 0.5**3)
    outside = V[F] - [1, 2, 3]
    assert (np.ptp(outside, axis=1).min(axis=1) < 1e-12).all()


def test_no_blocks() -> None:
    V, T = blocks(Grid(np.zeros(3), 1.0, (3, 3, 3)), np.ones((3, 3, 3)))
    assert (V.shape, T.shape) == ((0, 3), (0, 4))
