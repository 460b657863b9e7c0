import numpy as np
import pytest
import torch

from nilbs.engine.array_engine import WIDTH, ArrayEngine
from nilbs.fields.array_field import ArrayField
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import forward_kinematics, random_rotations
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import inverse_linear_blend_skinning, linear_blend_skinning
from nilbs.geometry.winding import occupancy
from nilbs.methods.nearest.field import NearestVertex


def bent(c, rng: np.random.Generator) -> np.ndarray:
    return forward_kinematics(
        c.skeleton.C, c.skeleton.BE, c.skeleton.P, random_rotations(c.skeleton.P, c.d, 1, std=0.2, rng=rng)
    )[0]


def answers(c, B: np.ndarray, x: np.ndarray):
    return ArrayField(ArrayEngine(NearestVertex(c.V, c.F, c.W))).posed(torch.as_tensor(B))(torch.as_tensor(x))


@pytest.mark.parametrize("d", [2, 3])
def test_a_rigid_motion_is_undone(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    world = rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), rng.normal(size=d))
    B = np.repeat(world[None], len(c.skeleton.BE), axis=0)
    x_rest = rng.uniform(c.V.min(axis=0) - 0.1, c.V.max(axis=0) + 0.1, (500, d))
    answer = answers(c, B, transform_points(world, x_rest))
    np.testing.assert_allclose(answer.x_rest, x_rest, atol=1e-9)
    np.testing.assert_allclose(answer.distance, signed_distance(c.V, c.F, x_rest), atol=1e-9)
    np.testing.assert_array_equal(answer.level, answer.distance)
    assert answer.width == WIDTH


@pytest.mark.parametrize("d", [2, 3])
def test_it_equals_the_search_written_out(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    U = linear_blend_skinning(c.V, c.W, B)
    x = rng.uniform(U.min(axis=0), U.max(axis=0), (30, d))
    answer = answers(c, B, x)
    for i in range(len(x)):
        vertex = np.linalg.norm(U - x[i], axis=1).argmin()
        x_rest = inverse_linear_blend_skinning(x[i : i + 1], c.W[vertex : vertex + 1], B)
        np.testing.assert_allclose(answer.x_rest[i], x_rest[0], atol=1e-12)
        np.testing.assert_allclose(answer.distance[i], signed_distance(c.V, c.F, x_rest)[0], atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_vertices_go_back_to_themselves_and_a_bent_body_is_about_right(d: int, characters, rng) -> None:
    c = characters[d]
    B = bent(c, rng)
    U = linear_blend_skinning(c.V, c.W, B)
    back = np.linalg.norm(answers(c, B, U).x_rest.numpy() - c.V, axis=1)
    assert np.quantile(back, 0.99) < 1e-9 * c.L
    x = rng.uniform(U.min(axis=0), U.max(axis=0), (3000, d))
    assert ((answers(c, B, x).level < 0).numpy() == occupancy(U, c.F, x)).mean() > 0.97

    def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance = answers(c, B, x).distance.numpy()
        return distance, distance

    assert is_watertight(field_surface(levels, Grid.cube(U, 24))[1])


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_whose_blend_has_no_inverse_is_outside(d: int, characters) -> None:
    c = characters[d]
    B = np.repeat(np.diag([0.0] * d + [1])[None], len(c.skeleton.BE), axis=0)
    answer = answers(c, B, c.V[:5])
    assert (answer.distance > 5 * c.L).all()
    assert torch.isfinite(answer.x_rest).all()


def test_answers_have_the_type_of_the_module(characters) -> None:
    c = characters[3]
    posed = (
        ArrayField(ArrayEngine(NearestVertex(c.V, c.F, c.W)))
        .float()
        .posed(torch.eye(4).expand(len(c.skeleton.BE), 4, 4))
    )
    answer = posed(torch.as_tensor(c.V).float())
    assert answer.level.dtype == answer.distance.dtype == answer.x_rest.dtype == torch.float32
    empty = posed(torch.zeros((0, 3)))
    assert empty.level.shape == (0,)
    assert empty.x_rest.shape == (0, 3)
