"""Curves against the glTF specification, written as loops over curves and times."""

from dataclasses import replace

import numpy as np
import pytest

from nilbs.geometry.curves import Channels, Curve, Curves, channels_of, curves_between
from nilbs.geometry.kinematics import forward_kinematics, interpolate_poses
from nilbs.geometry.plane import transforms_in_space

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
C, BE, P = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0]]), np.array([[0, 0], [1, 1], [2, 2]]), np.array([-1, 0, 1])


def spline(part: str, rng: np.random.Generator, keys: int = 4, kind: str = "cubicspline") -> Curve:
    shape = (keys, 3, WIDTHS[part]) if kind == "cubicspline" else (keys, WIDTHS[part])
    return Curve(np.sort(rng.uniform(0, 2, keys)), rng.normal(size=shape), kind)


@pytest.mark.parametrize("part", WIDTHS)
@pytest.mark.parametrize("kind", ["step", "linear", "cubicspline"])
def test_many_curves_at_once_are_as_each_alone_in_loops(part: str, kind: str, curve_value, rng) -> None:
    curves = [spline(part, rng, keys, kind) for keys in (1, 5, 2, 1, 9)]
    curves[2] = curves[2]._replace(times=curves[1].times[[0, 3]])  # some keys at the same times
    (channels,) = channels_of({(node, part): curve for node, curve in enumerate(curves)})
    times = np.concatenate([rng.uniform(-1, 3, 200), *(curve.times for curve in curves), [-1e300, 1e300]])
    found = channels.at(times)
    assert found.shape == (len(times), 5, WIDTHS[part])
    for row, t in zip(found, times, strict=True):
        for mine, curve in zip(row, curves, strict=True):
            np.testing.assert_allclose(mine, curve_value(curve, part, t), atol=1e-12)
    for node, curve in channels.curves().items():
        assert all(np.array_equal(a, b) for a, b in zip(curve[:2], curves[node][:2], strict=True))


def test_of_keys_at_one_time_the_last_one_counts() -> None:
    keys = Curve(np.array([0.0, 1, 1, 1, 2]), np.arange(5.0)[:, None] * np.ones(3), "linear")
    (channels,) = channels_of({(0, "translation"): keys})
    np.testing.assert_allclose(channels.at(np.array([0.5, 1, 1.5]))[:, 0, 0], [0.5, 3, 3.5])
    start = Curve(np.zeros(3), np.arange(3.0)[:, None] * np.ones(3), "linear")
    (channels,) = channels_of({(0, "translation"): start})
    np.testing.assert_allclose(channels.at(np.array([-1.0, 0, 1]))[:, 0, 0], [0, 2, 2])


def test_a_half_turn_and_the_same_key_twice(rng: np.random.Generator) -> None:
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    across = np.array([q[3], -q[2], q[1], -q[0]])  # orthogonal to q: half a turn away
    keys = Curve(np.arange(4.0), np.array([q, q, -q, across]), "linear")
    (channels,) = channels_of({(0, "rotation"): keys})
    found = channels.at(np.array([0.3, 1.7, 2.5]))[:, 0]
    np.testing.assert_allclose(np.abs(found[:2] @ q), 1, atol=1e-12)
    np.testing.assert_allclose(np.abs(found[2] @ np.array([q, across]).T), np.sqrt(0.5), atol=1e-12)


def test_rigid_poses_and_what_lies_between_them(rng: np.random.Generator) -> None:
    theta, move = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3))
    theta[:, 1] = 0  # one that does not turn
    B = forward_kinematics(C, BE, P, theta, root_translation=move)
    times = np.array([0.5, 1, 2, 2.5, 3])
    curves = curves_between(C, BE, P, times, B)
    assert sorted(curves.curves()) == [(0, "rotation"), (0, "translation"), (2, "rotation")]
    np.testing.assert_array_equal(curves.key_times, times)
    np.testing.assert_allclose(curves.at(times), B, atol=1e-12)
    np.testing.assert_allclose(curves.at([-9, 9]), B[[0, -1]], atol=1e-12)
    s = rng.random(4)
    between = curves.at((1 - s) * times[:-1] + s * times[1:])
    np.testing.assert_allclose(between, interpolate_poses(C, BE, P, B[:-1], B[1:], s), atol=1e-12)
    later = curves.shifted(0.5, 7.0)
    np.testing.assert_allclose(later.at(times + 6.5), B, atol=1e-12)
    np.testing.assert_array_equal(curves.of_bones([2, 0]).at(times), curves.at(times)[:, [2, 0]])
    single = curves_between(C, BE, P, times[:1], B[:1])
    assert single.key_times.tolist() == [0.5]
    np.testing.assert_allclose(single.at([0.0, 5.0]), B[[0, 0]], atol=1e-12)
    still = curves_between(C, BE, P, times[:1], np.tile(np.eye(4), (1, 3, 1, 1)))
    assert (still.channels, len(still.key_times)) == ((), 0)
    np.testing.assert_allclose(still.at([0.0, 5.0]), np.tile(np.eye(4), (2, 3, 1, 1)), atol=1e-12)


def test_a_node_may_have_a_matrix_before_its_curves(rng: np.random.Generator) -> None:
    curves = curves_between(C, BE, P, [0, 1], forward_kinematics(C, BE, P, rng.normal(size=(2, 3, 3))))
    frame = np.tile(np.eye(4), (3, 1, 1))
    frame[0, :3] = rng.normal(size=(3, 4))
    np.testing.assert_allclose(replace(curves, frame=frame).at([0.3]), frame[0] @ curves.at([0.3]), atol=1e-12)


def test_many_times_in_blocks(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    curves = curves_between(C, BE, P, np.arange(4), forward_kinematics(C, BE, P, rng.normal(size=(4, 3, 3))))
    times = rng.uniform(0, 3, 50)
    whole = curves.at(times)
    monkeypatch.setattr("nilbs.geometry.curves._BLOCK", 7)
    np.testing.assert_array_equal(curves.at(times), whole)
    assert curves.at([]).shape == (0, 3, 4, 4)


def test_flat_bones_stay_in_the_plane_or_are_refused(rng: np.random.Generator) -> None:
    flat = forward_kinematics(C[:, :2], BE, P, rng.normal(size=(3, 3, 1)))
    curves = replace(curves_between(C, BE, P, np.arange(3), transforms_in_space(flat)), d=2)
    np.testing.assert_allclose(curves.at([0, 1, 2]), flat, atol=1e-12)
    expected = interpolate_poses(C[:, :2], BE, P, flat[0], flat[1], 0.3)
    np.testing.assert_allclose(curves.at([0.3])[0], expected, atol=1e-12)
    over = forward_kinematics(C, BE, P, np.array([0, 1])[:, None, None] * [np.pi, 0, 0] * np.ones((3, 1)))
    turned = replace(curves_between(C, BE, P, [0, 1], over), d=2)
    with pytest.raises(ValueError, match="out of the plane of a flat character"):
        turned.at([0.5])


def test_curves_that_cannot_be(rng: np.random.Generator) -> None:
    B = forward_kinematics(C, BE, P, rng.normal(size=(2, 3, 3)))
    curves = curves_between(C, BE, P, [0, 1], B)
    (channels,) = curves.channels
    for change, message in (
        ({"ends": [2, 2, 6]}, "ends of curves must increase from 1 to the number of keys, 6"),
        ({"ends": [2, 4, 5]}, "ends of curves"),
        ({"times": [0, 1, 1, 0, 0, 1]}, "times of keys must not decrease"),
        ({"values": np.zeros((6, 3))}, r"values must be \(k, 4\)"),
        ({"interpolation": "quadratic"}, "unknown interpolation 'quadratic'"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(channels, **change)
    for change, message in (
        ({"channels": (channels, channels)}, "a part of a node has two curves"),
        ({"channels": (replace(channels, nodes=[0, 1, 7]),)}, r"nodes\[2\] = 7 does not index the 3 nodes"),
        ({"bones": [0, 1, 3]}, r"bones\[2\] = 3 does not index the 3 nodes"),
        ({"P": [0, 0, 0]}, "cycle"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(curves, **change)
    wild = Curve(np.array([0.0, 1]), np.full((2, 3, 3), 1e70), "cubicspline")
    far = replace(curves, channels=channels_of({(1, "scale"): wild}))
    with pytest.raises(ValueError, match=r"the transform of bone 1 at 0\.5 s is out of bounds"):
        far.at([0.5])
    assert isinstance(far, Curves)
    assert isinstance(far.channels[0], Channels)
