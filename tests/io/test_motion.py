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
from nilbs.io import motion as motion_files

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
    again = read_motion_json(tmp_path / "a.json", NAMES, d)
    assert again.names == NAMES
    assert np.allclose(again.theta, theta, rtol=1e-15, atol=1e-15)
    assert np.array_equal(again.root_translation, root_translation)
    assert (again.translation, again.scale, again.given, again.times) == (None, None, None, None)


@pytest.mark.parametrize(("d", "r"), [(2, 1), (3, 3)])
def test_json_round_trip_of_all_that_a_bone_can_do(tmp_path, rng, d, r):
    theta, move = rng.normal(size=(5, 2, r)), rng.normal(size=(5, d))
    translation, scale = rng.normal(size=(5, 2, d)), rng.uniform(0.5, 2, (5, 2, d))
    translation[1], scale[:, 0] = 0, 1
    given = np.full((5, 2, d + 1, d + 1), np.nan)
    given[3, 1] = np.eye(d + 1)
    given[3, 1, :d] += rng.normal(size=(d, d + 1))
    times = np.array([0, 0.5, 0.5, 2, 7.25])
    write_motion_json(
        tmp_path / "a.json", NAMES, theta, move, translation=translation, scale=scale, given=given, times=times
    )
    again = read_motion_json(tmp_path / "a.json", NAMES, d)
    assert np.array_equal(again.given, given, equal_nan=True)
    # An entry with a transform has no other parts.
    theta[3, 1], translation[3, 1], scale[3, 1] = 0, 0, 1
    assert np.allclose(again.theta, theta, rtol=1e-15, atol=1e-15)
    for value, expected in ((again.translation, translation), (again.scale, scale), (again.times, times)):
        assert np.array_equal(value, expected)
    unknown = read_motion_json(tmp_path / "a.json")
    assert unknown.names == NAMES
    assert unknown.theta.shape == theta.shape


def test_json_is_in_degrees_and_missing_bones_have_zero(motion):
    frames = [{"bone1": [0, 0, 180]}, {"root_translation": [1, 2, 3.5]}, {}]
    found = motion({"frames": frames, "fps": 30})
    theta, translation = found.theta, found.root_translation
    assert found.times.tolist() == [0, 1 / 30, 2 / 30]
    assert theta.shape == (3, 2, 3)
    assert theta[0, 1].tolist() == [0, 0, np.pi]
    assert np.count_nonzero(theta) == 1
    assert translation.tolist() == [[0, 0, 0], [1, 2, 3.5], [0, 0, 0]]


def test_json_in_the_plane_takes_one_angle(motion):
    found = motion({"frames": [{"bone0": 90, "bone1": [-90], "root_translation": [1, 2]}]}, d=2)
    assert found.theta.tolist() == [[[np.pi / 2], [-np.pi / 2]]]
    assert found.root_translation.tolist() == [[1, 2]]


def test_json_of_a_bone_that_moves_and_grows(motion):
    bone = {"rotation": [0, 0, 90], "translation": [1, 2, 3], "scale": 2}
    found = motion({"frames": [{"bone1": bone}, {"bone0": {"scale": [1, 2, 3]}, "bone1": {"translation": [1, 0, 0]}}]})
    assert found.theta[0, 1].tolist() == [0, 0, np.pi / 2]
    assert found.translation.tolist() == [[[0, 0, 0], [1, 2, 3]], [[0, 0, 0], [1, 0, 0]]]
    assert found.scale.tolist() == [[[1, 1, 1], [2, 2, 2]], [[1, 2, 3], [1, 1, 1]]]
    assert found.given is None


def test_json_of_a_given_transform(motion):
    found = motion({"frames": [{}, {"bone0": {"matrix": [[1, 0, 5], [0, 2, 6], [0, 0, 1]]}}]}, d=2)
    assert found.given[1, 0].tolist() == [[1, 0, 5], [0, 2, 6], [0, 0, 1]]
    assert np.isnan(found.given).sum() == 3 * 9


def test_json_times_of_frames_win_over_their_rate(motion):
    assert motion({"fps": 10, "frames": [{"time": 1}, {"time": 1.5}]}).times.tolist() == [1, 1.5]


def test_json_of_too_many_poses_for_memory_is_refused(motion, monkeypatch):
    monkeypatch.setattr(motion_files, "_POSES", 5)
    assert len(motion({"frames": [{}, {}]}).theta) == 2
    with pytest.raises(FileFormatError, match="3 frames of 2 bones are too many"):
        motion({"frames": [{}, {}, {}]})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"frames": [\n{"bone0": [0, 0, 1]},\n]}', ":3: this is no JSON: "),
        ('{"frames": [{"bone0": [0, 0, NaN]}]}', "NaN is not a finite number"),
        ('{"frames": [{"bone0": [0, 0, -Infinity]}]}', "-Infinity is not a finite number"),
        ('{"frames": [{"bone0": [0, 0, 1e999]}]}', ": frame 0, bone0: expected three angles, got [0, 0, Infinity]"),
        ('{"frames": [{}, {"bone1": [0, 0, 1' + "0" * 400 + "]}]}", ": frame 1, bone1: expected three angles"),
        ('{"frames": [{"bone0": ' + "9" * 5000 + "}]}", "this JSON cannot be used"),
        ('{"frames": [{"bone0": [0,0,1], "bone0": [0,0,2]}]}', "'bone0' stands twice in one object"),
        ("[" * 100_000 + "]" * 100_000, "the JSON is nested too deep"),
        ('{"a":' * 100_000 + "1" + "}" * 100_000, "the JSON is nested too deep"),
        ('{"frames": ' + "[" * 100_000, "the JSON is nested too deep"),
        ([], 'one object with a list "frames"'),
        ({}, 'one object with a list "frames"'),
        ({"frames": {}}, 'one object with a list "frames"'),
        ({"frames": []}, "the motion has no frame"),
        ({"frames": [{}], "speed": 1}, "unknown entry 'speed'"),
        ({"frames": [{}], "fps": "fast"}, '"fps" must be a number above zero'),
        ({"frames": [{}], "fps": 0}, '"fps" must be a number above zero'),
        ({"frames": [{"time": 0}, {}]}, 'frame 1: "time" must be a number of seconds'),
        ({"frames": [{"time": "now"}]}, 'frame 0: "time" must be a number of seconds'),
        ({"frames": [{"time": 1}, {"time": 0.5}]}, "frame 1: its time 0.5 is before that of the frame before"),
        ({"frames": [{"bone0": {"rotation": [0, 1]}}]}, "frame 0, bone0: expected three angles, got [0, 1]"),
        ({"frames": [{"bone0": {"translation": [0, 1]}}]}, "expected 3 finite numbers as translation, got [0, 1]"),
        ({"frames": [{"bone0": {"scale": "big"}}]}, 'expected 1 or 3 finite numbers as scale, got "big"'),
        ({"frames": [{"bone0": {"turn": 1}}]}, "unknown entry 'turn' beside"),
        ({"frames": [{"bone0": {"matrix": [], "scale": 1}}]}, "nothing can stand beside it"),
        ({"frames": [{"bone0": {"matrix": 1}}]}, "a matrix takes 4 rows of 4 finite numbers"),
        ({"frames": [{"bone0": {"matrix": [[1, 0], [0, 1]]}}]}, "a matrix takes 4 rows of 4 finite numbers"),
        ({"frames": [{"bone0": {"matrix": [[0] * 4] * 4}}]}, "the last [0, 0, 0, 1]"),
        ('{"frames": [{"bone0": ' + "[" * 900 + "]" * 900 + "}]}", "expected three angles, got [[["),
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
    with pytest.raises(FileFormatError, match=r"a\.json: this JSON cannot be used"):
        read_motion_json(tmp_path / "a.json", NAMES, 3)


@pytest.mark.parametrize("names", [("bone0",), ("bone0", "bone0"), ("a", "b", "c")])
def test_write_json_checks_its_names(tmp_path, names):
    with pytest.raises(ValueError, match="theta must be"):
        write_motion_json(tmp_path / "a.json", names, np.zeros((1, 2, 3)), np.zeros((1, 3)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", [{"translation": np.zeros((1, 2, 2))}, {"scale": np.ones((1, 1, 3))},
                                   {"given": np.full((1, 2, 3, 3), np.nan)}, {"times": [0, 1]}])  # fmt: skip
def test_write_json_checks_what_bones_do(tmp_path, wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} must be"):
        write_motion_json(tmp_path / "a.json", NAMES, np.zeros((1, 2, 3)), np.zeros((1, 3)), **wrong)
    assert list(tmp_path.iterdir()) == []


def test_deep_nesting_is_reported_in_few_words():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    assert motion_files._shown(nested) == "lists in lists without end"


def test_json_of_an_unknown_rig(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"frames": [{}, {"leg": [0, 0, 90]}, {"arm": [90, 0, 0], "root_translation": [1, 2, 3]}]}')
    found = read_motion_json(path)
    assert found.names == ("leg", "arm")
    assert found.theta.tolist() == [[[0] * 3] * 2, [[0, 0, np.pi / 2], [0] * 3], [[0] * 3, [np.pi / 2, 0, 0]]]
    assert found.root_translation[2].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("frame", "d"),
    [
        ('"arm": 90', 2),
        ('"time": 0, "arm": [90]', 2),
        ('"root_translation": [0, 0], "arm": 90', 2),
        ('"arm": {"scale": 2, "rotation": 90}', 2),
        ('"arm": {"translation": [1, 2]}', 2),
        ('"arm": {"scale": 2}', 3),
        ('"arm": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}', 2),
        ('"arm": {"matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}', 3),
        ("", 3),
    ],
)
def test_the_dimension_of_an_unknown_rig_is_that_of_its_entries(tmp_path, frame, d):
    (tmp_path / "a.json").write_text(f'{{"frames": [{{{frame}}}]}}')
    found = read_motion_json(tmp_path / "a.json")
    assert found.root_translation.shape == (1, d)
    assert found.theta.shape == (1, 1 if frame else 0, 1 if d == 2 else 3)


def test_json_of_an_unknown_rig_is_checked_too(tmp_path):
    for frames in ('[{"arm": [1, 2, 3]}, {"arm": 1}]', "[3]", '[{"arm": null}]'):
        (tmp_path / "a.json").write_text(f'{{"frames": {frames}}}')
        with pytest.raises(FileFormatError, match=r"a\.json: frame"):
            read_motion_json(tmp_path / "a.json")
