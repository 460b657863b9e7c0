import numpy as np
import pytest
import torch

from nilbs.fields.array_field import WIDTH
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.mesh_lbs import MeshLbs, MeshLbsField


def bent(c, rng: np.random.Generator) -> np.ndarray:
    theta = rng.normal(scale=0.2, size=(len(c.skeleton.BE), 3 if c.d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), np.zeros(c.d))


@pytest.mark.parametrize("d", [2, 3])
def test_it_answers_with_the_posed_mesh(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    U = linear_blend_skinning(c.V, c.W, B)
    grid = Grid.cube(U, 16)
    x = rng.uniform(grid.lower, grid.upper, (500, d))
    answer = MeshLbsField(c.V, c.F, c.W).posed(torch.as_tensor(B))(torch.as_tensor(x))
    assert answer.x_rest.shape == x.shape
    assert answer.x_rest.isnan().all()
    np.testing.assert_array_equal(answer.distance, signed_distance(U, c.F, x))
    np.testing.assert_allclose(answer.logit, -answer.distance / WIDTH)
    mesh = MeshLbs(U, c.F)
    inside = mesh.inside(x)
    assert 0 < inside.sum() < len(x)
    np.testing.assert_array_equal(answer.logit > 0, inside)
    surface, facets = mesh.extract_on(grid)
    assert is_watertight(facets)
    assert np.abs(signed_distance(U, c.F, surface)).max() < grid.spacing


@pytest.mark.parametrize("d", [2, 3])
def test_the_world_moves_and_the_answers_stay(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B, x = bent(c, rng), rng.uniform(-0.5, 0.5, (200, d))
    world = rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), rng.normal(size=d))
    field = MeshLbsField(c.V, c.F, c.W)
    here = field.posed(torch.as_tensor(B))(torch.as_tensor(x))
    there = field.posed(torch.as_tensor(world @ B))(torch.as_tensor(transform_points(world, x)))
    torch.testing.assert_close(there.distance, here.distance, rtol=0, atol=1e-9)


def test_answers_have_the_type_of_the_module_and_logit_has_all_poses(characters, rng: np.random.Generator) -> None:
    c = characters[2]
    field = MeshLbsField(c.V, c.F, c.W)
    B, x = torch.as_tensor(np.stack([bent(c, rng) for _ in range(2)])), torch.as_tensor(rng.normal(size=(2, 9, 2)))
    logit = field.logit(x, B)
    assert logit.dtype == torch.float64
    for p in range(2):
        torch.testing.assert_close(logit[p], field.posed(B[p])(x[p]).logit)
    assert not torch.allclose(logit[0], logit[1])
    single = field.float()
    assert not single.state_dict()
    assert single.logit(x, B).dtype == torch.float32
    torch.testing.assert_close(single.logit(x, B).double(), logit, rtol=1e-6, atol=1e-6)


def test_no_points(characters) -> None:
    c = characters[3]
    answer = MeshLbsField(c.V, c.F, c.W).posed(torch.eye(4).expand(len(c.skeleton.BE), 4, 4))(torch.zeros((0, 3)))
    assert answer.logit.shape == answer.distance.shape == (0,)
