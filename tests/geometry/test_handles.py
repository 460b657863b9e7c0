import igl
import numpy as np
import pytest

from nilbs.geometry.handles import bone_conditions, bone_samples


def rigged_points(d: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A branching skeleton and shuffled points, some on its bones and some beside."""
    C = np.array([[0, 0, 0], [1, 0, 0], [1.5, 1, 0.5], [2, -0.5, -0.5], [0, 1, 1.0]])[:, :d]
    BE = np.array([[0, 1], [1, 2], [1, 3], [0, 4]])
    on = bone_samples(C, BE, 4)
    off = on[rng.integers(0, len(on), 30)] + rng.uniform(0.01, 0.5, (30, 1)) * rng.choice([-1, 1], (30, d))
    return rng.permutation(np.concatenate([on, off])), C, BE


@pytest.mark.parametrize("d", [2, 3])
def test_joints_once_and_points_between_evenly(d: int, rng: np.random.Generator) -> None:
    C = rng.normal(size=(5, d))
    x = bone_samples(C, [[0, 1], [1, 3]], 3)  # joints 2 and 4 belong to no bone
    np.testing.assert_array_equal(x[:3], C[[0, 1, 3]])
    for k, (first, second) in enumerate([(0, 1), (1, 3)]):
        for i in range(3):
            s = (i + 1) / 4
            np.testing.assert_allclose(x[3 + 3 * k + i], C[first] + s * (C[second] - C[first]))
    assert len(x) == 9
    assert len(bone_samples(C, [[0, 1]], 0)) == 2
    assert bone_samples(C, np.zeros((0, 2)), 3).shape == (0, d)


@pytest.mark.parametrize("d", [2, 3])
def test_the_conditions_are_those_of_libigl(d: int, rng: np.random.Generator) -> None:
    V, C, BE = rigged_points(d, rng)
    fixed, W_fixed = bone_conditions(V, C, BE)
    no = np.zeros((0, 1), dtype=np.int64)
    # libigl reads three coordinates, and T only for its size.
    flat = [np.pad(points, ((0, 0), (0, 3 - d))) for points in (V, C)]
    b, bc = igl.boundary_conditions(
        flat[0], np.zeros((1, 4), dtype=np.int64), flat[1], no[:, 0], BE, np.zeros((0, 2), dtype=np.int64), no
    )
    assert 15 < len(fixed) < len(V)
    order = np.argsort(b)
    np.testing.assert_array_equal(fixed, b[order])
    np.testing.assert_allclose(W_fixed, bc[order], atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0), (1e9, 0), (1, 1e4)])
def test_neither_unit_nor_place_changes_the_conditions(
    d: int, scale: float, shift: float, rng: np.random.Generator
) -> None:
    V, C, BE = rigged_points(d, rng)
    fixed, W_fixed = bone_conditions(V, C, BE)
    moved = bone_conditions(scale * V + shift, scale * C + shift, BE)
    np.testing.assert_array_equal(moved[0], fixed)
    np.testing.assert_array_equal(moved[1], W_fixed)


def test_bones_that_meet_share_their_joint_equally() -> None:
    C, BE = [[0, 0], [1, 0], [2, 0], [1, 1]], [[0, 1], [1, 2], [1, 3]]
    fixed, W_fixed = bone_conditions([[5, 5], [1, 1], [1, 0], [0.5, 0], [2, 0]], C, BE)
    np.testing.assert_array_equal(fixed, [1, 2, 3, 4])
    np.testing.assert_allclose(W_fixed, [[0, 0, 1], [1 / 3, 1 / 3, 1 / 3], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("C", "BE"),
    [
        ([[0, 0], [1, 0], [5, 5], [5, 6]], [[0, 1], [2, 3]]),  # outside
        ([[0, 0], [1, 0], [0, 0], [1, 0], [0, 0], [1, 0]], [[0, 1], [2, 3], [4, 5]]),  # on top of each other
    ],
)
def test_a_bone_that_owns_no_vertex_is_named(C: list, BE: list) -> None:
    weak = 1 if len(BE) == 2 else 0
    first, second = BE[weak]
    message = rf"^bone {weak} \(joints {first} and {second}\) holds no vertex of the volume mesh: it lies outside"
    with pytest.raises(ValueError, match=message):
        bone_conditions([[0, 0], [1, 0], [0.5, 0.5]], C, BE)


def test_no_vertices_hold_no_bone() -> None:
    with pytest.raises(ValueError, match="bone 0"):
        bone_conditions(np.zeros((0, 2)), [[0, 0], [1, 0]], [[0, 1]])


def test_sizes_that_disagree_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^C must be \(k, d\) = \(2, 2\), got \(2, 3\)$"):
        bone_conditions(np.zeros((4, 2)), np.zeros((2, 3)), [[0, 1]])
    for call in (lambda BE: bone_conditions(np.zeros((4, 2)), np.zeros((2, 2)), BE),
                 lambda BE: bone_samples(np.zeros((2, 2)), BE, 1)):  # fmt: skip
        with pytest.raises(ValueError, match=r"^BE\[0\] = \[0, 2\] does not index the 2 joints$"):
            call([[0, 2]])
