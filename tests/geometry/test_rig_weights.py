from functools import lru_cache

import igl
import numpy as np
import pytest

from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.rig_weights import SolvedWeights, check_rig_fits, solve_weights
from nilbs.geometry.skeleton import Skeleton, skeleton_of_bones, skeleton_of_joints
from nilbs.geometry.volume import element_volumes

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])
JOINTS = np.array([[-0.7, 0, 0], [-0.2, 0.02, 0], [0.2, 0, 0.03], [0.7, 0, 0]])


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarse volumes, for speed."""
    monkeypatch.setattr("nilbs.geometry.domain.SPACING", 0.06)
    monkeypatch.setattr("nilbs.geometry.domain.ELEMENTS", 6000)
    monkeypatch.setattr("nilbs.geometry.domain.RESOLUTIONS", (48,))
    monkeypatch.setattr("nilbs.geometry.domain.DECIMATED", 3000)


@lru_cache
def limb(d: int) -> tuple[np.ndarray, np.ndarray]:
    """A bar, or a capsule, along the first axis from -0.85 to 0.85, half as wide as 0.5."""
    if d == 2:
        x, y = (
            a.ravel() for a in np.meshgrid(np.linspace(-0.85, 0.85, 35), np.linspace(-0.25, 0.25, 11), indexing="ij")
        )
        i = (np.arange(34)[:, None] * 11 + np.arange(10)).ravel()
        T = np.concatenate([np.stack([i, i + 11, i + 12], axis=1), np.stack([i, i + 12, i + 1], axis=1)])
        return np.stack([x, y], axis=1), T
    grid = Grid.box(np.array([[-0.9, -0.3, -0.3], [0.9, 0.3, 0.3]]), 24)
    x = grid.points()
    axis = np.stack([np.clip(x[:, 0], -0.6, 0.6), np.zeros(len(x)), np.zeros(len(x))], axis=1)
    return isosurface(np.linalg.norm(x - axis, axis=1) - 0.25, grid)


def rig(d: int, C: np.ndarray = JOINTS, BE: list | None = None, P: list[int] | None = None) -> Skeleton:
    """Bones in a row, or those that are given; names are a, b, c, ..."""
    BE = [[j, j + 1] for j in range(len(C) - 1)] if BE is None else BE
    P = [*range(-1, len(BE) - 1)] if P is None else P
    return Skeleton(np.asarray(C, dtype=float)[:, :d], BE, P, "abcdefghijklmnop"[: len(BE)])


def solved(V: np.ndarray, E: np.ndarray, skeleton: Skeleton, **options: object) -> SolvedWeights:
    """Weights, after the checks that hold for all solutions."""
    found = solve_weights(V, E, skeleton, **options)
    for W, n in ((found.W, len(V)), (found.W_volume, len(found.V_volume))):
        assert W.shape == (n, len(skeleton.BE))
        assert W.min() >= 0
        assert W.max() <= 1
        np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-12)
    assert element_volumes(found.V_volume, found.T).min() > 0
    return found


def difference(W: np.ndarray, other: np.ndarray) -> float:
    """Half the sum over bones of |difference|, on average over the vertices."""
    return float(np.abs(W - other).sum(axis=1).mean() / 2)


@lru_cache
def plain(d: int) -> SolvedWeights:
    return solved(*limb(d), rig(d))


@DIMENSIONS
def test_every_bone_moves_what_is_around_it(d: int) -> None:
    V, _ = limb(d)
    found = plain(d)
    assert found.notes == ()
    assert found.method == "joint"
    assert found.energy > 0
    x = V[:, 0]
    for bone, part in enumerate((x < -0.5, np.abs(x) < 0.1, x > 0.5)):
        assert found.W[part, bone].min() > 0.7
    np.testing.assert_array_equal(found.W[x < -0.35].argmax(axis=1), 0)
    np.testing.assert_array_equal(found.W[x > 0.35].argmax(axis=1), 2)
    # At the joints the two bones have about the same part.
    for joint, pair in ((-0.2, [0, 1]), (0.2, [1, 2])):
        assert 0.35 < found.W[np.abs(x - joint) < 0.06][:, pair].mean() < 0.6


@DIMENSIONS
def test_one_bone_moves_all(d: int) -> None:
    found = solved(*limb(d), rig(d, JOINTS[[0, 3]]))
    np.testing.assert_allclose(found.W, 1, atol=1e-15)
    assert found.notes == ()


@DIMENSIONS
def test_bones_in_another_order_have_the_same_weights(d: int) -> None:
    again = solved(*limb(d), rig(d, JOINTS, [[2, 3], [0, 1], [1, 2]], [2, -1, 1]))
    # The tetrahedra differ, because the bones' points come in another order.
    assert difference(again.W[:, [1, 2, 0]], plain(d).W) < 0.04


@DIMENSIONS
def test_bones_in_one_place_share_the_weights_of_one(d: int) -> None:
    twice = solved(*limb(d), rig(d, JOINTS, [[0, 1], [1, 2], [2, 3], [1, 2], [2, 1]], [-1, 0, 1, 0, 0]))
    assert twice.notes == ("bones on top of each other share their weights (3): b, d, e",)
    np.testing.assert_allclose(twice.W[:, 3], twice.W[:, 1], atol=0.01)
    np.testing.assert_allclose(twice.W[:, 4], twice.W[:, 1], atol=0.01)
    together = np.stack([twice.W[:, 0], twice.W[:, [1, 3, 4]].sum(axis=1), twice.W[:, 2]], axis=1)
    assert difference(together, plain(d).W) < 0.03


@DIMENSIONS
def test_a_bone_without_length_holds_its_place(d: int) -> None:
    V, E = limb(d)
    C = np.array([[-0.7, 0, 0], [-0.3, 0, 0], [0.4, 0, 0], [0.7, 0, 0]])
    found = solved(V, E, rig(d, C, [[0, 1], [2, 2], [3, 3]], [-1, 0, 1]))
    assert found.notes == ()
    for bone, place in ((1, 0.4), (2, 0.7)):
        near = np.linalg.norm(found.V_volume - C[2 + bone - 1, :d], axis=1).argmin()
        assert found.W_volume[near, bone] > 0.9
        assert found.W[np.abs(V[:, 0] - place) < 0.05, bone].mean() > 0.5
    # Points alone are a rig too.
    points = solved(V, E, rig(d, C, [[0, 0], [1, 1], [3, 3]], [-1, 0, 1]))
    assert points.W[V[:, 0] > 0.6, 2].min() > 0.6


@DIMENSIONS
def test_tiny_bones_beside_each_other_have_weights_of_their_own(d: int) -> None:
    C = np.array([[-0.7, 0, 0], [0.5, 0, 0], [0.52, 0, 0], [0.54, 0, 0], [0.56, 0, 0]])
    found = solved(*limb(d), rig(d, C))
    assert (found.W_volume.max(axis=0) > 0.5).all()
    assert found.W[limb(d)[0][:, 0] < 0, 0].min() > 0.6


@DIMENSIONS
def test_a_bone_outside_holds_the_nearest_place_and_is_noted(d: int) -> None:
    V, E = limb(d)
    C = np.concatenate([JOINTS, [[0.3, 0.3, 0], [0.5, 0.3, 0]]])
    found = solved(V, E, rig(d, C, [[0, 1], [1, 2], [2, 3], [4, 5]], [-1, 0, 1, -1]))
    assert found.notes == ("bones without a place inside hold the nearest one (1): d",)
    near = np.linalg.norm(V - np.array([0.4, 0.25, 0])[:d], axis=1) < 0.06
    assert near.any()
    assert found.W[near, 3].min() > 0.5
    assert found.W[V[:, 1] < -0.2, 3].max() < 0.4


@DIMENSIONS
def test_a_bone_far_away_moves_nothing_and_is_noted(d: int) -> None:
    C = np.concatenate([JOINTS, [[0.3, 0.9, 0], [0.5, 0.9, 0]]])
    four = rig(d, C, [[0, 1], [1, 2], [2, 3], [4, 5]], [-1, 0, 1, -1])
    found = solved(*limb(d), four)
    assert found.notes == ("bones far from the mesh move nothing (1): d",)
    np.testing.assert_array_equal(found.W[:, 3], 0)
    assert difference(found.W[:, :3], plain(d).W) < 1e-6
    # With a longer reach it holds the nearest place.
    assert solved(*limb(d), four, reach=0.5).W[:, 3].max() > 0.5


@DIMENSIONS
def test_no_bone_within_reach_is_refused(d: int) -> None:
    C = JOINTS + np.array([0, 0.4, 0])
    with pytest.raises(
        ValueError, match=r"^no bone lies within 0\.01 diagonals of the mesh: is the rig in the same unit"
    ):
        solve_weights(*limb(d), rig(d, C), reach=0.01)


@DIMENSIONS
@pytest.mark.parametrize(("mesh", "joints"), [(1e300, 1e300), (1e300, 1), (1, 1e300)])
def test_coordinates_that_overflow_are_refused(d: int, mesh: float, joints: float) -> None:
    V, E = limb(d)
    with pytest.raises(ValueError, match=r"is [0-9.]+e\+[0-9]{3}: bring both to another unit$"):
        solve_weights(mesh * V, E, rig(d, joints * JOINTS))


@DIMENSIONS
def test_a_part_that_no_bone_enters_follows_the_nearest_bone_and_is_noted(d: int) -> None:
    V, E = limb(d)
    n = len(V)
    # A thin limb above that comes close to the last bone, and ends above the first.
    s, across = (V[:, :1] + 0.85) / 1.7, 0.1 * V[:, 1:2]
    above = np.concatenate([0.3 - 0.8 * s - 0.5 * across, 0.4 + 0.5 * s - 0.8 * across, 0.1 * V[:, 2:]], axis=1)
    found = solved(np.concatenate([V, above]), np.concatenate([E, E + n]), rig(d))
    assert found.notes == ("parts of the mesh that no bone enters (1) follow c",)
    np.testing.assert_allclose(found.W[n:], np.eye(3)[[2] * n], atol=1e-12)
    assert found.W[:n].min(axis=1).max() < 0.34
    assert difference(found.W[:n], plain(d).W) < 0.04


@DIMENSIONS
def test_no_part_follows_a_bone_that_moves_nothing(d: int) -> None:
    V, E = limb(d)
    n, shift = len(V), np.array([0.9, 0.45, 0])[:d]
    C = np.concatenate([JOINTS, [[0.9, 0.8, 0], [1.0, 0.8, 0]]])
    four = rig(d, C, [[0, 1], [1, 2], [2, 3], [4, 5]], [-1, 0, 1, -1])
    found = solved(np.concatenate([V, 0.3 * V + shift]), np.concatenate([E, E + n]), four)
    assert found.notes == (
        "bones far from the mesh move nothing (1): d",
        "parts of the mesh that no bone enters (1) follow c",
    )
    np.testing.assert_allclose(found.W[n:], np.eye(4)[[2] * n], atol=1e-12)


@DIMENSIONS
def test_several_roots(d: int) -> None:
    apart = solved(*limb(d), rig(d, JOINTS, None, [-1, -1, -1]))
    assert apart.notes == ()
    # Weights do not depend on the hierarchy.
    np.testing.assert_allclose(apart.W, plain(d).W, atol=1e-9)


def test_a_fork_belongs_to_its_bone() -> None:
    V, E = limb(2)
    # A bone with a child above and one below holds the segments to both.
    positions = np.array([[-0.3, 0], [0.3, 0.15], [0.3, -0.15], [0.7, 0.15]])
    forked = skeleton_of_joints(positions, [-1, 0, 0, 1], "abcd")
    assert forked.forks.tolist() == [[0, 2]]
    without = Skeleton(forked.C, forked.BE, forked.P, forked.names)
    way = np.array([0.0, -0.075])
    parts = []
    for skeleton in (forked, without):
        found = solved(V, E, skeleton)
        parts.append(found.W_volume[np.linalg.norm(found.V_volume - way, axis=1).argmin(), 0])
    assert parts[0] > 0.99 > 0.95 > parts[1]


@DIMENSIONS
def test_vertices_that_no_face_uses_have_weights_and_change_nothing(d: int) -> None:
    V, E = limb(d)
    found = solved(np.concatenate([np.full((1, d), 50.0), V]), E + 1, rig(d))
    np.testing.assert_allclose(found.W[1:], plain(d).W, atol=1e-9)
    assert found.W[0].argmax() == 2


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e5)])
@DIMENSIONS
def test_neither_unit_nor_place_changes_the_weights(d: int, scale: float, offset: float) -> None:
    V, E = limb(d)
    far = scale * V + offset * 1.7
    there = solved(far, E, rig(d, scale * JOINTS + offset * 1.7))
    assert there.notes == ()
    assert difference(there.W, plain(d).W) < 0.02
    assert there.energy == pytest.approx(plain(d).energy * scale ** (d - 4), rel=0.2)


@DIMENSIONS
def test_weights_bone_by_bone_are_another_method(d: int) -> None:
    other = solved(*limb(d), rig(d), method="igl")
    assert other.method == "igl"
    assert plain(d).energy <= other.energy * 1.01
    assert 1e-5 < difference(other.W, plain(d).W) < 0.1
    with pytest.raises(ValueError, match=r"^method must be 'joint' or 'igl', got 'best'$"):
        solve_weights(*limb(d), rig(d), method="best")


def test_an_open_limb_is_wrapped_and_has_nearly_the_same_weights() -> None:
    V, F = limb(3)
    kept = np.linalg.norm(V[F].mean(axis=1) - [0.1, 0.25, 0], axis=1) > 0.12
    found = solved(V, F[kept], rig(3))
    (note,) = found.notes
    assert note.startswith("the mesh is not a clean solid (1 hole)")
    assert difference(found.W, plain(3).W) < 0.05


@pytest.mark.parametrize(
    ("scale", "up", "message"),
    [
        (
            100.0,
            0.0,
            r"^the rig is 7\d(\.\d)? times larger than the mesh: the mesh's box .* bring both to the same unit$",
        ),
        (0.01, 0.0, r"^the rig is 1\d\d times smaller than the mesh: .* joints' from \[-0\.007, .* to the same unit$"),
        (1.0, 3.0, r"^the rig lies outside the mesh: .* bring both to the same unit and frame$"),
        (100.0, 90.0, r"^the rig lies outside the mesh: "),
    ],
)
@DIMENSIONS
def test_a_rig_in_another_unit_or_frame_is_refused(d: int, scale: float, up: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_weights(*limb(d), rig(d, scale * JOINTS + np.array([0, up, 0])))


def test_boxes_are_written_in_as_many_digits_as_matter() -> None:
    V = 1e-5 * np.array([[0, 0], [1, 0], [0, 1.0]])
    with pytest.raises(ValueError, match=r"runs from \[0.0, 0.0\] to \[1e-05, 1e-05\], the joints' from \[1.0, 1.0\]"):
        check_rig_fits(V, rig(2, np.ones((2, 2))))
    with pytest.raises(ValueError, match=r"runs from \[0.0, 0.0\] to \[123457.0, 123457.0\], the joints' from \[-1"):
        check_rig_fits(V / V.max() * 123456.789, rig(2, -1e6 * np.ones((2, 2))))


def test_small_rigs_that_are_right() -> None:
    V, _ = limb(2)
    # Two joints, or joints in one place, leave the unit open; those that no bone uses do not count.
    check_rig_fits(V, rig(2, np.array([[0, 0], [0.001, 0]])))
    check_rig_fits(V, rig(2, np.zeros((3, 2))))
    check_rig_fits(V, rig(2, np.array([[0, 0], [0.7, 0], [0.1, 0], [500, 0]]), [[0, 1], [1, 2]]))


@pytest.mark.parametrize(
    ("V", "E", "message"),
    [
        (np.zeros((0, 2)), np.zeros((0, 3)), "^the mesh has no triangle$"),
        (limb(2)[0], np.zeros((0, 3)), "^the mesh has no triangle$"),
        (limb(2)[0], [[0, 1, 999]], r"^E\[0\] = \[0, 1, 999\] does not index the 385 vertices$"),
        (limb(3)[0], limb(3)[1], "^the mesh has 3 dimensions but the rig has 2$"),
        (limb(2)[0], [[0, 1]], r"^E must be \(m, 3\)"),
        (limb(2)[0] * np.nan, limb(2)[1], r"^V\[0, 0\] is nan"),
        (limb(2)[0] * np.array([1, 0]), limb(2)[1], "^no triangle of the mesh has any area$"),
    ],
)
def test_wrong_meshes_are_refused(V: np.ndarray, E: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_weights(V, E, rig(2))


def test_progress_goes_to_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    solve_weights(*limb(2), rig(2), progress=True)
    assert capsys.readouterr().out == ""


POINTS = np.array([[-0.6, 0.1, 0], [0.6, 0.05, 0], [-0.3, 0, 0], [0.2, 0, 0]])


@DIMENSIONS
@pytest.mark.parametrize("method", ["joint", "igl"])
def test_point_handles_hold_their_place(d: int, method: str) -> None:
    C = POINTS[:, :d]
    found = solved(*limb(d), skeleton_of_bones(C, [[0, 0], [1, 1], [2, 3]]), method=method)
    assert found.notes == ()
    held = [np.linalg.norm(found.V_volume - x, axis=1).argmin() for x in C]
    np.testing.assert_allclose(found.V_volume[held], C, atol=1e-9)
    np.testing.assert_allclose(found.W_volume[held], np.eye(3)[[0, 1, 2, 2]], atol=1e-6)
    x = limb(d)[0][:, 0]
    np.testing.assert_array_equal(found.W[x < -0.6].argmax(axis=1), 0)
    np.testing.assert_array_equal(found.W[x > 0.6].argmax(axis=1), 1)


def test_point_handles_are_in_the_order_of_libigl() -> None:
    found = solved(*limb(3), skeleton_of_bones(POINTS, [[0, 0], [1, 1], [2, 3]]))
    points, bones = np.array([0, 1]), np.array([[2, 3]])
    fixed, W_fixed = igl.boundary_conditions(found.V_volume, found.T, POINTS, points, bones)
    assert {tuple(row) for row in W_fixed.tolist()} == {(1, 0, 0), (0, 1, 0), (0, 0, 1)}
    np.testing.assert_allclose(found.W_volume[fixed], W_fixed, atol=1e-6)


@DIMENSIONS
def test_a_rig_of_points_alone(d: int) -> None:
    V, E = limb(d)
    C = np.array([[-0.7, 0, 0], [0, 0.1, 0], [0.7, 0, 0]])[:, :d]
    W = solved(V, E, skeleton_of_bones(C, [[0, 0], [1, 1], [2, 2]])).W
    for point in range(3):
        nearest = np.argsort(np.linalg.norm(V - C[point], axis=1))[:5]
        np.testing.assert_array_equal(W[nearest].argmax(axis=1), point)
