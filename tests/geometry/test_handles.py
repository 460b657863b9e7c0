import numpy as np
import pytest

from nilbs.geometry.handles import BoneConditions, bone_conditions, bone_points, distinct_points
from nilbs.geometry.skeleton import Skeleton

LINE = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [0, 3], [4, 3]])
EVERY = np.arange(len(LINE))


def conditions(x: list, bone: list[int], *, inside: bool | list[bool] = True, **changes: float) -> BoneConditions:
    """The vertices that points hold on a line."""
    given = {"bones": max(bone) + 1, "snap": 0.1, "reach": 1.0, "vertices": EVERY} | changes
    vertices = given.pop("vertices")
    return bone_conditions(LINE, vertices, x, bone, np.broadcast_to(inside, len(x)), **given)


@pytest.mark.parametrize("d", [2, 3])
def test_joints_exactly_and_points_between_evenly(d: int, rng: np.random.Generator) -> None:
    C = rng.normal(size=(4, d))
    skeleton = Skeleton(C, [[0, 1], [1, 3], [2, 2]], [-1, 0, 0], "abc")
    length = np.linalg.norm(C[[1, 3]] - C[[0, 1]], axis=1)
    x, bone = bone_points(skeleton, spacing=length[0] / 3.5)
    np.testing.assert_array_equal(x[:6], C[[0, 1, 2, 1, 3, 2]])
    np.testing.assert_array_equal(bone[:6], [0, 1, 2, 0, 1, 2])
    for b, (first, second) in enumerate([(0, 1), (1, 3)]):
        inner = x[6:][bone[6:] == b]
        n = len(inner) + 1
        # The fewest whose distances are at most the spacing; at least one, at most ten.
        assert n == np.clip(np.ceil(3.5 * length[b] / length[0]), 2, 11)
        np.testing.assert_allclose(inner, C[first] + np.arange(1, n)[:, None] / n * (C[second] - C[first]), atol=1e-12)
    assert x[6:][bone[6:] == 2].tolist() == C[[2]].tolist()


def test_no_more_points_on_a_long_bone_than_are_allowed() -> None:
    skeleton = Skeleton([[0, 0], [1, 0]], [[0, 1]], [-1], ["arm"])
    assert len(bone_points(skeleton, spacing=1e-9)[0]) == 2 + 10
    assert len(bone_points(skeleton, spacing=1e-9, most=3)[0]) == 2 + 3
    assert bone_points(skeleton, spacing=9.0)[0].tolist() == [[0, 0], [1, 0], [0.5, 0]]


def test_a_fork_holds_points_of_its_bone() -> None:
    skeleton = Skeleton([[0, 0], [2, 0], [0, 2]], [[0, 1], [2, 2]], [-1, 0], "ab", [[0, 2]])
    x, bone = bone_points(skeleton, spacing=1.0)
    for place in ([0, 0], [2, 0], [0, 2], [1, 0], [0, 1]):
        assert ((x == place).all(axis=1) & (bone == 0)).any()
    assert x[bone == 1].tolist() == [[0, 2]] * 3


@pytest.mark.parametrize("d", [2, 3])
def test_kept_points_lie_apart_and_near_every_other(d: int, rng: np.random.Generator) -> None:
    x = rng.uniform(size=(300, d))
    kept = distinct_points(x, 0.2)
    slow: list[int] = []
    for i, point in enumerate(x):
        if not slow or np.linalg.norm(x[slow] - point, axis=1).min() > 0.2:
            slow.append(i)
    assert kept.tolist() == slow
    assert 3 < len(kept) < 250
    assert distinct_points(np.zeros((0, d)), 0.2).tolist() == []


def test_points_hold_the_vertices_that_they_lie_on() -> None:
    held = conditions([[0, 0], [1.05, 0], [3, 0], [3.99, 0]], [0, 0, 1, 1])
    np.testing.assert_array_equal(held.fixed, [0, 1, 3, 4])
    np.testing.assert_array_equal(held.W_fixed, [[1, 0], [1, 0], [0, 1], [0, 1]])
    assert held.outside.tolist() == held.away.tolist() == []


def test_bones_that_hold_one_vertex_share_it_equally() -> None:
    # Bones 0 and 1 meet at vertex 1 in several points each; bone 2 lies on top of bone 0.
    x = [[0, 0], [1, 0], [1.01, 0], [1, 0], [0.99, 0], [2, 0], [0, 0], [1, 0]]
    held = conditions(x, [0, 0, 0, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(held.fixed, [0, 1, 2])
    np.testing.assert_allclose(held.W_fixed, [[0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3], [0, 1, 0]])
    np.testing.assert_allclose(held.W_fixed.sum(axis=1), 1, atol=1e-15)


def test_a_point_too_far_from_any_vertex_holds_none() -> None:
    held = conditions([[0, 0], [0.5, 0], [3, 0]], [0, 0, 1])
    np.testing.assert_array_equal(held.fixed, [0, 3])
    # With a longer snap it does: one of the two nearest vertices.
    assert len(conditions([[0, 0], [0.5, 0.02], [0.6, 0], [3, 0]], [0, 0, 0, 1], snap=0.5).fixed) == 3


def test_a_bone_inside_but_far_from_any_vertex_takes_the_nearest() -> None:
    held = conditions([[0, 0], [2.3, 0.2]], [0, 1])
    np.testing.assert_array_equal(held.fixed, [0, 2])
    np.testing.assert_array_equal(held.W_fixed, np.eye(2))
    assert held.outside.tolist() == [1]


def test_a_bone_outside_holds_the_nearest_places_and_is_listed() -> None:
    # Bone 1 lies beside the line: it holds all vertices that are about as near as the nearest, not its far end.
    held = conditions(
        [[0, 0], [2, -0.5], [3, -0.52], [4, -0.5], [4, -0.95]], [0, 1, 1, 1, 1], inside=[True] + 4 * [False]
    )
    np.testing.assert_array_equal(held.fixed, [0, 2, 3, 4])
    np.testing.assert_array_equal(held.W_fixed, [[1, 0], [0, 1], [0, 1], [0, 1]])
    assert held.outside.tolist() == [1]
    assert held.away.tolist() == []
    far_end = conditions([[0, 0], [2, -0.5], [3, -0.9]], [0, 1, 1], inside=[True, False, False])
    np.testing.assert_array_equal(far_end.fixed, [0, 2])


def test_a_bone_partly_outside_holds_only_what_is_inside() -> None:
    held = conditions([[0, 0], [1, 0], [2, 0.3], [3, 0.05]], [0, 1, 1, 1], inside=[True, True, False, False])
    np.testing.assert_array_equal(held.fixed, [0, 1])
    assert held.outside.tolist() == []


def test_a_bone_beyond_the_reach_holds_nothing_and_is_listed() -> None:
    x = [[0, 0], [2, -1.2], [4, -0.8]]
    held = conditions(x, [0, 1, 2], inside=[True, False, False])
    np.testing.assert_array_equal(held.fixed, [0, 4])
    np.testing.assert_array_equal(held.W_fixed, [[1, 0, 0], [0, 0, 1]])
    assert (held.outside.tolist(), held.away.tolist()) == ([2], [1])
    # A longer reach changes that.
    assert conditions(x, [0, 1, 2], inside=[True, False, False], reach=1.3).outside.tolist() == [1, 2]
    none = conditions(x, [0, 1, 2], inside=False, reach=-1.0)
    assert none.fixed.tolist() == none.outside.tolist() == []
    assert none.W_fixed.shape == (0, 3)
    assert none.away.tolist() == [0, 1, 2]


def test_a_bone_without_points_is_away() -> None:
    assert conditions([[0, 0], [1, 0]], [0, 0], bones=3).away.tolist() == [1, 2]


def test_only_some_vertices_may_be_held() -> None:
    held = conditions([[0, 0], [2, 0]], [0, 1], vertices=np.array([5, 1, 4]), reach=9.0)
    np.testing.assert_array_equal(held.fixed, [1])
    np.testing.assert_array_equal(held.W_fixed, [[0.5, 0.5]])
    assert held.outside.tolist() == [0, 1]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0), (1e9, 0), (1, 1e4)])
def test_neither_unit_nor_place_changes_the_vertices_held(
    d: int, scale: float, shift: float, rng: np.random.Generator
) -> None:
    V, x = rng.uniform(size=(60, d)), rng.uniform(-0.5, 1.5, size=(40, d))
    bone, inside = np.repeat(np.arange(8), 5), ((x > 0) & (x < 1)).all(axis=1)
    every = np.arange(60)
    held = bone_conditions(V, every, x, bone, inside, bones=8, snap=0.1, reach=0.3)
    moved = bone_conditions(
        scale * V + shift, every, scale * x + shift, bone, inside, bones=8, snap=0.1 * scale, reach=0.3 * scale
    )
    for name, value in vars(held).items():
        np.testing.assert_array_equal(getattr(moved, name), value)
    assert 5 < len(held.fixed) < 40


def test_sizes_that_disagree_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^x must be \(s, d\) = \(2, 2\), got \(2, 3\)$"):
        conditions(np.zeros((2, 3)), [0, 0])
    with pytest.raises(ValueError, match=r"^bone must be \(s,\) = \(2,\), got \(3,\)$"):
        conditions(np.zeros((2, 2)), [0, 0, 0])
    with pytest.raises(ValueError, match=r"^x must be \(s, d\)"):
        distinct_points(np.zeros(3), 0.1)
