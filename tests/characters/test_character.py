from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nilbs
from nilbs.characters.character import Character, assemble, in_dimension
from nilbs.geometry.diagnosis import enclosed_volume
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.rotations import rigid_transforms
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.winding import occupancy
from nilbs.io.errors import FileFormatError
from nilbs.io.mesh import write_mesh
from nilbs.io.tgf import write_tgf
from nilbs.io.weights import write_weights

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_F = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SQUARE, SQUARE_T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
JOINTS = np.array([[0.2, 0.5, 0.5], [0.5, 0.5, 0.5], [0.8, 0.6, 0.5]])
NAMES = ("bone0", "bone1")


def skeleton(C: np.ndarray) -> Skeleton:
    return Skeleton(C, [[0, 1], [1, 2]], [-1, 0], NAMES)


def shape(d: int) -> tuple[np.ndarray, np.ndarray, Skeleton]:
    return (SQUARE, SQUARE_T, skeleton(JOINTS[:, :2])) if d == 2 else (CUBE, CUBE_F, skeleton(JOINTS))


def across(V: np.ndarray) -> np.ndarray:
    """Weights of two bones that change evenly from left to right."""
    return np.stack([1 - V[:, 0], V[:, 0]], axis=1)


def assert_sound(c: Character) -> None:
    """What holds of every character."""
    assert element_volumes(c.V_volume, c.T).min() > 0
    for W, V in ((c.W, c.V), (c.W_volume, c.V_volume)):
        assert W.shape == (len(V), len(c.skeleton.BE))
        assert W.min() >= 0
        assert W.max() <= 1 + 1e-15
        np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-12)


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Volumes that are solved in a moment."""
    monkeypatch.setattr("nilbs.geometry.domain.SPACING", 0.06)
    monkeypatch.setattr("nilbs.geometry.domain.ELEMENTS", 6000)
    monkeypatch.setattr("nilbs.geometry.domain.RESOLUTIONS", (48,))


@DIMENSIONS
def test_a_solved_character(d: int, characters) -> None:
    c = characters[d]
    assert_sound(c)
    assert c.d == d
    assert np.ptp(c.V, axis=0).max() == c.L
    assert c.skeleton.names == tuple(f"bone{b}" for b in range(len(c.skeleton.BE)))
    # The mesh is a clean solid, so the volume is its inside, and the weights are the same.
    np.testing.assert_allclose(c.V_volume[: len(c.V)], c.V, atol=1e-7)
    np.testing.assert_allclose(c.W_volume[: len(c.V)], c.W, atol=1e-7)
    assert element_volumes(c.V_volume, c.T).sum() == pytest.approx(enclosed_volume(c.V, c.F), rel=1e-6)
    # The middle of a bone is held by it.
    for bone, (first, second) in enumerate(c.skeleton.C[c.skeleton.BE]):
        nearest = np.linalg.norm(c.V_volume - (first + second) / 2, axis=1).argmin()
        assert c.W_volume[nearest, bone] > 0.9


@DIMENSIONS
def test_a_pose_moves_the_vertices(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    shift = rng.normal(size=d)
    np.testing.assert_allclose(c.skin(np.stack([rigid_transforms(np.eye(d), shift)] * len(c.skeleton.BE))), c.V + shift)
    pose = rigid_transforms(np.eye(d), rng.normal(size=(len(c.skeleton.BE), d)))
    np.testing.assert_array_equal(c.skin(pose), linear_blend_skinning(c.V, c.W, pose))


@DIMENSIONS
@pytest.mark.parametrize("suffix", [".npz", ".dmat"])
def test_files_and_arrays_make_the_same_character(d: int, suffix: str, tmp_path: Path) -> None:
    V, E, bones = shape(d)
    W = across(V)
    write_mesh(tmp_path / "a.obj", V, E)
    write_tgf(tmp_path / "a.tgf", np.pad(bones.C, ((0, 0), (0, 3 - d))), bones.BE)
    write_weights(tmp_path / f"a{suffix}", W)
    c = nilbs.load_character(tmp_path / "a.obj", tmp_path / "a.tgf", tmp_path / f"a{suffix}")
    same = assemble(V, E, bones, W)
    assert (c.name, same.name) == ("a", "character")
    assert c.skeleton.names == same.skeleton.names
    for name, array in c.arrays().items():
        np.testing.assert_allclose(array, same.arrays()[name], atol=1e-12)


@DIMENSIONS
def test_given_weights_are_kept_and_spread_inside(d: int, characters) -> None:
    V, E, bones = shape(2) if d == 2 else (characters[3].V, characters[3].F, skeleton(characters[3].skeleton.C[:3]))
    W = across((V - V.min(axis=0)) / np.ptp(V, axis=0))
    lines: list[str] = []
    c = assemble(V, E, bones, W, report=lines.append)
    assert_sound(c)
    np.testing.assert_allclose(c.W, W, atol=1e-15)
    assert len(c.V_volume) > len(V) + 10
    inside = across((c.V_volume - V.min(axis=0)) / np.ptp(V, axis=0))
    np.testing.assert_allclose(c.W_volume, inside, atol=1e-9)
    assert not lines


def test_weights_outside_the_simplex_are_repaired_with_a_note() -> None:
    W = np.array([[2, 0], [0, 0], [-0.2, 1], [0.3, 0.7]])
    lines: list[str] = []
    c = assemble(*shape(2), W, report=lines.append)
    np.testing.assert_allclose(c.W, [[1, 0], [1, 0], [0, 1], [0.3, 0.7]])
    assert [line.partition(" have ")[2].partition(",")[0] for line in lines] == [
        "weights below zero",
        "weights that do not sum to one (2 to 2): they are normalised",
        "no weight",
    ]
    # Rounding errors are repaired without a note.
    lines.clear()
    c = assemble(*shape(2), np.full((4, 2), 0.5 + 1e-8), report=lines.append)
    np.testing.assert_allclose(c.W.sum(axis=1), 1, atol=1e-15)
    assert not lines


def test_the_volume_of_an_open_surface_with_weights_is_wrapped_around_it() -> None:
    V, F, bones = shape(3)
    c = assemble(V, F[2:], bones, across(V))
    assert_sound(c)
    np.testing.assert_array_equal(c.V, V)
    np.testing.assert_array_equal(c.F, F[2:])
    # The wrap closes the hole, and it has the weights of the surface inside it.
    assert is_watertight(boundary_facets(c.T))
    assert element_volumes(c.V_volume, c.T).sum() == pytest.approx(1, rel=0.1)
    inside = occupancy(CUBE, CUBE_F, c.V_volume)
    assert np.abs(c.W_volume[inside] - across(c.V_volume[inside])).mean() < 0.05


def test_an_open_surface_is_solved_in_a_wrap_with_a_note() -> None:
    V, F, bones = shape(3)
    lines: list[str] = []
    c = assemble(V, F[2:], bones, report=lines.append)
    assert_sound(c)
    np.testing.assert_array_equal(c.F, F[2:])
    assert len(c.V_volume) > len(V)
    assert lines[0].startswith("the mesh is not a clean solid (1 hole): ")
    left, right = c.V[:, 0] == 0, c.V[:, 0] == 1
    assert c.W[left, 0].mean() > 0.6
    assert c.W[right, 1].mean() > 0.6


@DIMENSIONS
def test_a_surface_cut_along_seams_is_joined_and_keeps_its_vertices(d: int, rng: np.random.Generator) -> None:
    """Every triangle with three vertices of its own, some turned: the surface is that of the whole mesh."""
    V, E, bones = shape(d)
    whole = assemble(V, E, bones, across(V))
    split = assemble(V[E].reshape(-1, d), np.arange(E.size).reshape(E.shape), bones, across(V[E].reshape(-1, d)))
    assert len(split.V) == len(split.W) == E.size
    assert is_watertight(split.F)
    assert len(split.F) == len(whole.F)
    assert enclosed_volume(split.V, split.F) == pytest.approx(enclosed_volume(whole.V, whole.F))
    x = rng.uniform(-0.5, 1.5, (200, d))
    np.testing.assert_array_equal(occupancy(split.V, split.F, x), occupancy(whole.V, whole.F, x))


def test_facets_of_different_charts_are_turned_alike() -> None:
    V, F, bones = shape(3)
    corners = V[F].reshape(-1, 3)
    charts = np.arange(F.size).reshape(F.shape)
    charts[:2] = charts[:2, ::-1]  # against those of the other sides, with which they share no vertex
    lines: list[str] = []
    c = assemble(corners, charts, bones, across(corners), report=lines.append)
    assert lines == ["2 of 12 facets faced against their neighbours and were turned"]
    assert is_watertight(c.F)


def test_facets_that_face_the_wrong_way_are_turned_with_a_note() -> None:
    V, F, bones = shape(3)
    turned = F.copy()
    turned[[3, 7]] = turned[[3, 7]][:, ::-1]
    lines: list[str] = []
    c = assemble(V, turned, bones, across(V), report=lines.append)
    assert lines == ["2 of 12 facets faced against their neighbours and were turned"]
    assert {tuple(np.roll(f, -int(f.argmin()))) for f in c.F} == {tuple(np.roll(f, -int(f.argmin()))) for f in F}


def test_triangles_that_turn_the_other_way_or_stand_twice_have_the_same_outline() -> None:
    V, T, bones = shape(2)
    turned = np.concatenate([T[:1], T[1:, ::-1], [[0, 0, 1]]])
    for E in (T, turned, np.concatenate([turned, T[:1], T[1:]])):
        assert sorted(assemble(V, E, bones, np.ones((4, 2))).F.tolist()) == [[0, 1], [1, 2], [2, 3], [3, 0]]


def test_a_flat_mesh_takes_a_flat_rig_of_three_coordinates() -> None:
    flat = Skeleton([[0, 0, 1e-9], [1, 0, 0], [0, 1, 0]], [[0, 1]], [-1], ["a"], [[0, 2]])
    plane = in_dimension(flat, 2)
    np.testing.assert_array_equal(plane.C, flat.C[:, :2])
    for name in ("BE", "P", "forks"):
        np.testing.assert_array_equal(getattr(plane, name), getattr(flat, name))
    assert plane.names == ("a",)
    assert in_dimension(flat, 3) is flat
    assert in_dimension(plane, 2) is plane
    with pytest.raises(ValueError, match=r"^the mesh is flat \(z = 0\) but joint 1 of the rig is not$"):
        in_dimension(Skeleton([[0, 0, 0], [1, 0, 0.5]], [[0, 1]], [-1], ["a"]), 2)
    with pytest.raises(ValueError, match=r"^the mesh has 3 dimensions but the rig has 2$"):
        in_dimension(plane, 3)
    V, T, bones = shape(2)
    lifted = skeleton(np.pad(bones.C, ((0, 0), (0, 1))))
    np.testing.assert_array_equal(assemble(V, T, lifted).W, assemble(V, T, bones).W)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"E": np.zeros((0, 3))}, "^the mesh has no triangle$"),
        ({"E": [[0, 1, 9]]}, r"^E\[0\] = \[0, 1, 9\] does not index the 4 vertices$"),
        ({"V": SQUARE[:, :1]}, r"^V has d = 1; d must be 2 or 3$"),
        (
            {"skeleton": skeleton(JOINTS[:, :2] + 9)},
            r"^the rig lies outside the mesh: the mesh's box runs from \[0.0, 0.0\] to \[1.0, 1.0\], the joints' from",
        ),
        (
            {"W": np.ones((5, 2))},
            "^the weights have 5 rows and 2 columns, but the mesh has 4 vertices and the rig 2 bones",
        ),
        ({"W": np.ones((4, 3))}, "they belong to another mesh or rig$"),
        ({"W": -np.ones((4, 2))}, "^no vertex has any weight: solve for weights instead"),
        ({"W": [[1, 0], [np.nan, 0], [1, 0], [1, 0]]}, r"^W\[1, 0\] is nan"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changes: dict, message: str) -> None:
    V, E, bones = shape(2)
    with pytest.raises(ValueError, match=message):
        assemble(**({"V": V, "E": E, "skeleton": bones, "W": None} | changes))


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    V, E, bones = shape(2)
    C = np.pad(bones.C, ((0, 0), (0, 1)))
    mesh, rig, weights = tmp_path / "a.obj", tmp_path / "a.tgf", tmp_path / "w.npz"
    write_mesh(mesh, V, E)
    write_tgf(rig, C + np.array([9, 0, 0]), bones.BE)
    write_weights(weights, np.ones((7, 2)) / 2)
    with pytest.raises(ValueError, match="the rig lies outside the mesh") as caught:
        nilbs.load_character(mesh, rig)
    assert str(caught.value).startswith(f"{mesh} with {rig}: the rig lies")
    write_tgf(rig, C, bones.BE)
    with pytest.raises(ValueError, match="belong to another mesh or rig") as caught:
        nilbs.load_character(mesh, rig, weights)
    assert str(caught.value).startswith(f"{mesh} with {rig} and {weights}: the weights have 7 rows")
    rig.write_text("1 0 0\n")
    with pytest.raises(FileFormatError):
        nilbs.load_character(mesh, rig)
    with pytest.raises(FileNotFoundError):
        nilbs.load_character(tmp_path / "none.obj", rig)


def test_a_character_is_not_changed_in_place(characters) -> None:
    c = characters[3]
    assert replace(c, name="other").name == "other"
    with pytest.raises(AttributeError):
        c.name = "other"
