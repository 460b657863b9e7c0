import numpy as np
import pytest
import torch

from nilbs.engine.array_engine import WIDTH
from nilbs.engine.unit_frame import UnitFrame
from nilbs.geometry.distance import signed_distance
from nilbs.geometry.facets import is_watertight
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices, transform_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.methods.mesh_lbs import MeshSkinning
from nilbs.methods.mesh_lbs.field import PosedMesh


def bent(c, rng: np.random.Generator) -> np.ndarray:
    theta = rng.normal(scale=0.2, size=(len(c.skeleton.BE), 3 if c.d == 3 else 1))
    return rigid_transforms(rotation_matrices(theta), np.zeros(c.d))


def in_unit_frame(c, x: np.ndarray, B: np.ndarray) -> tuple[torch.Tensor, UnitFrame]:
    frame = UnitFrame(c, torch.as_tensor(B))
    return frame.points(torch.as_tensor(x)), frame


@pytest.mark.parametrize("d", [2, 3])
def test_its_distance_is_that_of_the_posed_mesh(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B = bent(c, rng)
    U = linear_blend_skinning(c.V, c.W, B)
    grid = Grid.cube(U, 16)
    x = rng.uniform(grid.lower, grid.upper, (500, d))
    x_unit, frame = in_unit_frame(c, x, B)
    answer = MeshSkinning().field(c).posed(frame.B)(x_unit)
    assert answer.x_rest.shape == x.shape
    assert answer.x_rest.isnan().all()
    np.testing.assert_allclose(answer.distance * c.L, signed_distance(U, c.F, x), atol=1e-9)
    np.testing.assert_array_equal(answer.level, answer.distance)
    assert answer.width == WIDTH
    mesh = PosedMesh(U, c.F)
    inside = mesh.inside(x)
    assert 0 < inside.sum() < len(x)
    np.testing.assert_array_equal(answer.level < 0, inside)
    surface, facets = mesh.extract_on(grid)
    assert is_watertight(facets)
    assert np.abs(signed_distance(U, c.F, surface)).max() < grid.spacing


@pytest.mark.parametrize("d", [2, 3])
def test_the_world_moves_and_the_answers_stay(d: int, characters, rng: np.random.Generator) -> None:
    c = characters[d]
    B, x = bent(c, rng), rng.uniform(-0.5, 0.5, (200, d))
    world = rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), rng.normal(size=d))
    field = MeshSkinning().field(c)
    (here, frame), (there, moved) = (
        in_unit_frame(c, x, B),
        in_unit_frame(c, transform_points(world, x), world @ B),
    )
    torch.testing.assert_close(
        field.posed(moved.B)(there).distance, field.posed(frame.B)(here).distance, rtol=0, atol=1e-9
    )


def test_answers_have_the_type_of_the_module(characters) -> None:
    c = characters[3]
    field = MeshSkinning().field(c).float()
    assert not field.state_dict()
    answer = field.posed(torch.eye(4).expand(len(c.skeleton.BE), 4, 4))(torch.zeros((0, 3)))
    assert answer.level.shape == answer.distance.shape == (0,)
    assert answer.level.dtype == answer.x_rest.dtype == torch.float32
