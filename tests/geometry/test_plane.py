import numpy as np
import pytest

from nilbs.geometry.plane import FLAT, flattened, in_space, is_flat, transforms_in_plane, transforms_in_space
from nilbs.geometry.skeleton import Skeleton


@pytest.mark.parametrize("size", [1e-200, 1.0, 1e308])
def test_the_tolerance_of_flatness_follows_the_size(size: float, rng: np.random.Generator) -> None:
    x = in_space(rng.uniform(-1, 1, (50, 2)))
    assert is_flat(size * x)
    x[3, 2] = 0.1 * FLAT
    assert is_flat(size * x)
    x[3, 2] = 10 * FLAT
    assert not is_flat(size * x)


def test_one_point_far_away_flattens_no_others(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.uniform(-1, 1, (9, 3)), [[1e9, 0, 0]]])
    assert flattened(x) is x


def test_points_of_one_place_are_flat_at_zero_only() -> None:
    assert is_flat(np.zeros((0, 3)))
    assert is_flat(np.array([[5.0, 5, 0]] * 3))
    assert not is_flat(np.array([[5.0, 5, 1e-12]] * 3))
    assert not is_flat(np.array([[0, 0, np.nan], [1, 0, 0]]))
    assert not is_flat(np.array([[0, 0, np.inf], [1, 0, 0]]))


def test_points_and_transforms_come_back(rng: np.random.Generator) -> None:
    x, B = rng.normal(size=(7, 2)), rng.normal(size=(4, 3, 3, 3))
    B[..., 2, :] = 0, 0, 1
    assert (flattened(in_space(x)) == x).all()
    assert (transforms_in_plane(transforms_in_space(B)) == B).all()
    points = np.concatenate([x, np.ones((7, 1))], axis=1) @ B[0, 0].T
    lifted = np.concatenate([in_space(x), np.ones((7, 1))], axis=1) @ transforms_in_space(B)[0, 0].T
    np.testing.assert_allclose(lifted, np.insert(points, 2, 0, axis=1), atol=1e-12)


@pytest.mark.parametrize("entry", [(2, 0), (2, 3), (1, 2)])
def test_a_transform_that_leaves_the_plane(entry: tuple[int, int]) -> None:
    B = np.broadcast_to(np.eye(4), (3, 2, 4, 4)).copy()
    B[2, 1][entry] = 0.1 * FLAT
    assert transforms_in_plane(B).shape == (3, 2, 3, 3)
    B[2, 1][entry] = 0.01
    with pytest.raises(ValueError, match=r"frame 2 .* bone 1 "):
        transforms_in_plane(B)


def test_skeletons_keep_all_but_their_dimension() -> None:
    flat = Skeleton([[0, 0], [1, 0], [0, 1]], [[0, 1]], [-1], ["a"], [[0, 2]])
    assert flat.in_space().d == 3
    assert flat.in_space().forks.tolist() == [[0, 2]]
    assert (flat.in_space().in_plane().C == flat.C).all()
    with pytest.raises(ValueError, match="joint 1"):
        Skeleton([[0, 0, 0], [1, 0, 1]], [[0, 1]], [-1], ["a"]).in_plane()
