"""Surfaces as meshes of libraries that need not be installed."""

import sys

import numpy as np
import pytest

from nilbs.characters.capsule import capsule
from nilbs.geometry.surface import Surface

U = np.array([[0, 0], [2, 0], [2, 1.0]])
OUTLINE = np.array([[0, 1], [1, 2], [2, 0]])
LIBRARIES = pytest.mark.parametrize("library", ["open3d", "pyvista"])


def arrays(library: str, mesh) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of a mesh, whichever it has."""
    if library == "open3d":
        cells = mesh.triangles if hasattr(mesh, "triangles") else mesh.lines
        return np.asarray(mesh.points if hasattr(mesh, "points") else mesh.vertices), np.asarray(cells)
    if mesh.n_lines:
        return np.asarray(mesh.points), mesh.lines.reshape(-1, 3)[:, 1:]
    return np.asarray(mesh.points), mesh.faces.reshape(-1, 4)[:, 1:]


@LIBRARIES
@pytest.mark.parametrize("F", [[[0, 1, 2], [2, 1, 0], [0, 0, 1]], OUTLINE])
def test_every_vertex_and_facet_is_kept(library, F) -> None:
    pytest.importorskip(library, exc_type=ImportError)
    points, cells = arrays(library, getattr(Surface(U, np.array(F)), f"to_{library}")())
    np.testing.assert_array_equal(points, np.insert(U, 2, 0, axis=1))
    np.testing.assert_array_equal(cells, F)


@LIBRARIES
@pytest.mark.parametrize("points", [0, 3])
def test_a_surface_without_facets_has_none(library, points) -> None:
    pytest.importorskip(library, exc_type=ImportError)
    mesh = getattr(Surface(np.eye(3)[:points], np.zeros((0, 3), int)), f"to_{library}")()
    found, cells = arrays(library, mesh)
    assert (len(found), len(cells)) == (points, 0)


@LIBRARIES
@pytest.mark.parametrize("d", [2, 3])
def test_a_character_has_the_mesh_of_trimesh(library, d) -> None:
    pytest.importorskip(library, exc_type=ImportError)
    c = capsule(d=d)
    pose = np.tile(np.eye(d + 1), (len(c.skeleton.BE), 1, 1))
    pose[:, 0, d] = 3
    for chosen in (None, pose):
        points, cells = arrays(library, getattr(c, f"to_{library}")(chosen))
        np.testing.assert_allclose(points, c.to_trimesh(chosen).vertices, atol=1e-12)
        np.testing.assert_array_equal(cells, c.to_trimesh(chosen).faces)


@LIBRARIES
def test_a_missing_library_is_named(library, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ModuleNotFoundError, match=f"^the package {library} is not installed: pip install {library}$"):
        getattr(Surface(U, OUTLINE), f"to_{library}")()
