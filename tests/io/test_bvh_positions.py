"""Positions in .bvh files that replace OFFSETs, are added to them, or are in another unit; rows that do not fit."""

import numpy as np
import pytest

from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.io import FileFormatError
from nilbs.io.bundle import Clip
from nilbs.io.bvh import read_bvh, write_bvh
from nilbs.io.joints import first_joints

SIX = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
THREE = "CHANNELS 3 Zrotation Xrotation Yrotation"
# A chain below a root that stands still, as Bandai Namco's files have it.
OFFSETS = {"joint_Root": (0, 0, 0), "Hips": (1, 94, -452), "Spine": (0, 16, 0), "Chest": (0, 20, 1), "Head": (0, 40, 0)}
HIPS = (-0.5, 93.5, -9.0)


def chain(offsets, rows, *, channels=SIX):
    """A file of joints one below the other; a row is the positions of each joint that has six channels."""
    head = "".join(
        f"{'JOINT' if k else 'ROOT'} {name} {{ OFFSET {' '.join(map(str, offset))} "
        f"{channels[name] if isinstance(channels, dict) else channels}\n"
        for k, (name, offset) in enumerate(offsets.items())
    )
    lines = []
    for row in rows:
        moved = [
            [] if isinstance(channels, dict) and channels[name] == THREE else [*map(str, row[name])] for name in offsets
        ]
        lines.append(" ".join(" ".join([*words, "0 0 0"]) for words in moved))
    return f"HIERARCHY\n{head}{'}' * len(offsets)}\nMOTION\nFrames: {len(rows)}\nFrame Time: 0.1\n" + "\n".join(lines)


@pytest.fixture
def places(tmp_path):
    """Where the joints of a file stand relative to the joint above, in every frame; and the notes."""

    def read(text, **how):
        path = tmp_path / "a.bvh"
        path.unlink(missing_ok=True)
        path.write_text(text)
        parts = read_bvh(path, **how)
        (clip,) = parts.clips
        x = first_joints(parts.skeleton)
        world = (clip.B[:, :, :3, :3] @ x[:, :, None])[..., 0] + clip.B[:, :, :3, 3]
        return np.diff(world, axis=1, prepend=0).round(9).tolist(), parts

    return read


def listed(rows):
    return [[list(map(float, row[name])) for name in row] for row in rows]


STILL = {**OFFSETS, "Hips": HIPS}


def test_a_joint_that_moves_among_others_that_repeat_their_offsets_replaces(places):
    rows = [STILL, {**STILL, "Hips": (-0.5, 93.5, -8.0)}]
    found, parts = places(chain(OFFSETS, rows))
    assert found == listed(rows)
    assert parts.notes == ("positions of joints below the roots take the place of their OFFSETs (4): 75 % repeat them",)


def test_repeats_in_part_of_the_frames_are_enough(places):
    still = [dict.fromkeys(OFFSETS, (0, 0, 0)) | {"Spine": (0, 0, 3)}] * 2
    rows = [STILL, *({**STILL, "Spine": (0, y, 0), "Chest": (0, y, 1), "Head": (0, y, 5)} for y in (1, 2, 3, 4))]
    assert places(chain(OFFSETS, rows))[0] == listed(rows)
    moved = [{name: np.add(OFFSETS[name], row[name]) for name in OFFSETS} for row in still]
    found, parts = places(chain(OFFSETS, still))
    assert found == listed(moved)
    assert "are added to their OFFSETs (4): 75 % are zero" in parts.notes[0]


@pytest.mark.parametrize("position", [(-0.5, 93.5, -9), (300, 80, 20)])
def test_hips_alone_below_a_root_replace_where_one_coordinate_does(places, position):
    channels = dict.fromkeys(OFFSETS, THREE) | {"joint_Root": SIX, "Hips": SIX}
    rows = [{"joint_Root": (0, 0, 0), "Hips": position}]
    expected = [{**OFFSETS, "Hips": position}]
    assert places(chain(OFFSETS, rows, channels=channels))[0] == listed(expected)
    near_zero = [{"joint_Root": (0, 0, 0), "Hips": (3, 1, 2)}]
    expected = [{**OFFSETS, "Hips": (4, 95, -450)}]
    assert places(chain(OFFSETS, near_zero, channels=channels))[0] == listed(expected)


def test_positions_of_zero_are_added_or_the_skeleton_would_collapse(places):
    offsets = {**OFFSETS, "joint_Root": (5, 6, 7)}
    rows = [dict.fromkeys(OFFSETS, (0, 0, 0))] * 3
    found, parts = places(chain(offsets, rows))
    assert found == listed([offsets] * 3)
    assert parts.notes[1] == "the positions of the root 'joint_Root' are zero: it stays at its OFFSET"
    assert np.abs(parts.clips[0].B - np.eye(4)).max() == 0


def test_a_root_is_where_its_positions_are(places):
    offsets = {**OFFSETS, "joint_Root": (5, 6, 7)}
    for there in ((5, 6, 7), (5, 0, 0), (0.1, 0, 0)):
        rows = [{**OFFSETS, "joint_Root": (0, 0, 0)}, {**OFFSETS, "joint_Root": there}]
        assert places(chain(offsets, rows))[0] == listed(rows)


@pytest.mark.parametrize("factor", [100, 0.01, 39.37, 3])
def test_positions_in_another_unit_are_divided(places, factor):
    rows = [{**STILL, "joint_Root": (1, 0, z)} for z in (0, 2)]
    scaled = [{name: np.multiply(place, factor).round(9) for name, place in row.items()} for row in rows]
    found, parts = places(chain(OFFSETS, scaled))
    np.testing.assert_allclose(found, listed(rows), atol=1e-6)
    assert parts.notes[0].startswith(f"positions are {factor:g} times the OFFSETs, in another unit")


def test_offsets_of_zero_are_the_positions_of_the_first_frame(places):
    offsets = dict.fromkeys(OFFSETS, (0, 0, 0))
    rows = [STILL, {**STILL, "Head": (0, 42, 0)}]
    for how in ("auto", "add", "replace"):
        found, parts = places(chain(offsets, rows), positions=how)
        assert found == listed(rows)
        rest = np.cumsum(list({**STILL, "joint_Root": (0, 0, 0)}.values()), axis=0)
        assert np.abs(parts.skeleton.C[: len(rest)] - (rest if how == "auto" else 0)).max() < 1e-12
        assert any("all OFFSETs below the roots are zero" in note for note in parts.notes) == (how == "auto")


def test_what_is_asked_for_is_done(places):
    rows = [{**STILL, "joint_Root": (1, 2, 3)}]
    offsets = {**OFFSETS, "joint_Root": (10, 0, 0)}
    assert places(chain(offsets, rows), positions="replace")[0] == listed(rows)
    added = [{name: np.add(offsets[name], rows[0][name]) for name in offsets}]
    found, parts = places(chain(offsets, rows), positions="add")
    assert found == listed(added)
    assert parts.notes == ()
    with pytest.raises(ValueError, match="positions must be one of 'auto', 'add', 'replace', got 'both'"):
        places(chain(offsets, rows), positions="both")


@pytest.mark.parametrize("seed", range(30))
def test_what_is_written_is_read_whatever_moves(tmp_path, seed):
    rng = np.random.default_rng(seed)
    b, t = 5, 4
    s = skeleton_of_joints(rng.normal(size=(b, 3)), np.array([-1, 0, 1, 1, 3]), list("abcde"))
    B = np.tile(np.eye(4), (t, b, 1, 1))
    kind = seed % 5
    scale = [1.0, 0.0, 1.01, rng.uniform(-5, 5, (b, 1)), -0.5][kind]
    world = first_joints(s) * scale + 0.1 * (kind > 1) * rng.normal(size=(t, b, 3))
    still = rng.random((t, b)) < 0.3
    world = np.where(still[..., None] & (kind == 2), first_joints(s), world)
    world[..., 0] += 0.1
    B[..., :3, 3] = world - first_joints(s)
    assert write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(t) / 10, B)) == ()
    found = read_bvh(tmp_path / "a.bvh").clips[0]
    order = [found.skeleton.names.index(name) for name in s.names]
    assert np.abs(found.B[:, order] - B).max() < 1e-8


def test_a_root_that_stays_at_the_origin_cannot_be_written_for_every_reader(tmp_path):
    s = skeleton_of_joints(np.array([[0, 9.0, 0], [0, 10.0, 0]]), np.array([-1, 0]), ("a", "b"))
    B = np.tile(np.eye(4), (2, 2, 1, 1))
    B[..., 1, 3] = -9
    (note,) = write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(2) / 10, B))
    assert note == "its positions look like others: read it with positions='replace', --positions replace"
    assert np.abs(read_bvh(tmp_path / "a.bvh", positions="replace").clips[0].B - B).max() < 1e-9


# A short file of two frames, and what of its lines is read.
SHORT = chain({"a": (0, 1, 0), "b": (0, 2, 0)}, [{"a": (0, 1, z), "b": (0, 2, 0)} for z in (3, 4)])
HEAD, FIRST, LAST = SHORT.rsplit("\n", 2)


@pytest.mark.parametrize(
    ("text", "frames", "note"),
    [
        (f"{SHORT}\n{LAST}\n", 2, "1 row is left over after the 2 frames that the file announces, from line 10 on"),
        (f"{SHORT}\n\n{LAST}\nx y\n", 2, "2 rows are left over after the 2 frames that the file announces,"),
        (SHORT.replace("Frames: 2", "Frames: 5"), 2, "the file announces 5 frames, and ends after 2, in line 9"),
        (SHORT.replace("Frames: 2", "Frames: 999999999"), 2, "the file announces 999999999 frames, and ends after 2"),
        (f"{HEAD}\n{FIRST}\n{LAST[:-2]}", 1, "the last row, in line 9, is cut off and left out"),
        (f"{HEAD}\n{FIRST}\n{LAST[:-1]}-", 1, "the last row, in line 9, is cut off and left out"),
        (f"{HEAD}\n{FIRST}\n{LAST[:-2]}\n\n \n", 1, "the last row, in line 9, is cut off and left out"),
        (f"{HEAD}\n", 0, "the file announces 2 frames, and ends after 0, in line 7"),
    ],
)
def test_rows_that_do_not_fit_are_noted(places, text, frames, note):
    _, parts = places(text)
    assert len(parts.clips[0].B) == frames
    assert any(found.startswith(note) for found in parts.notes)
    assert parts.clips[0].B[:, 0, 2, 3].tolist() == [3, 4][:frames]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{HEAD}\n{FIRST[:-2]}\n{LAST}\n", ":8: a frame has 12 numbers, one for every channel"),
        (f"{HEAD}\n{FIRST} 0\n{LAST}\n", ":8: a frame has 12 numbers"),
        (f"{HEAD}\n{FIRST}\n{LAST} 0\n", ":9: a frame has 12 numbers"),
        (f"{HEAD}\n{FIRST}\n{LAST[:-1]}-\n", ":9: '-' is not a finite number"),
    ],
)
def test_rows_that_cannot_be_read(places, text, message):
    with pytest.raises(FileFormatError, match=message):
        places(text)
