import numpy as np
import pytest

from nilbs.geometry.diagnosis import enclosed_volume, solid_defects, surface_report

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_F = np.array([triangle for a, b, c, e in SIDES for triangle in ([a, b, c], [a, c, e])])
SQUARE, SQUARE_F = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


def several(*parts):
    """Parts of one surface, each as a scale, an offset and facets of the cube."""
    V = np.concatenate([CUBE * scale + offset for scale, offset, _ in parts])
    return V, np.concatenate([np.asarray(F) + 8 * i for i, (_, _, F) in enumerate(parts)])


def divided():
    """The cube with an edge cut in half on one side, not on the neighbouring side."""
    a, b, c = CUBE_F[0]
    return np.concatenate([CUBE, CUBE[[a, b]].mean(axis=0)[None]]), np.concatenate([CUBE_F[1:], [[a, 8, c], [8, b, c]]])


INWARD = CUBE_F[:, ::-1]


@pytest.mark.parametrize(
    ("V", "F"),
    [
        (SQUARE, SQUARE_F),
        (CUBE, CUBE_F),
        (np.concatenate([CUBE, CUBE[:3] + 9]), CUBE_F),  # isolated vertices do no harm
        (np.concatenate([CUBE, CUBE[:3]]), CUBE_F),
        several((1, 0, CUBE_F), (1, 3, CUBE_F)),
        several((4, 0, CUBE_F), (1, 1, INWARD)),  # a cavity
        several((4, 0, CUBE_F), (1, 1, CUBE_F)),  # a body inside another: winding number 2, inside
        several((9, 0, CUBE_F), (4, 1, INWARD), (1, 2, CUBE_F)),
    ],
)
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_clean_solids(V, F, scale, offset):
    assert solid_defects((V + offset) * scale, F) == []


@pytest.mark.parametrize(
    ("V", "F", "defects"),
    [
        (CUBE, CUBE_F[1:], ["1 hole"]),
        (CUBE, np.delete(CUBE_F, [0, 2], axis=0), ["2 holes"]),
        (CUBE, np.concatenate([CUBE_F[:1, ::-1], CUBE_F[1:]]), ["3 edges where facets disagree"]),
        (CUBE, INWARD, ["1 part inside out"]),
        (CUBE, np.concatenate([CUBE_F, CUBE_F[:1]]), ["3 edges of more than two facets", "1 facet twice"]),
        (CUBE, np.concatenate([CUBE_F, INWARD[:2]]), ["5 edges of more than two facets", "2 facets twice"]),
        (*several((1, 0, CUBE_F), (1, 3, INWARD)), ["1 part inside out"]),
        (*several((4, 0, INWARD), (1, 1, INWARD)), ["2 parts inside out"]),
        (*several((4, 0, CUBE_F), (1, 1, INWARD), (1, 9, INWARD)), ["1 part inside out"]),
        (*several((1, 0, CUBE_F), (1, 1, CUBE_F)), ["1 vertex where parts only touch"]),
        (*several((1, 0, CUBE_F), (0, 3, CUBE_F)), ["12 facets without area"]),
        (*divided(), ["1 hole", "1 T-junction", "2 self-intersections"]),
        (SQUARE, SQUARE_F[1:], ["2 open ends"]),
        (SQUARE, SQUARE_F[:, ::-1], ["1 part inside out"]),
        (SQUARE, [[0, 1], [2, 1], [2, 3], [3, 0]], ["2 vertices where facets disagree"]),
        (np.array([[0.0, 0], [4, 0], [4, 4], [1, -1]]), SQUARE_F, ["1 self-intersection"]),
    ],
)
def test_what_is_wrong(V, F, defects):
    assert solid_defects(V, F) == defects


def test_what_is_wrong_where_bodies_cross():
    V, F = several((1, 0, CUBE_F), (1, 0.5, CUBE_F))
    report = surface_report(V, F)
    assert report.watertight
    assert len(report.intersections) > 5
    assert solid_defects(V, F) == [f"{len(report.intersections)} self-intersections"]


def test_a_search_that_is_given_up(monkeypatch):
    monkeypatch.setattr("nilbs.geometry.intersections._ENOUGH", 1)
    V, F = several((1, 0, CUBE_F), (1, 0.5, CUBE_F))
    assert solid_defects(V, F)[0].startswith("more than ")
    monkeypatch.setattr("nilbs.geometry.intersections._PAIRS_PER_FACET", 0)
    assert solid_defects(CUBE, CUBE_F) == ["too many facets in one place"]


def test_two_cones_that_touch_in_their_tips():
    F = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
    V = np.array([[0.0, 0, 0], [2, -1, -1], [2, 1, -1], [2, 0, 1]])
    V, F = np.concatenate([V, -V[1:]]), np.concatenate([F, np.array([0, 4, 5, 6])[F[:, ::-1]]])
    report = surface_report(V, F)
    assert report.watertight
    assert report.pinched.tolist() == [0]
    assert report.components == 1
    assert "1 vertex where parts only touch" in solid_defects(V, F)


def test_an_open_surface_is_not_pinched():
    assert surface_report(CUBE, CUBE_F[1:]).pinched.tolist() == []
    fans = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5]])
    assert surface_report(np.random.default_rng(0).normal(size=(6, 3)), fans).pinched.tolist() == [0]


def test_the_numbers_of_a_report():
    V = np.concatenate([2 * CUBE, [[9, 9, 9], [0, 0, 0], [0, 0, 1], [0, 0, 3]]])
    F = np.concatenate([CUBE_F[2:], [CUBE_F[5], [8, 9, 10], [9, 10, 11]]])
    r = surface_report(V, F)
    assert (r.d, r.size, r.components, r.watertight) == (3, 9, 1, False)
    # Two holes of two triangles each meet in a corner; a repeated triangle covers one edge of the first hole.
    assert (r.holes, r.open_ridges, r.crowded_ridges) == (1, 3 + 4, 2)
    assert r.duplicate.tolist() == [10]
    assert r.degenerate.tolist() == [12]
    assert r.isolated.tolist() == []
    assert r.seam.tolist() == [0, 9]
    assert r.vertices == 11
    assert surface_report(V, F[:5]).isolated.tolist() == [8, 9, 10, 11]


def test_a_seam_is_no_hole():
    """A cube whose sides share no vertex is closed; one whose corner is moved away is not."""
    corners = np.array(SIDES)
    V = CUBE[corners].reshape(-1, 3)
    F = np.concatenate([[[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]] for i in range(6)])
    split, whole = surface_report(V, F), surface_report(CUBE, CUBE_F)
    assert split.watertight
    assert split.solid_defects() == []
    for name in ("vertices", "components", "holes", "open_ridges", "crowded_ridges", "volume"):
        assert getattr(split, name) == getattr(whole, name)
    assert split.seam.tolist() == list(range(24))
    assert whole.seam.tolist() == []
    V[0] -= 1e-6
    assert surface_report(V, F).open_ridges == 4
    assert len(surface_report(V, F).seam) == 23


def test_a_facet_that_welding_collapses_joins_nothing():
    V = np.concatenate([CUBE, CUBE[:1]])
    report = surface_report(V, np.concatenate([CUBE_F, [[0, 8, 1]]]))
    assert report.watertight
    assert report.degenerate.tolist() == [12]
    assert report.seam.tolist() == [0, 8]


@pytest.mark.parametrize(
    ("name", "vertices", "pieces", "boundary", "crowded"),
    [("fox", 833, 3, 0, 0), ("snake", 567, 1, 0, 0), ("spider", 800, 1, 4, 8), ("dragon", 1783, 17, 6, 4)],
)
def test_creatures_that_are_cut_along_seams(data, name, vertices, pieces, boundary, crowded):
    from nilbs.io import read_bundle

    mesh = read_bundle(data / "creatures" / f"{name}.glb").mesh
    report = surface_report(mesh.V, mesh.E)
    found = (report.vertices, report.components, report.open_ridges, report.crowded_ridges)
    assert found == (vertices, pieces, boundary, crowded)
    assert len(mesh.V) - vertices < len(report.seam) < 2 * (len(mesh.V) - vertices) + 1


@pytest.mark.parametrize("d", [2, 3])
def test_enclosed_volume(d, rng):
    V, F = (SQUARE, SQUARE_F) if d == 2 else (CUBE, CUBE_F)
    A = rng.normal(size=(d, d))
    moved = V @ A.T + 1e3
    assert enclosed_volume(moved, F) == pytest.approx(np.linalg.det(A) * (4 if d == 2 else 1), rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets(d):
    report = surface_report(np.zeros((2, d)), np.zeros((0, d), int))
    assert report.solid_defects() == []
    assert (report.size, report.volume, report.components) == (0, 0, 0)
    assert report.isolated.tolist() == [0, 1]


def test_wrong_arguments():
    with pytest.raises(ValueError, match="does not index the 8 vertices"):
        surface_report(CUBE, [[0, 1, 8]])
    with pytest.raises(ValueError, match="F must be"):
        solid_defects(CUBE, [[0, 1]])
