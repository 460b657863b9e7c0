import numpy as np
import pytest

from nilbs.geometry.surface import Surface


@pytest.mark.parametrize("d", [2, 3])
def test_to_trimesh_keeps_every_vertex_and_face(rng, d):
    U = np.repeat(rng.normal(size=(4, d)), 2, axis=0)  # pairs at one place, as along a seam
    F = np.array([[7, 0, 2], [1, 4, 6], [0, 1, 2]])  # the last face is collapsed
    mesh = Surface(U, F).to_trimesh()
    assert np.array_equal(mesh.vertices[:, :d], U)
    assert np.array_equal(mesh.faces, F)
    assert not mesh.vertices[:, d:].any()


def test_an_outline_is_a_path():
    U, F = np.array([[0, 0], [2, 0], [2, 1.0]]), np.array([[0, 1], [1, 2], [2, 0]])
    path = Surface(U, F).to_trimesh()
    assert path.length == pytest.approx(3 + 5**0.5)
    assert path.is_closed


def test_an_empty_surface_is_an_empty_mesh():
    surface = Surface(np.zeros((0, 3)), np.zeros((0, 3), int))
    U, F = surface
    assert len(U) == len(F) == len(surface.to_trimesh().faces) == 0
    assert len(Surface(np.zeros((0, 2)), np.zeros((0, 2), int)).to_trimesh().entities) == 0
