import numpy as np
import pytest

from nilbs.contacts.pairs import contacts, skin_places

from .conftest import LENGTH, RADIUS


@pytest.mark.parametrize("samples", [None, 2000])
@pytest.mark.parametrize("d", [2, 3])
def test_two_capsules_side_by_side(capsules, moved, capsule_distance, d, samples) -> None:
    model, apart = capsules[d], 0.3
    skin = skin_places(model.character.V, model.character.F, samples=samples)
    found = contacts(model, moved(d), model, moved(d, apart), skins=(skin, skin))
    assert 0 < found.of_b.sum() < len(found.depth)
    shift = np.where(found.of_b[:, None], 0.0, np.eye(d)[0] * apart)
    true = -capsule_distance(found.point - shift)
    np.testing.assert_allclose(found.depth, true, atol=1e-3)
    np.testing.assert_allclose(capsule_distance(found.place - shift), 0, atol=1e-3)
    if samples is None:  # vertices lie where the capsules reach deepest
        assert found.depth.max() == pytest.approx(2 * RADIUS - apart, abs=1e-3)
    # The way out of the other is away from its axis.
    x = found.point - shift
    away = x - np.eye(d)[1] * np.clip(x[:, 1:2], RADIUS - LENGTH / 2, LENGTH / 2 - RADIUS)
    deep = found.depth > 0.01
    cosine = (found.normal * away).sum(axis=1) / np.linalg.norm(away, axis=1)
    assert cosine[deep].min() > 0.99
    np.testing.assert_allclose(found.place, found.point + found.depth[:, None] * found.normal, atol=1e-12)
    F, skins = model.character.F, (model.posed(moved(d)).U, model.posed(moved(d, apart)).U)
    for k in (0, len(found.depth) - 1):
        own, other = skins if not found.of_b[k] else skins[::-1]
        np.testing.assert_allclose(found.barycentric[k] @ own[F[found.facet[k]]], found.point[k], atol=1e-9)
        np.testing.assert_allclose(
            found.other_barycentric[k] @ other[F[found.other_facet[k]]], found.place[k], atol=1e-9
        )


def test_what_is_apart_has_none(capsules, moved) -> None:
    found = contacts(capsules[3], moved(3), capsules[3], moved(3, 0.5))
    assert [part.shape for part in found] == [(0,) if part.ndim == 1 else (0, 3) for part in found]
    with pytest.raises(ValueError, match="one dimension, got 2 and 3"):
        contacts(capsules[2], moved(2), capsules[3], moved(3))


@pytest.mark.parametrize("d", [2, 3])
def test_places_on_a_skin(capsules, d) -> None:
    c = capsules[d].character
    skin = skin_places(c.V, c.F)
    np.testing.assert_array_equal(skin.at(c.V, c.F), c.V[np.unique(c.F)])
    drawn = skin_places(c.V, c.F, samples=500, seed=3)
    np.testing.assert_allclose(drawn.barycentric.sum(axis=1), 1)
    assert drawn.barycentric.min() > -1e-9
    again = skin_places(c.V, c.F, samples=500, seed=3)
    np.testing.assert_array_equal(drawn.facet, again.facet)
