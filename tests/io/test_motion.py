import json

import numpy as np
import pytest

from nilbs.io import (
    FileFormatError,
    read_motion_json,
    read_transforms,
    write_dmat,
    write_motion_json,
    write_transforms,
)
from nilbs.io.motion import read_any_motion_json

NAMES = ("bone0", "bone1")


@pytest.fixture
def motion(tmp_path):
    def read(content, d=3):
        path = tmp_path / "a.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return read_motion_json(path, NAMES, d)

    return read


@pytest.mark.parametrize("d", [2, 3])
def test_transforms_round_trip(tmp_path, rng, d):
    B = np.zeros((4, 3, d + 1, d + 1))
    B[..., :d, :] = rng.normal(size=(4, 3, d, d + 1))
    B[..., d, d] = 1
    write_transforms(tmp_path / "a.dmat", B)
    B_read = read_transforms(tmp_path / "a.dmat")
    assert B_read.shape == (4, 3, 4, 4)
    # In 2D: the same motion of the plane z = 0, homogeneous coordinate last.
    kept = [*range(d), 3]
    assert np.array_equal(B_read[..., kept, :][..., kept], B)
    assert B_read[..., 2, 2].tolist() == (B[..., 2, 2] if d == 3 else np.ones((4, 3))).tolist()
    assert (B_read[..., 3, :] == [0, 0, 0, 1]).all()


def test_transforms_lie_in_the_file_row_by_row_then_bone_by_bone(tmp_path):
    t, b = 2, 3
    A = np.arange(12.0 * b * t).reshape(12 * b, t)
    write_dmat(tmp_path / "a.dmat", A)
    B = read_transforms(tmp_path / "a.dmat")
    for frame in range(t):
        for bone in range(b):
            assert np.array_equal(B[frame, bone, :3], A[:, frame].reshape(3, b, 4)[:, bone, :])


def test_transforms_need_twelve_rows_a_bone(tmp_path):
    write_dmat(tmp_path / "a.dmat", np.zeros((13, 2)))
    with pytest.raises(FileFormatError, match=r"12 rows a bone and a column a frame, this file has \(13, 2\)"):
        read_transforms(tmp_path / "a.dmat")
    write_dmat(tmp_path / "a.dmat", np.zeros((12, 0)))
    with pytest.raises(FileFormatError, match="12 rows a bone"):
        read_transforms(tmp_path / "a.dmat")


def test_write_transforms_refuses_what_the_file_cannot_hold(tmp_path):
    with pytest.raises(ValueError, match="last row"):
        write_transforms(tmp_path / "a.dmat", np.ones((1, 1, 4, 4)))
    with pytest.raises(ValueError, match="B must be"):
        write_transforms(tmp_path / "a.dmat", np.eye(4))


def test_the_elephant_starts_at_rest_and_turns_rigidly(data):
    B = read_transforms(data / "elephant" / "elephant-anim.dmat")
    assert B.shape == (457, 24, 4, 4)
    assert np.array_equal(B[0], np.tile(np.eye(4), (24, 1, 1)))
    R = B[..., :3, :3]
    assert np.allclose(R @ R.swapaxes(-1, -2), np.eye(3), atol=1e-6)


@pytest.mark.parametrize(("d", "r"), [(2, 1), (3, 3)])
def test_json_round_trip(tmp_path, rng, d, r):
    theta, root_translation = rng.normal(size=(5, 2, r)), rng.normal(size=(5, d))
    write_motion_json(tmp_path / "a.json", NAMES, theta, root_translation)
    theta_read, translation_read = read_motion_json(tmp_path / "a.json", NAMES, d)
    assert np.allclose(theta_read, theta, rtol=1e-15, atol=1e-15)
    assert np.array_equal(translation_read, root_translation)


def test_json_is_in_degrees_and_what_is_left_out_is_zero(motion):
    frames = [{"bone1": [0, 0, 180]}, {"root_translation": [1, 2, 3.5]}, {}]
    theta, translation = motion({"frames": frames, "fps": 30})
    assert theta.shape == (3, 2, 3)
    assert theta[0, 1].tolist() == [0, 0, np.pi]
    assert np.count_nonzero(theta) == 1
    assert translation.tolist() == [[0, 0, 0], [1, 2, 3.5], [0, 0, 0]]


def test_json_in_the_plane_takes_one_angle(motion):
    theta, translation = motion({"frames": [{"bone0": 90, "bone1": [-90], "root_translation": [1, 2]}]}, d=2)
    assert theta.tolist() == [[[np.pi / 2], [-np.pi / 2]]]
    assert translation.tolist() == [[1, 2]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"frames": [\n{"bone0": [0, 0, 1]},\n]}', ":3: this is no JSON: "),
        ('{"frames": [{"bone0": [0, 0, NaN]}]}', "NaN is not a finite number"),
        ('{"frames": [{"bone0": [0, 0, -Infinity]}]}', "-Infinity is not a finite number"),
        ('{"frames": [{"bone0": [0, 0, 1e999]}]}', ": frame 0, bone0: expected three angles, got [0, 0, Infinity]"),
        ('{"frames": [{}, {"bone1": [0, 0, 1' + "0" * 400 + "]}]}", ": frame 1, bone1: expected three angles"),
        ('{"frames": [{"bone0": ' + "9" * 5000 + "}]}", "no JSON of a motion"),
        ('{"frames": [{"bone0": [0,0,1], "bone0": [0,0,2]}]}', "'bone0' stands twice in one object"),
        ("[" * 100_000 + "]" * 100_000, "the JSON is nested too deep"),
        ('{"a":' * 100_000 + "1" + "}" * 100_000, "the JSON is nested too deep"),
        ('{"frames": ' + "[" * 100_000, "the JSON is nested too deep"),
        ([], 'one object with a list "frames"'),
        ({}, 'one object with a list "frames"'),
        ({"frames": {}}, 'one object with a list "frames"'),
        ({"frames": []}, "the motion has no frame"),
        ({"frames": [{}], "speed": 1}, "unknown entry 'speed'"),
        ({"frames": [{}], "fps": "fast"}, '"fps" must be a number'),
        ({"frames": [{}, 3]}, "frame 1 must be an object"),
        ({"frames": [{}, {"head": [0, 0, 1]}]}, "frame 1: the rig has no bone 'head'"),
        ({"frames": [{"bone0": [0, 1]}]}, "frame 0, bone0: expected three angles, got [0, 1]"),
        ({"frames": [{"bone0": 1}]}, "frame 0, bone0: expected three angles, got 1"),
        ({"frames": [{"bone0": [0, 1, True]}]}, "frame 0, bone0: expected three angles, got [0, 1, true]"),
        ({"frames": [{"bone0": [0, 1, "2"]}]}, "frame 0, bone0: expected three angles"),
        ({"frames": [{"bone0": None}]}, "frame 0, bone0: expected three angles"),
        ({"frames": [{"root_translation": [0, 1]}]}, "frame 0, root_translation: expected 3 finite numbers"),
    ],
)
def test_json_errors_name_frame_and_bone(motion, content, message):
    with pytest.raises(FileFormatError) as caught:
        motion(content)
    assert message in str(caught.value)
    assert "a.json" in str(caught.value)


def test_json_in_the_plane_refuses_three_angles(motion):
    with pytest.raises(FileFormatError, match="frame 0, bone0: expected one angle, got"):
        motion({"frames": [{"bone0": [0, 0, 30]}]}, d=2)


def test_json_that_is_no_text(tmp_path):
    (tmp_path / "a.json").write_bytes(b'{"frames": "\xff"}')
    with pytest.raises(FileFormatError, match=r"a\.json: this is no JSON"):
        read_motion_json(tmp_path / "a.json", NAMES, 3)


@pytest.mark.parametrize("names", [("bone0",), ("bone0", "bone0"), ("a", "b", "c")])
def test_write_json_checks_its_names(tmp_path, names):
    with pytest.raises(ValueError, match="theta must be"):
        write_motion_json(tmp_path / "a.json", names, np.zeros((1, 2, 3)), np.zeros((1, 3)))
    assert list(tmp_path.iterdir()) == []


def test_json_of_an_unknown_rig(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"frames": [{}, {"leg": [0, 0, 90]}, {"arm": [90, 0, 0], "root_translation": [1, 2, 3]}]}')
    names, theta, translation = read_any_motion_json(path)
    assert names == ("leg", "arm")
    assert theta.tolist() == [[[0] * 3] * 2, [[0, 0, np.pi / 2], [0] * 3], [[0] * 3, [np.pi / 2, 0, 0]]]
    assert translation[2].tolist() == [1, 2, 3]


@pytest.mark.parametrize("frame", ['{"arm": 90}', '{"arm": [90]}', '{"root_translation": [0, 0], "arm": 90}'])
def test_json_of_an_unknown_rig_in_the_plane(tmp_path, frame):
    (tmp_path / "a.json").write_text(f'{{"frames": [{frame}]}}')
    names, theta, translation = read_any_motion_json(tmp_path / "a.json")
    assert (names, theta.tolist(), translation.tolist()) == (("arm",), [[[np.pi / 2]]], [[0, 0]])


def test_json_of_an_unknown_rig_is_checked_too(tmp_path):
    for frames in ('[{"arm": [1, 2, 3]}, {"arm": 1}]', "[3]", '[{"arm": null}]'):
        (tmp_path / "a.json").write_text(f'{{"frames": {frames}}}')
        with pytest.raises(FileFormatError, match=r"a\.json: frame"):
            read_any_motion_json(tmp_path / "a.json")
