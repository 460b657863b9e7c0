from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nilbs.character import assemble, load_character, rig_in_mesh_dimension, solve_weights, volume_mesh
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.io.errors import FileFormatError
from nilbs.io.mesh import write_mesh
from nilbs.io.tgf import write_tgf
from nilbs.io.weights import write_weights

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_F = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SQUARE, SQUARE_T = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
BE = np.array([[0, 1], [1, 2]])


def shape(d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    C = np.array([[0.2, 0.5, 0.5], [0.5, 0.5, 0.5], [0.8, 0.6, 0.5]])[:, :d]
    return (SQUARE, SQUARE_T, C, BE) if d == 2 else (CUBE, CUBE_F, C, BE)


@pytest.mark.parametrize("d", [2, 3])
def test_what_holds_of_every_character(d: int, characters) -> None:
    c = characters[d]
    assert c.d == d
    assert np.ptp(c.V, axis=0).max() == c.L
    assert c.names == tuple(f"bone{b}" for b in range(len(c.BE)))
    np.testing.assert_array_equal(c.V_volume[: len(c.V)], c.V)
    np.testing.assert_array_equal(c.W_volume[: len(c.V)], c.W)
    assert element_volumes(c.V_volume, c.T).min() > 0
    for W in (c.W, c.W_volume):
        assert W.min() >= 0
        assert W.max() <= 1
        np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-12)
    # Facets of the surface are those of the volume, oriented alike.
    rows = [np.array(sorted(np.roll(f, -int(f.argmin())).tolist() for f in F)) for F in (c.F, boundary_facets(c.T))]
    np.testing.assert_array_equal(*rows)
    # The middle of a bone is held by it.
    for bone, (first, second) in enumerate(c.C[c.BE]):
        nearest = np.linalg.norm(c.V_volume - (first + second) / 2, axis=1).argmin()
        assert c.W_volume[nearest, bone] > 0.9


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("suffix", [".npz", ".dmat"])
def test_files_and_arrays_make_the_same_character(d: int, suffix: str, tmp_path: Path) -> None:
    V, E, C, bones = shape(d)
    W = np.stack([1 - V[:, 1], V[:, 1]], axis=1)
    write_mesh(tmp_path / "a.obj", V, E)
    write_tgf(tmp_path / "a.tgf", np.pad(C, ((0, 0), (0, 3 - d))), bones)
    write_weights(tmp_path / f"a{suffix}", W)
    c = load_character(tmp_path / "a.obj", tmp_path / "a.tgf", tmp_path / f"a{suffix}")
    same = assemble(V, E, C, bones, W)
    assert c.name == "a"
    for name in ("V", "F", "C", "BE", "P", "W", "T", "W_volume"):
        np.testing.assert_allclose(getattr(c, name), getattr(same, name), atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_solved_weights_do_not_know_the_unit(d: int) -> None:
    V, E, C, bones = shape(d)
    solved = solve_weights(V, E, C, bones)
    large = solve_weights(1024 * V, E, 1024 * C, bones)  # a power of two, so that TetGen rounds alike
    np.testing.assert_allclose(large.W, solved.W, atol=1e-6)
    assert solved.method == "joint"
    assert large.energy == pytest.approx(solved.energy * 1024.0 ** (d - 4), rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_given_weights_are_kept_and_spread_inside(d: int) -> None:
    V, E, C, bones = shape(d)
    W = np.stack([1 - V[:, 0], V[:, 0]], axis=1)
    lines: list[str] = []
    c = assemble(V, E, C, bones, W, report=lines.append)
    np.testing.assert_array_equal(c.W, W)
    assert 0.3 < c.W_volume[len(V) :].mean() < 0.7
    assert not lines


def test_weights_that_leave_the_simplex_are_mended_and_that_is_said() -> None:
    W = np.array([[2, 0], [0.5, 0.5], [-0.2, 1], [0, 0.5]])
    lines: list[str] = []
    c = assemble(*shape(2), W, report=lines.append)
    np.testing.assert_allclose(c.W, [[1, 0], [0.5, 0.5], [0, 1], [0, 1]])
    (line,) = lines
    assert line == "weights were clipped at zero and their rows normalised; the largest change is 1"


def test_an_open_surface_with_weights_does_without_a_volume() -> None:
    V, F, C, bones = shape(3)
    W = np.stack([1 - V[:, 0], V[:, 0]], axis=1)
    lines: list[str] = []
    c = assemble(V, F[2:], C, bones, W, report=lines.append)
    assert c.T.shape == (0, 4)
    np.testing.assert_array_equal(c.W_volume, W)
    (line,) = lines
    assert line.startswith("no volume mesh (TetGen could not")
    with pytest.raises(ValueError, match="it must be closed"):
        assemble(V, F[2:], C, bones)


def test_triangles_that_turn_the_other_way_have_the_same_outline() -> None:
    V, T, C, bones = shape(2)
    turned = np.concatenate([T[:1], T[1:, ::-1], [[0, 0, 1]]])
    outlines = [assemble(V, E, C, bones, np.ones((4, 2))).F for E in (T, turned)]
    assert sorted(outlines[0].tolist()) == sorted(outlines[1].tolist()) == [[0, 1], [1, 2], [2, 3], [3, 0]]


def test_a_flat_mesh_takes_a_flat_rig_of_three_coordinates() -> None:
    C = np.array([[0, 0, 1e-9], [1, 0, 0]])
    np.testing.assert_array_equal(rig_in_mesh_dimension(SQUARE, C), C[:, :2])
    np.testing.assert_array_equal(rig_in_mesh_dimension(CUBE, C), C)
    with pytest.raises(ValueError, match=r"^the mesh is flat \(z = 0\) but joint 1 is not$"):
        rig_in_mesh_dimension(SQUARE, [[0, 0, 0], [1, 0, 0.5]])
    with pytest.raises(ValueError, match=r"^the mesh has 3 dimensions but the rig has 2$"):
        rig_in_mesh_dimension(CUBE, [[0, 0], [1, 0]])


@pytest.mark.parametrize("d", [2, 3])
def test_the_volume_mesh_by_itself(d: int) -> None:
    V, E, C, bones = shape(d)
    V_volume, T = volume_mesh(V, E, C, bones)
    np.testing.assert_array_equal(V_volume[: len(V)], V)
    np.testing.assert_allclose(element_volumes(V_volume, T).sum(), 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"E": np.zeros((0, 3))}, "^the mesh has no triangle$"),
        ({"E": [[0, 1, 9]]}, r"^E\[0\] = \[0, 1, 9\] does not index the 4 vertices$"),
        ({"V": SQUARE * np.array([1, 0])}, "^the mesh has no extent along axis 1$"),
        (
            {"C": [[0.2, 0.5], [0.5, 0.5], [9, 0.5]]},
            r"^joint 2 at \[9.0, 0.5\] lies far outside the mesh, whose box runs",
        ),
        ({"C": [[0.2, 0.5], [0.5, 0.5], [1.2, 1.2]], "BE": [[0, 1], [2, 1]]}, "^bones 0 and 1 both end at joint 1"),
        ({"C": [[0.2, 1.2], [0.5, 1.2], [0.8, 1.2]]}, r"^bone 0 \(joints 0 and 1\) holds no vertex of the volume mesh"),
        ({"BE": np.zeros((0, 2))}, "^the rig has no bone$"),
        (
            {"W": np.ones((5, 2))},
            "^the weights have 5 rows and 2 columns, but the mesh has 4 vertices and the rig 2 bones",
        ),
        ({"W": np.ones((4, 3))}, "they belong to another mesh or rig$"),
        ({"W": [[1, 0], [0, 0], [1, 0], [1, 0]]}, "^vertex 1 has no positive weight$"),
        ({"W": [[1, 0], [np.nan, 0], [1, 0], [1, 0]]}, r"^W\[1, 0\] is nan"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changes: dict, message: str) -> None:
    V, E, C, bones = shape(2)
    with pytest.raises(ValueError, match=message):
        assemble(**({"V": V, "E": E, "C": C, "BE": bones, "W": None} | changes))


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    V, E, C, bones = shape(2)
    mesh, rig, weights = tmp_path / "a.obj", tmp_path / "a.tgf", tmp_path / "w.npz"
    write_mesh(mesh, V, E)
    write_tgf(rig, np.pad(C, ((0, 0), (0, 1))) + np.array([9, 0, 0]), bones)
    write_weights(weights, np.ones((7, 2)) / 2)
    with pytest.raises(ValueError, match="lies far outside") as caught:
        load_character(mesh, rig)
    assert str(caught.value).startswith(f"{mesh} with {rig}: joint 2")
    write_tgf(rig, np.pad(C, ((0, 0), (0, 1))), bones)
    with pytest.raises(ValueError, match="belong to another mesh or rig") as caught:
        load_character(mesh, rig, weights)
    assert str(caught.value).startswith(f"{mesh} with {rig} and {weights}: the weights have 7 rows")
    rig.write_text("1 0 0\n")
    with pytest.raises(FileFormatError):
        load_character(mesh, rig)
    with pytest.raises(FileNotFoundError):
        load_character(tmp_path / "none.obj", rig)


def test_a_character_is_not_changed_in_place(characters) -> None:
    c = characters[3]
    assert replace(c, name="other").name == "other"
    with pytest.raises(AttributeError):
        c.name = "other"
