"""Weights from another mesh: matched by closest points, filled over the mesh elsewhere, always on the simplex."""

import numpy as np
import pytest

from nilbs.geometry.weight_transfer import transfer_weights


def tube(radius, *, around=24, along=17, length=4.0):
    """Vertices and outward triangles of an open cylinder about the x axis."""
    turn, x = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, length, along))
    V = np.stack([x, radius * np.cos(turn), radius * np.sin(turn)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij"))
    a, b = i * around + j, i * around + (j + 1) % around
    return V, np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)])


def sheet(nx=9, ny=5):
    """A grid of triangles in the plane, 4 long and 2 wide."""
    x, y = np.meshgrid(np.linspace(0, 4, nx), np.linspace(0, 2, ny), indexing="ij")
    k = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, e = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    return np.stack([x.ravel(), y.ravel()], 1), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, e], 1)])


def midpoints(n, E):
    """How vertices of a mesh with each triangle cut in four follow from the n before, and its triangles."""
    edges, place = np.unique(
        np.sort(E[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2), axis=0, return_inverse=True
    )
    S = np.zeros((n + len(edges), n))
    S[:n] = np.eye(n)
    for i in (0, 1):
        S[n + np.arange(len(edges)), edges[:, i]] += 0.5
    ab, bc, ca = (n + place.reshape(-1, 3)).T
    a, b, c = E.T
    return S, np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])


def along_x(V):
    """Weights of two bones, linear along x from 0 to 4."""
    share = np.clip(V[:, 0] / 4, 0, 1)
    return np.stack([1 - share, share], axis=1)


def assert_on_the_simplex(W):
    assert W.min() >= 0
    assert W.max() <= 1
    np.testing.assert_allclose(W.sum(axis=1), 1, atol=1e-12)


def shape(d):
    return sheet() if d == 2 else tube(0.5)


@pytest.fixture(params=[2, 3])
def d(request):
    return request.param


def test_the_same_mesh_takes_the_same_weights(d, rng):
    V, E = shape(d)
    W = rng.dirichlet(np.ones(4), size=len(V))
    found = transfer_weights(V, E, V, E, W)
    np.testing.assert_allclose(found.W, W, atol=1e-9)
    assert found.accepted.all()
    assert not found.filled.any()
    assert found.notes == ()


def test_a_cube_with_more_vertices_takes_barycentric_weights(rng):
    """Its edges are sharp: the normal of a place near a corner is that of its triangle, not the mean over corners."""
    V = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    E = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    W = rng.dirichlet(np.ones(3), size=8)
    S, fine = midpoints(len(V), E)
    S2, finer = midpoints(len(S), fine)
    found = transfer_weights(S2 @ S @ V, finer, V, E, W)
    assert found.accepted.all()
    np.testing.assert_allclose(found.W, S2 @ S @ W, atol=1e-9)
    # A source that is cut along all edges has the same normals.
    cut = transfer_weights(S2 @ S @ V, finer, V[E.ravel()], np.arange(36).reshape(-1, 3), W[E.ravel()])
    assert cut.accepted.all()
    np.testing.assert_allclose(cut.W, found.W, atol=1e-9)


@pytest.mark.parametrize(("edge", "slope"), [(0.25, 0.25), (0.3, 0.3), (0.9, 0.4), (0.3, 0.0)])
def test_a_fill_between_straight_ends_is_a_cubic(edge, slope):
    """A strip whose middle, 1 < x < 3, has no source; weights rise to `edge` on the left and fall on the right.

    Minimal squared second derivatives give Hermite's cubic, which peaks in the middle at edge + 2 slope / 4.
    """
    V, E = sheet(65, 9)
    share = edge - slope * np.where(V[:, 0] < 2, 1 - V[:, 0], V[:, 0] - 3)
    ends = E[(V[E][:, :, 0] <= 1).all(axis=1) | (V[E][:, :, 0] >= 3).all(axis=1)]
    found = transfer_weights(V, E, V, ends, np.stack([1 - share, share], axis=1).clip(0, 1), distance=1e-6)
    np.testing.assert_array_equal(found.filled, (V[:, 0] > 1) & (V[:, 0] < 3))
    assert_on_the_simplex(found.W)
    np.testing.assert_allclose(found.W[V[:, 0] == 2, 1], min(edge + slope / 2, 1), atol=0.02)


def test_a_cloth_of_two_layers_matches_with_both_sides():
    V_source, E_source = tube(0.5, along=33)
    outer, E = tube(0.55)
    inner, _ = tube(0.52)
    V, E = np.concatenate([outer, inner]), np.concatenate([E, E[:, ::-1] + len(outer)])
    W = along_x(V_source)
    one = transfer_weights(V, E, V_source, E_source, W)
    assert one.accepted[: len(outer)].all()
    assert not one.accepted[len(outer) :].any()
    assert len(one.notes) == 1
    assert f"{len(inner)} of {len(V)} vertices, with 1 of 2 pieces," in one.notes[0]
    both = transfer_weights(V, E, V_source, E_source, W, both_sides=True)
    assert both.accepted.all()
    for found in (one, both):
        np.testing.assert_allclose(found.W, along_x(V), atol=1e-9)


def test_a_layer_that_is_sewn_to_a_match_is_filled_from_it():
    """The same lining, joined at both ends: its weights follow from the ends."""
    V_source, E_source = tube(0.5, along=33)
    outer, E = tube(0.55)
    inner, _ = tube(0.52)
    n, around = len(outer), 24
    a = np.concatenate([np.arange(around), np.arange(n - around, n)])
    b = np.concatenate([np.roll(np.arange(around), -1), np.roll(np.arange(n - around, n), -1)])
    hem = np.concatenate([np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)])
    V, E = np.concatenate([outer, inner]), np.concatenate([E, E[:, ::-1] + n, hem])
    found = transfer_weights(V, E, V_source, E_source, along_x(V_source))
    assert found.notes == ()
    assert (found.accepted | found.filled).all()
    assert found.filled[n:].sum() > 0.8 * n
    assert np.abs(found.W - along_x(V)).max() < 0.12  # a fill turns slowly at the hem
    assert_on_the_simplex(found.W)


def test_a_piece_without_a_match_takes_the_closest_weights(d):
    V_source, E_source = shape(d)
    away = np.zeros(d)
    away[-1] = 50.0
    V, E = np.concatenate([V_source, V_source[:3] + away]), np.vstack([E_source, len(V_source) + np.arange(3)])
    found = transfer_weights(V, E, V_source, E_source, along_x(V_source), distance=0.01)
    assert found.accepted[:-3].all()
    assert not (found.accepted | found.filled)[-3:].any()
    np.testing.assert_allclose(found.W[-3:], along_x(V[-3:]), atol=1e-6)
    assert f"3 of {len(V)} vertices, with 1 of 2 pieces," in found.notes[0]
    apart = transfer_weights(V_source + away, E_source, V_source, E_source, along_x(V_source), distance=0.01)
    assert f"{len(V_source)} of {len(V_source)} vertices, with 1 of 1 pieces," in apart.notes[0]
    assert_on_the_simplex(apart.W)


def test_vertices_at_one_place_count_as_one(d, rng):
    """With every triangle cut loose from its neighbours nothing changes, filled vertices included."""
    V, E = shape(d)
    kept = E[(V[E].mean(axis=1)[:, 0] < 1.3) | (V[E].mean(axis=1)[:, 0] > 2.6)]
    W = rng.dirichlet(np.ones(3), size=len(V))
    whole = transfer_weights(V, E, V, kept, W, distance=1e-6)
    loose = transfer_weights(V[E.ravel()], np.arange(3 * len(E)).reshape(-1, 3), V, kept, W, distance=1e-6)
    assert whole.filled.any()
    np.testing.assert_allclose(loose.W, whole.W[E.ravel()], atol=1e-9)
    np.testing.assert_array_equal(loose.filled, whole.filled[E.ravel()])
    # So it is with a source that is cut along all edges.
    cut = transfer_weights(
        V, E, V[kept.ravel()], np.arange(3 * len(kept)).reshape(-1, 3), W[kept.ravel()], distance=1e-6
    )
    np.testing.assert_allclose(cut.W, whole.W, atol=1e-6)


def test_moving_scaling_and_turning_facets_change_nothing(d, rng, rigid):
    V, E = shape(d)
    kept = E[V[E].mean(axis=1)[:, 0] < 2]
    W = rng.dirichlet(np.ones(3), size=len(V))
    before = transfer_weights(V, E, V, kept, W, distance=0.02)
    source = np.where((rng.random(len(kept)) < 0.3)[:, None], kept[:, ::-1], kept)
    assert before.filled.any()
    move = rigid(d)
    x = 1000 * (V @ move[:d, :d].T + move[:d, d])
    some = rng.random(len(E)) < 0.3
    turned = np.where(some[:, None], E[:, ::-1], E)
    after = transfer_weights(x, turned, x, source, W, distance=0.02)
    np.testing.assert_array_equal(after.accepted, before.accepted)
    np.testing.assert_allclose(after.W, before.W, atol=1e-6)


def test_broken_meshes_get_weights_on_the_simplex(rng):
    """Triangles without area, with a corner twice, three at an edge and repeated; a vertex of none; a stray needle."""
    V_source, E_source = tube(0.5)
    V, E = tube(0.55)
    n = len(V)
    fin, middle, speck = V[60] * [1, 2, 2], (V[30] + V[31]) / 2, V[200] + 1e-9
    V = np.concatenate([V, [fin, middle, speck, [2.0, 9, 9]]])
    E = np.concatenate(
        [
            E,
            [[60, 61, n], [60, 84, n], [30, 31, n + 1], [30, 30, 31], [200, 201, n + 2], [300, 3, 4]],
            E[:40],
            E[5:9, ::-1],
        ]
    )
    found = transfer_weights(V, E, V_source, E_source, along_x(V_source))
    assert_on_the_simplex(found.W)
    assert found.accepted.sum() > n / 2
    assert np.abs(found.W[:n] - along_x(V[:n])).max() < 0.2
    assert "1 of 412 vertices have no match" in found.notes[0]


@pytest.mark.parametrize("E", [np.zeros((0, 3), int), [[0, 0, 1]]])
def test_vertices_without_triangles_take_the_closest_weights(E):
    V_source, E_source = sheet()
    V = np.array([[1.0, 1], [3, 5]])
    found = transfer_weights(V, E, V_source, E_source, along_x(V_source))
    np.testing.assert_allclose(found.W, along_x(V), atol=1e-12)
    assert not found.accepted.any()
    assert found.notes[0].startswith("2 of 2 vertices have no match")
    nothing = transfer_weights(np.zeros((0, 2)), np.zeros((0, 3), int), V_source, E_source, along_x(V_source))
    assert nothing.W.shape == (0, 2)
    assert nothing.notes == ()


def test_wrong_input(d):
    V, E = shape(d)
    W = along_x(V)
    with pytest.raises(ValueError, match=r"W_source must be \(k, b\)"):
        transfer_weights(V, E, V, E, W[1:])
    with pytest.raises(ValueError, match=r"V_source must be \(k, d\) = "):
        transfer_weights(V, E, np.zeros((len(V), 5 - d)), E, W)
    with pytest.raises(ValueError, match=r"E must be \(m, 3\)"):
        transfer_weights(V, E[:, :2], V, E, W)
    with pytest.raises(ValueError, match=r"E_source\[0\] = .* does not index the \d+ vertices of the source"):
        transfer_weights(V, E, V, E + len(V), W)
    with pytest.raises(ValueError, match="the source has no triangle"):
        transfer_weights(V, E, V, E[:0], W)
    with pytest.raises(ValueError, match="rows of W_source must be non-negative and sum to one"):
        transfer_weights(V, E, V, E, 2 * W)
    with pytest.raises(ValueError, match="distance must be"):
        transfer_weights(V, E, V, E, W, distance=-1)
    with pytest.raises(ValueError, match="angle must be"):
        transfer_weights(V, E, V, E, W, angle=np.nan)
