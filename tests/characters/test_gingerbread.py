"""The gingerbread man: sound meshes, a skeleton inside them, and files that agree with the code."""

import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from nilbs.characters.gingerbread import gingerbread, write_gingerbread
from nilbs.geometry.kinematics import bone_parents
from nilbs.geometry.winding import winding_number
from nilbs.io.mesh import read_mesh
from nilbs.io.tgf import read_tgf

EXAMPLES = Path(__file__).parents[2] / "examples"


def directed_edges(F: np.ndarray) -> Counter:
    return Counter(map(tuple, F[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))


def smallest_angle(V: np.ndarray, F: np.ndarray) -> float:
    """The smallest corner of all triangles, in degrees."""
    least = np.inf
    for k in range(3):
        a, b = V[F[:, (k + 1) % 3]] - V[F[:, k]], V[F[:, (k + 2) % 3]] - V[F[:, k]]
        cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        least = min(least, float(np.degrees(np.arccos(cosine.max()))))
    return least


def test_flat_triangles_are_counter_clockwise_and_well_shaped():
    V, T, _, _ = gingerbread(2)
    assert 2000 <= len(V) <= 3000
    a, b = V[T[:, 1]] - V[T[:, 0]], V[T[:, 2]] - V[T[:, 0]]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0).all()
    assert smallest_angle(V, T) > 20
    assert set(T.ravel()) == set(range(len(V)))


def test_flat_outline_is_one_closed_evenly_spaced_curve_with_the_interior_on_its_left():
    V, T, _, _ = gingerbread(2)
    edges = directed_edges(T)
    assert max(edges.values()) == 1
    outline = {a: b for a, b in edges if (b, a) not in edges}
    loop = [0]
    while (after := outline[loop[-1]]) != 0:
        loop.append(after)
    # The outline's vertices come first; were an edge of it missing, a triangle outside would bridge it.
    assert loop == list(range(len(outline)))
    lengths = np.linalg.norm(np.roll(V[loop], -1, axis=0) - V[loop], axis=1)
    np.testing.assert_allclose(lengths, lengths.mean(), rtol=0.02)
    # One curve and one component: vertices - edges + triangles = 1.
    assert len(V) - (len(edges) + len(outline)) // 2 + len(T) == 1


def test_cookie_is_a_closed_sphere_oriented_outward():
    V, F, _, _ = gingerbread(3)
    assert 6000 <= len(V) <= 10000
    edges = directed_edges(F)
    assert max(edges.values()) == 1
    assert all((b, a) in edges for a, b in edges)
    assert len(V) - len(edges) // 2 + len(F) == 2
    assert np.einsum("ni,ni->", V[F[:, 0]], np.cross(V[F[:, 1]], V[F[:, 2]])) > 0
    assert smallest_angle(V, F) > 12


def test_cookie_is_centred_at_z_0_and_has_the_flat_figures_silhouette():
    V, cookie = gingerbread(2)[0], gingerbread(3)[0]
    assert cookie[:, 2].min() == -cookie[:, 2].max()
    np.testing.assert_allclose(cookie[:, :2].min(axis=0), V.min(axis=0), atol=5e-4)
    np.testing.assert_allclose(cookie[:, :2].max(axis=0), V.max(axis=0), atol=5e-4)


def test_tetgen_fills_the_cookie():
    import igl.copyleft.tetgen

    V, F, C, BE = gingerbread(3)
    _, T, _ = igl.copyleft.tetgen.mesh_with_skeleton(V, F, C, BE=BE, tetgen_flags="pq2YQ")
    assert len(T) > 10_000


@pytest.mark.parametrize("d", [2, 3])
def test_skeleton_is_one_tree_of_bones_inside_the_body(d):
    V, E, C, BE = gingerbread(d)
    assert C.shape == (len(BE) + 1, d)
    assert (bone_parents(BE) == -1).nonzero()[0].tolist() == [0]
    if d == 2:
        edges = directed_edges(E)
        E = np.array([(a, b) for a, b in edges if (b, a) not in edges])
    s = np.linspace(0, 1, 20)[:, None, None]
    along = C[BE[:, 0]] * (1 - s) + C[BE[:, 1]] * s
    for shift in 0.04 * np.vstack([np.eye(d), -np.eye(d)]):  # not only inside: clear of the surface
        np.testing.assert_allclose(winding_number(V, E, along.reshape(-1, d) + shift), 1, atol=0.05)
    assert np.linalg.norm(C[BE[:, 1]] - C[BE[:, 0]], axis=1).min() > 0.08


def test_flat_mesh_holds_the_bones_as_chains_of_edges():
    V, T, C, BE = gingerbread(2)
    edges = directed_edges(T)
    for start, end in C[BE]:
        axis = (end - start) / np.linalg.norm(end - start)
        s = (V - start) @ axis
        off = np.linalg.norm(V - start - s[:, None] * axis, axis=1)
        on = np.flatnonzero((off < 1e-9) & (s > -1e-9) & (s < np.linalg.norm(end - start) + 1e-9))
        chain = on[np.argsort(s[on])]
        np.testing.assert_allclose(V[chain[[0, -1]]], [start, end], atol=1e-9)
        assert all((a, b) in edges or (b, a) in edges for a, b in pairwise(chain))


def test_figure_is_its_own_mirror_image():
    V, T, _, _ = gingerbread(2)
    edges = directed_edges(T)
    outline = V[[a for a, b in edges if (b, a) not in edges]]
    mirrored = outline * [-1, 1]
    distance = np.linalg.norm(outline[:, None] - mirrored[None], axis=-1).min(axis=1)
    assert distance.max() < 1e-6


def test_another_dimension_is_refused():
    with pytest.raises(ValueError, match="d must be 2 or 3, got 4"):
        gingerbread(4)


def in_order(E):
    """Triangles from their first vertex on, sorted."""
    first = E.argmin(axis=1)[:, None]
    E = np.take_along_axis(E, (first + np.arange(3)) % 3, axis=1)
    return E[np.lexsort(E.T[::-1])]


def test_script_regenerates_the_committed_files(tmp_path):
    script = EXAMPLES / "make_assets.py"
    printed = subprocess.run([sys.executable, script, tmp_path], check=True, capture_output=True, text=True).stdout
    assert len(printed.splitlines()) == 4
    for name, d in (("gingerbread.obj", 2), ("cookie.obj", 3)):
        committed = EXAMPLES / "assets" / name
        assert committed.stat().st_size < 1_000_000
        (V, E), (V_again, E_again) = read_mesh(committed), read_mesh(tmp_path / name)
        assert V.shape[1] == d
        np.testing.assert_allclose(V_again, V, atol=1e-5)
        # Which of them come first is up to the last digits of a processor.
        np.testing.assert_array_equal(in_order(E_again), in_order(E))
    C, BE = read_tgf(EXAMPLES / "assets" / "gingerbread.tgf")
    C_again, BE_again = read_tgf(tmp_path / "gingerbread.tgf")
    np.testing.assert_allclose(C_again, C, atol=1e-5)
    np.testing.assert_array_equal(BE_again, BE)


@pytest.mark.parametrize("d", [2, 3])
def test_files_hold_what_the_function_returns(d, tmp_path):
    V, E, C, BE = gingerbread(d)
    mesh, rig = write_gingerbread(tmp_path / "new" / "folder", d)
    V_read, E_read = read_mesh(mesh)
    np.testing.assert_allclose(V_read, V, atol=6e-7)
    np.testing.assert_array_equal(E_read, E)
    C_read, BE_read = read_tgf(rig)
    np.testing.assert_allclose(C_read[:, :d], C, atol=6e-7)
    np.testing.assert_array_equal(BE_read, BE)
