import numpy as np
import pytest

from nilbs.contacts.sweeps import first_touches, skin_speed
from nilbs.geometry.kinematics import forward_kinematics, interpolate_poses

from .conftest import RADIUS


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_that_flies_into_a_body_that_comes_to_meet_it(capsules, moved, d) -> None:
    away = np.eye(d)[0]
    start, end = np.stack([2 * away, 2 * away, 0 * away]), np.stack([0 * away, 2 * away, 0 * away])
    found = first_touches(capsules[d], start, end, moved(d), moved(d, 1.0))
    # The gap closes at speed 3, or 1; the last point is inside from the beginning, then left behind.
    np.testing.assert_allclose(found.time[[0, 2]], [(2 - RADIUS) / 3, 0], atol=5e-3)
    assert np.isinf(found.time[1])
    np.testing.assert_allclose(found.point[0], start[0] * (1 - found.time[0]), atol=1e-12)
    assert np.isnan(found.point[1]).all()


def test_no_touch_is_missed(chains, rng) -> None:
    """Beside many poses between, in which points are tested one after the other."""
    model = chains[2]
    s = model.character.skeleton
    poses = []
    for degrees in (0, 25):
        theta = np.zeros((len(s.BE), 1))
        theta[1:] = np.radians(degrees)
        poses.append(forward_kinematics(s.C, s.BE, s.P, theta))
    start, end = rng.uniform(-1.5, 1.5, (2, 60, 2))
    found = first_touches(model, start, end, *poses, resolution=1 / 256)
    first, nearest = np.full(60, np.inf), np.full(60, np.inf)
    for time in np.linspace(0, 1, 401):
        pose = interpolate_poses(s.C, s.BE, s.P, *poses, time)
        x = start + time * (end - start)
        distance = model.posed_distance(x, pose)
        first[(distance < 0) & np.isinf(first)] = time
        nearest = np.minimum(nearest, distance)
    touched = np.isfinite(first)
    assert 5 < touched.sum() < 55
    assert (found.time[touched] <= first[touched] + 1e-9).all()
    assert (nearest[np.isfinite(found.time)] <= found.near[np.isfinite(found.time)] + 1e-3).all()
    assert (first[touched] - found.time[touched] < 0.05).mean() > 0.9


def test_the_bound_of_the_speed(chains, rolled) -> None:
    model = chains[3]
    s, poses = model.character.skeleton, (rolled(model, 0), rolled(model, 40))
    speed, h = skin_speed(model, *poses), 1e-4
    for time in np.linspace(0, 1 - h, 7):
        U = [model.posed(interpolate_poses(s.C, s.BE, s.P, *poses, t)).U for t in (time, time + h)]
        assert np.linalg.norm(U[1] - U[0], axis=1).max() / h <= speed * (1 + 1e-6)


def test_balls_touch_earlier_and_mistakes_are_refused(capsules, moved) -> None:
    start, end, rest = np.array([[2.0, 0, 0]]), np.zeros((1, 3)), moved(3)
    times = [first_touches(capsules[3], start, end, rest, rest, radius=r).time[0] for r in (0.0, 0.4)]
    np.testing.assert_allclose(times, [0.9, 0.7], atol=5e-3)
    with pytest.raises(ValueError, match="end must be"):
        first_touches(capsules[3], start, end[:0], rest, rest)
    with pytest.raises(ValueError, match=r"radius\[0\] is negative"):
        first_touches(capsules[3], start, end, rest, rest, radius=-0.1)
    with pytest.raises(ValueError, match="resolution must be above 0"):
        first_touches(capsules[3], start, end, rest, rest, resolution=0)
    assert first_touches(capsules[3], end[:0], end[:0], rest, rest).time.shape == (0,)
