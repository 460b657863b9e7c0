import numpy as np
import pytest

from nilbs.geometry.facets import is_watertight
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.topology import ridges

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_F = np.array([triangle for a, b, c, e in SIDES for triangle in ([a, b, c], [a, c, e])])


def circle(n):
    angle = np.arange(n) * 2 * np.pi / n
    return np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([np.arange(n), np.roll(np.arange(n), -1)], axis=1)


def strip(n, *, twisted):
    """A closed band of 2 n triangles, with half a turn or without."""
    i = np.arange(n)
    after = (i + 1) % n
    low, high = 2 * after, 2 * after + 1
    if twisted:
        low, high = np.where(after == 0, 1, low), np.where(after == 0, 0, high)
    F = np.concatenate([np.stack([2 * i, low, 2 * i + 1], 1), np.stack([2 * i + 1, low, high], 1)])
    u, w = np.repeat(i * 2 * np.pi / n, 2), np.tile([-0.3, 0.3], n)
    half = u / 2 if twisted else 0 * u
    r = 1 + w * np.cos(half)
    return np.stack([r * np.cos(u), r * np.sin(u), w * np.sin(half) + w * (not twisted)], axis=1), F


def turned(F, which):
    return np.where(np.asarray(which)[:, None], F[:, [0, 2, 1]] if F.shape[1] == 3 else F[:, ::-1], F)


@pytest.mark.parametrize(("V", "F"), [(CUBE, CUBE_F), circle(30), strip(20, twisted=False)])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_a_minority_is_turned_back(V, F, share, rng):
    for _ in range(20):
        which = np.zeros(len(F), dtype=bool)
        which[rng.choice(len(F), int(share * len(F)), replace=False)] = True
        G, flipped = coherent_orientation(V, turned(F, which))
        assert np.array_equal(flipped, which)
        assert np.array_equal(G, F)


def test_the_majority_is_of_area(rng):
    # Two long triangles against ten of a small lid.
    V, F = CUBE * [1, 1, 100], CUBE_F
    small = V[F][:, :, 2].max(axis=1) == V[F][:, :, 2].min(axis=1)
    assert small.sum() == 4
    G, flipped = coherent_orientation(V * [1, 0.001, 1], turned(F, ~small))
    assert np.array_equal(flipped, small)
    assert is_watertight(G)


def test_an_inside_out_surface_stays_so():
    G, flipped = coherent_orientation(CUBE, CUBE_F[:, ::-1])
    assert not flipped.any()
    assert np.array_equal(G, CUBE_F[:, ::-1])


def test_every_patch_decides_for_itself(rng):
    V = np.concatenate([CUBE, CUBE + 3])
    which = np.zeros(24, dtype=bool)
    which[[3, *range(13, 24)]] = True
    _, flipped = coherent_orientation(V, turned(np.concatenate([CUBE_F, CUBE_F + 8]), which))
    assert np.flatnonzero(flipped).tolist() == [3, 12]


def test_patches_end_where_three_facets_meet():
    V = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]])
    F = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    G, flipped = coherent_orientation(V, F)
    assert not flipped.any()
    assert np.array_equal(G, F)


def test_random_patches_agree_everywhere(rng):
    """In random pieces of a surface with random turns, neighbours agree afterwards."""
    for _ in range(30):
        F = CUBE_F[rng.permutation(12)[: rng.integers(1, 13)]]
        G, flipped = coherent_orientation(CUBE, turned(F, rng.random(len(F)) < 0.5))
        assert ridges(G).neighbours()[2].all()
        assert np.array_equal(np.sort(G), np.sort(F))
        assert np.array_equal(turned(G, flipped), turned(F, (turned(G, flipped) != F).any(axis=1)))


def disagreements(F):
    return int((~ridges(F).neighbours()[2]).sum())


def test_a_moebius_strip_is_never_made_worse(rng):
    V, F = strip(12, twisted=True)
    assert disagreements(F) == 1
    G, flipped = coherent_orientation(V, F)
    assert not flipped.any()
    for _ in range(20):
        broken = turned(F, rng.random(24) < 0.3)
        G, flipped = coherent_orientation(V, broken)
        assert disagreements(G) <= disagreements(broken)
        assert disagreements(G) == 1  # every loop with half a turn has one
        assert np.array_equal(turned(G, flipped), broken)


def test_a_wide_moebius_strip_keeps_about_its_seam(rng):
    V, F = strip(12, twisted=True)
    # Every triangle is cut in four, twice: a wide strip.
    for _ in range(2):
        edge = ridges(F)
        middle = len(V) + edge.ridge
        V = np.concatenate([V, V[edge.corners].mean(axis=1)])
        a, b, c = F.T
        ab, bc, ca = middle.T
        F = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    seam = disagreements(F)
    assert seam == 4
    for _ in range(20):
        number = rng.permutation(len(V))
        broken = turned(rng.permutation(number[F]), rng.random(len(F)) < 0.02)
        assert disagreements(broken) > seam
        # Facets beside the seam may be turned or not.
        assert disagreements(coherent_orientation(V[np.argsort(number)], broken)[0]) <= seam + 1


def test_beside_a_moebius_strip_others_are_turned():
    V, F = strip(12, twisted=True)
    which = np.arange(12) == 5
    _, flipped = coherent_orientation(
        np.concatenate([V, CUBE + 5]), np.concatenate([F, turned(CUBE_F, which) + len(V)])
    )
    assert np.flatnonzero(flipped).tolist() == [24 + 5]


def test_two_facets_that_are_neighbours_twice():
    V = np.eye(4)[:, :3]
    G, _ = coherent_orientation(V, [[0, 1, 2], [0, 1, 2]])
    assert disagreements(G) == 0


@pytest.mark.parametrize("d", [2, 3])
def test_no_facets(d):
    G, flipped = coherent_orientation(np.zeros((0, d)), np.zeros((0, d), int))
    assert G.shape == (0, d)
    assert flipped.shape == (0,)


def test_wrong_arguments():
    with pytest.raises(ValueError, match="does not index the 8 vertices"):
        coherent_orientation(CUBE, [[0, 1, 8]])
