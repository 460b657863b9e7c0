import numpy as np
import pytest

from nilbs.fields.samples import occupancy_samples, surface_samples, volume_samples
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.rotations import rigid_transforms
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy


def ball(d: int) -> tuple[np.ndarray, np.ndarray]:
    grid = Grid.cube(np.array([[-1.0] * d, [1.0] * d]), 12)
    return isosurface(np.linalg.norm(grid.points(), axis=1) - 0.9, grid)


def solid(d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ball and its volume mesh: every facet joined to the centre, which comes last."""
    V, F = ball(d)
    T = np.concatenate([F, np.full((len(F), 1), len(V))], axis=1)
    return V, F, np.concatenate([V, np.zeros((1, d))]), T


def affine(x: np.ndarray) -> np.ndarray:
    """Weights that grow from left to right."""
    share = 0.5 + x[:, :1] / 4
    return np.concatenate([share, 1 - share], axis=1)


@pytest.mark.parametrize("d", [2, 3])
def test_labels_are_true_for_the_posed_mesh(d: int, rng: np.random.Generator) -> None:
    V, F = ball(d)
    W = affine(V)
    B = rigid_transforms(np.eye(d), rng.normal(size=(3, 2, d)))
    samples = occupancy_samples(V, F, W, B, n=401, noise=0.02, rng=rng)
    assert samples.x.shape == (3, 401, d)
    assert samples.inside.shape == (3, 401)
    for pose, x, inside in zip(B, samples.x, samples.inside, strict=True):
        U = linear_blend_skinning(V, W, pose)
        np.testing.assert_array_equal(occupancy(U, F, x), inside)
        assert 0.2 < inside.mean() < 0.8
        # Some points are spread over the cube, some are close to the surface.
        distance = np.abs(signed_distance(U, F, x))
        assert (distance < 0.04).mean() > 0.2
        assert (distance > 0.2).mean() > 0.1
        assert len(np.unique(x, axis=0)) == 401


def test_the_same_generator_gives_the_same_samples() -> None:
    V, F = ball(2)
    draws = [
        occupancy_samples(V, F, affine(V), np.stack([[np.eye(3)] * 2]), n=50, noise=0.1, rng=np.random.default_rng(5))
        for _ in range(2)
    ]
    np.testing.assert_array_equal(draws[0].x, draws[1].x)


def test_the_paper_has_weights_at_the_vertices_only() -> None:
    V, _ = ball(3)
    samples = surface_samples(V, affine(V))
    np.testing.assert_array_equal(samples.x_rest, V.astype(np.float32))
    np.testing.assert_array_equal(samples.W, affine(V).astype(np.float32))


@pytest.mark.parametrize("d", [2, 3])
def test_weights_inside_are_those_of_the_volume_mesh(d: int, rng: np.random.Generator) -> None:
    V, F, V_volume, T = solid(d)
    samples = volume_samples(V, F, affine(V), V_volume, T, affine(V_volume), n=1001, shell=0.0, rng=rng)
    assert len(samples.x_rest) == len(samples.W) == 1001
    assert samples.x_rest.dtype == samples.W.dtype == np.float32
    # Affine weights are read exactly, whether inside an element or on a facet.
    np.testing.assert_allclose(samples.W, affine(samples.x_rest), atol=1e-6)
    distance = signed_distance(V, F, samples.x_rest.astype(np.float64))
    assert distance.max() < 1e-6
    assert 0.4 < (distance < -0.01).mean() < 0.6
    # By volume: half of a disk's area lies beyond 0.71 of its radius.
    radius = np.linalg.norm(samples.x_rest[distance < -1e-6], axis=1)
    assert np.median(radius) == pytest.approx(0.9 * 0.5 ** (1 / d), abs=0.05)


@pytest.mark.parametrize("d", [2, 3])
def test_the_shell_lies_along_normals_and_keeps_the_weights_of_its_foot(d: int, rng: np.random.Generator) -> None:
    V, F, V_volume, T = solid(d)
    # The volume mesh is a wrap of the surface and has other weights.
    around = 2 * V_volume
    samples = volume_samples(V, F, affine(V), around, T, 1 - affine(around), n=8000, shell=0.01, rng=rng)
    x, shell = samples.x_rest[:4000].astype(np.float64), samples.x_rest[4000:].astype(np.float64)
    distance = signed_distance(V, F, shell)
    assert distance.std() == pytest.approx(0.01, rel=0.1)
    # One normal of the ball is its radius: taking the shell off leads to the foot.
    foot = shell * (1 - distance / np.linalg.norm(shell, axis=1))[:, None]
    np.testing.assert_allclose(samples.W[4000:], affine(foot), atol=0.01)
    np.testing.assert_allclose(samples.W[:4000], 1 - affine(x), atol=1e-6)
    assert (signed_distance(V, F, x) > 0.1).any()


@pytest.mark.parametrize("d", [2, 3])
def test_facets_without_area_do_no_harm(d: int, rng: np.random.Generator) -> None:
    V, F, V_volume, T = solid(d)
    F = np.concatenate([F, np.zeros((1, d), dtype=int)])
    samples = volume_samples(V, F, affine(V), V_volume, T, affine(V_volume), n=500, shell=0.01, rng=rng)
    assert np.isfinite(samples.x_rest).all()
    np.testing.assert_allclose(samples.W.sum(axis=1), 1, atol=1e-5)
