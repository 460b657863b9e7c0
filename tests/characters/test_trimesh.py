"""A character as a mesh of trimesh, and back."""

import numpy as np
import pytest
import trimesh

from nilbs.characters.character import assemble
from nilbs.characters.motion import random_motion
from nilbs.geometry.diagnosis import enclosed_volume
from nilbs.geometry.skeleton import skeleton_of_bones
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.volume import element_volumes

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def posed(characters, d):
    c = characters[d]
    return c, random_motion(c, frames=3).B[2]


def test_vertices_are_the_skin_in_order(characters):
    c, pose = posed(characters, 3)
    assert np.array_equal(c.to_trimesh(pose).vertices, c.skin(pose))
    assert np.array_equal(c.to_trimesh().vertices, c.V)
    assert np.array_equal(c.to_trimesh().faces, c.F)


def test_a_flat_character_is_its_triangles_with_no_height(characters):
    c, pose = posed(characters, 2)
    mesh = c.to_trimesh(pose)
    assert np.array_equal(mesh.vertices[:, :2], linear_blend_skinning(c.V_volume, c.W_volume, pose))
    assert np.allclose(mesh.vertices[: len(c.V), :2], c.skin(pose))
    assert not mesh.vertices[:, 2].any()
    assert np.array_equal(mesh.faces, c.T)


def test_welded_volume_and_bounds_are_ours(characters):
    c, pose = posed(characters, 3)
    mesh, U = c.to_trimesh(pose), c.skin(pose)
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(enclosed_volume(U, c.F), rel=1e-9)
    assert np.abs(mesh.bounds - [U.min(axis=0), U.max(axis=0)]).max() <= 1e-9 * c.L


def test_area_and_bounds_in_the_plane_are_ours(characters):
    c, pose = posed(characters, 2)
    mesh, U = c.to_trimesh(pose), c.skin(pose)
    mesh.merge_vertices()
    U_volume = linear_blend_skinning(c.V_volume, c.W_volume, pose)
    assert mesh.area == pytest.approx(np.abs(element_volumes(U_volume, c.T)).sum(), rel=1e-9)
    assert np.abs(mesh.bounds[:, :2] - [U.min(axis=0), U.max(axis=0)]).max() <= 1e-9 * c.L


@DIMENSIONS
def test_a_mesh_of_trimesh_is_assembled_as_its_arrays(characters, d):
    c = characters[d]
    V, W, E = (c.V, c.W, c.F) if d == 3 else (c.V_volume, c.W_volume, c.T)
    ours, theirs = assemble(V, E, c.skeleton, W), assemble(c.to_trimesh(), c.skeleton, W=W)
    for key, array in ours.arrays().items():
        assert np.array_equal(array, theirs.arrays()[key]), key


def test_a_mesh_of_trimesh_needs_no_weights():
    mesh = trimesh.creation.box((4, 1, 1))
    c = assemble(mesh, skeleton_of_bones([[-1.5, 0, 0], [0, 0, 0], [1.5, 0, 0]], [[0, 1], [1, 2]]))
    assert c.W.shape == (8, 2)
    assert type(c.V) is np.ndarray
    assert (c.W.argmax(axis=1) == (mesh.vertices[:, 0] > 0)).all()


@DIMENSIONS
def test_an_extracted_surface_goes_on_as_a_mesh_of_trimesh(models, characters, d):
    _, pose = posed(characters, d)
    surface = models[d].extract(pose, resolution=24)
    U, F = surface
    mesh = surface.to_trimesh()
    assert np.array_equal(mesh.vertices[:, :d], U)
    if d == 3:
        assert np.array_equal(mesh.faces, F)
        assert mesh.volume == pytest.approx(enclosed_volume(U, F), rel=1e-9)
    else:
        assert isinstance(mesh, trimesh.path.Path2D)
        assert mesh.length == pytest.approx(np.linalg.norm(U[F[:, 1]] - U[F[:, 0]], axis=1).sum())
