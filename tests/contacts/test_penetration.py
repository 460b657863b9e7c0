import numpy as np
import pytest

from nilbs.contacts.penetration import penetration


@pytest.mark.parametrize("d", [2, 3])
def test_depth_and_way_out_are_those_of_the_capsule(capsules, moved, capsule_distance, rng, d) -> None:
    x = rng.uniform(-0.6, 0.6, (3000, d))
    found = penetration(capsules[d], x + np.eye(d)[0], moved(d, 1.0))
    true = capsule_distance(x)
    sure = np.abs(true) > 2e-3  # the mesh lies inside the capsule by less
    np.testing.assert_allclose(found.depth[sure], np.maximum(-true[sure], 0), atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(found.way_out, axis=1), found.depth, atol=1e-12)
    inside = found.facet >= 0
    np.testing.assert_allclose(capsule_distance((x + found.way_out)[inside]), 0, atol=2e-3)
    assert 100 < inside.sum() < 2000
    assert (found.way_out[~inside] == 0).all()
    assert np.isnan(found.barycentric[~inside]).all()
    F, U = capsules[d].character.F, capsules[d].posed(moved(d)).U
    place = np.einsum("nc,ncd->nd", found.barycentric[inside], U[F[found.facet[inside]]])
    np.testing.assert_allclose(place, (x + found.way_out)[inside], atol=1e-9)


def test_several_poses_are_each_by_itself(capsules, moved, rng) -> None:
    x, poses = rng.uniform(-0.3, 0.3, (2, 50, 3)), np.stack([moved(3), moved(3, 0.1)])
    together = penetration(capsules[3], x, poses)
    for k in range(2):
        for whole, alone in zip(together, penetration(capsules[3], x[k], poses[k]), strict=True):
            np.testing.assert_array_equal(whole[k], alone)


def test_no_points(capsules, moved) -> None:
    found = penetration(capsules[2], np.empty((0, 2)), moved(2))
    assert [part.shape for part in found] == [(0,), (0, 2), (0,), (0, 2)]
    with pytest.raises(ValueError, match=r"x must be .*\(n, 2\)"):
        penetration(capsules[2], np.empty((0, 3)), moved(2))
