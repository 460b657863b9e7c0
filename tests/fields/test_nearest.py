import numpy as np
import pytest

from nilbs.fields.nearest import NearestVertex
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.occupancy import occupancy
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.motion import random_motion


@pytest.mark.parametrize("d", [2, 3])
def test_a_rigid_motion_is_undone(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    world = rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), rng.normal(size=d))
    B = np.repeat(world[None], len(c.BE), axis=0)
    x_rest = rng.uniform(c.V.min(axis=0) - 0.1, c.V.max(axis=0) + 0.1, (500, d))
    nearest = NearestVertex(c.V, c.F, c.W, B)
    np.testing.assert_allclose(nearest.rest_points(transform_points(world, x_rest)), x_rest, atol=1e-9)
    np.testing.assert_array_equal(nearest.inside(transform_points(world, x_rest)), occupancy(c.V, c.F, x_rest))


@pytest.mark.parametrize("d", [2, 3])
def test_vertices_go_back_to_themselves_and_a_bent_body_is_about_right(d: int, characters, rng) -> None:
    c = characters[d]
    B = random_motion(c, frames=3, amplitude=0.3)[1]
    nearest = NearestVertex(c.V, c.F, c.W, B)
    U = linear_blend_skinning(c.V, c.W, B)
    back = np.linalg.norm(nearest.rest_points(U) - c.V, axis=1)
    assert np.quantile(back, 0.99) < 1e-9 * c.L
    x = rng.uniform(U.min(axis=0), U.max(axis=0), (3000, d))
    assert (nearest.inside(x) == occupancy(U, c.F, x)).mean() > 0.97
    surface = nearest.extract_on(Grid.cube(U, 24))
    assert is_watertight(surface[1])


def test_a_blend_without_an_inverse_is_outside(characters) -> None:
    c = characters[2]
    B = np.repeat(np.diag([0.0, 0, 1])[None], len(c.BE), axis=0)
    nearest = NearestVertex(c.V, c.F, c.W, B)
    assert not nearest.inside(c.V[:5]).any()
