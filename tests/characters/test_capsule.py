"""The capsule: a closed form that its meshes approach from inside, and weights that pass from bone to bone."""

import numpy as np
import pytest

from nilbs.characters.capsule import capsule, capsule_mesh
from nilbs.geometry.diagnosis import enclosed_volume, surface_report
from nilbs.geometry.facets import facet_areas
from nilbs.geometry.volume import boundary_facets, element_volumes

LENGTH, RADIUS = 1.0, 0.15
# Volume, or area in the plane, and what bounds it.
SIZE = {
    2: 2 * RADIUS * (LENGTH - 2 * RADIUS) + np.pi * RADIUS**2,
    3: np.pi * RADIUS**2 * (LENGTH - 2 * RADIUS) + 4 / 3 * np.pi * RADIUS**3,
}
SKIN = {
    2: 2 * (LENGTH - 2 * RADIUS) + 2 * np.pi * RADIUS,
    3: 2 * np.pi * RADIUS * (LENGTH - 2 * RADIUS) + 4 * np.pi * RADIUS**2,
}


def facets(E: np.ndarray, d: int) -> np.ndarray:
    return boundary_facets(E) if d == 2 else E


def distance_to_axis(x: np.ndarray) -> np.ndarray:
    half = LENGTH / 2 - RADIUS
    nearest = np.zeros_like(x)
    nearest[:, 1] = np.clip(x[:, 1], -half, half)
    return np.linalg.norm(x - nearest, axis=1)


@pytest.mark.parametrize("d", [2, 3])
def test_the_volume_comes_from_below_with_the_square_of_the_edges(d):
    errors = []
    for resolution in (16, 32, 64):
        V, E = capsule_mesh(length=LENGTH, radius=RADIUS, resolution=resolution, d=d)
        errors.append(1 - enclosed_volume(V, facets(E, d)) / SIZE[d])
    assert all(error > 0 for error in errors)
    assert errors[-1] < 0.002
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4, rtol=0.1)


@pytest.mark.parametrize("d", [2, 3])
def test_the_skin_comes_from_below_as_well(d):
    areas = []
    for resolution in (16, 64):
        V, E = capsule_mesh(length=LENGTH, radius=RADIUS, resolution=resolution, d=d)
        areas.append(facet_areas(V, facets(E, d)).sum() / SKIN[d])
    assert areas[0] < areas[1] < 1
    assert areas[1] > 0.997


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("resolution", [6, 7, 13, 32])
def test_the_mesh_is_a_clean_solid_whose_skin_lies_on_the_capsule(d, resolution):
    V, E = capsule_mesh(length=LENGTH, radius=RADIUS, resolution=resolution, d=d)
    F = facets(E, d)
    report = surface_report(V, F)
    assert report.watertight
    assert report.components == 1
    assert not report.solid_defects()
    assert set(E.ravel()) == set(range(len(V)))
    np.testing.assert_allclose(distance_to_axis(V[np.unique(F)]), RADIUS, rtol=1e-12)
    np.testing.assert_allclose(np.abs(V[:, 1]).max(), LENGTH / 2)
    if d == 2:
        assert element_volumes(V, E).min() > 0
        np.testing.assert_allclose(element_volumes(V, E).sum(), enclosed_volume(V, F))
    else:
        edges = len(F) * 3 // 2
        assert len(V) - edges + len(F) == 2


@pytest.mark.parametrize("resolution", [16, 33])
def test_triangles_are_well_shaped(resolution):
    V, E = capsule_mesh(length=LENGTH, radius=RADIUS, resolution=resolution)
    sides = np.linalg.norm(V[E[:, [1, 2, 0]]] - V[E], axis=2)
    assert (sides.max(axis=1) / sides.min(axis=1)).max() < 1.7
    a, b, c = np.sort(sides, axis=1).T
    assert np.degrees(np.arccos((b**2 + c**2 - a**2) / (2 * b * c))).min() > 33


def test_one_capsule_is_the_other_scaled():
    V, E = capsule_mesh(length=1.0, radius=0.2, resolution=12)
    V_large, E_large = capsule_mesh(length=30.0, radius=6.0, resolution=12)
    np.testing.assert_array_equal(E, E_large)
    np.testing.assert_allclose(V_large, 30 * V, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_bones_stand_in_a_row_and_their_weights_mirror_each_other(d):
    character = capsule(bones=3, length=1.0, radius=0.08, resolution=12, d=d)
    assert character.d == d
    assert character.skeleton.P.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(np.diff(character.skeleton.C[:, 1]), (1 - 0.16) / 3)
    assert not character.skeleton.C[:, [k for k in range(d) if k != 1]].any()
    np.testing.assert_allclose(character.W.sum(axis=1), 1)
    y = character.V[:, 1]
    assert character.W[y < -0.4, 0].min() > 0.99
    assert character.W[y > 0.4, 2].min() > 0.99
    assert character.W[np.abs(y) < 0.02, 1].min() > 0.9
    order = np.argsort(y)
    heights = np.array([0.08, 0.14, 0.2])
    highest = np.interp(heights, y[order], character.W[order, 2])
    np.testing.assert_allclose(np.interp(-heights, y[order], character.W[order, 0]), highest, atol=0.05)
    assert (np.diff(highest) > 0.1).all()


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_the_same_every_time(d):
    first, second = (capsule(length=1.0, radius=0.05, resolution=8, d=d) for _ in range(2))
    for name, array in first.arrays().items():
        np.testing.assert_array_equal(array, second.arrays()[name])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"length": 0.3}, "more than twice the radius"),
        ({"radius": 0.0}, "more than twice the radius"),
        ({"resolution": 5}, "at least 6"),
        ({"bones": 0}, "at least 1"),
        ({"d": 4}, "d must be 2 or 3"),
    ],
)
def test_wrong_capsules_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        capsule(**{"length": LENGTH, "radius": RADIUS, "resolution": 8, **wrong})
