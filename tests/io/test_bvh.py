import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rotation_matrices, transform_points
from nilbs.geometry.skeleton import Skeleton
from nilbs.io import FileFormatError
from nilbs.io.bundle import Clip
from nilbs.io.bvh import read_bvh, write_bvh


@pytest.fixture
def bvh(tmp_path):
    def read(text):
        path = tmp_path / "walk.bvh"
        path.unlink(missing_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_bvh(path)

    return read


WALK = """HIERARCHY
ROOT Hips
{
	OFFSET 0 9 1
	CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
	JOINT Left Leg
	{
		OFFSET 1 -1 0
		CHANNELS 3 Yrotation Xrotation Zrotation
		JOINT Toe
		{
			OFFSET 0 -4 0.5
			CHANNELS 1 Xrotation
			End Site
			{
				OFFSET 0 0 1
			}
		}
	}
	JOINT Spine
	{
		OFFSET 0 2 0
		CHANNELS 0
	}
}
MOTION
Frames: 2
Frame Time: 0.5
0 9 1 0 0 0 0 0 0 0
1 2 3 10 20 30 40 50 60 -70
"""


def test_a_file(bvh):
    parts = bvh(WALK)
    s, (clip,) = parts.skeleton, parts.clips
    assert s.names == ("Hips", "Left Leg", "Toe", "Spine")
    assert s.P.tolist() == [-1, 0, 1, 0]
    assert s.C[s.BE].tolist() == [
        [[0, 9, 1], [1, 8, 1]],
        [[1, 8, 1], [1, 4, 1.5]],
        [[1, 4, 1.5], [1, 4, 2.5]],
        [[0, 11, 1], [0, 11, 1]],
    ]
    assert s.forks.tolist() == [[0, 3]]
    assert clip.name == "walk"
    assert clip.skeleton is s
    assert clip.times.tolist() == [0, 0.5]
    assert np.abs(clip.B[0] - np.eye(4)).max() == 0  # the rest pose
    assert parts.notes == ()


def turn(axis, degrees):
    return rotation_matrices(np.radians(degrees) * np.eye(3)["xyz".index(axis.lower())])


def slow_twin(joints, row):
    """World matrices of a frame: joints are (parent, offset, channels)."""
    row, world = list(row), []
    for parent, offset, channels in joints:
        R, p = np.eye(3), np.array(offset, float)
        for channel in channels:
            value = row.pop(0)
            if channel.endswith("position"):
                p["xyz".index(channel[0].lower())] = value
            else:
                R = R @ turn(channel[0], value)
        G = np.eye(4)
        G[:3, :3], G[:3, 3] = R, p
        world.append(G if parent < 0 else world[parent] @ G)
    assert not row
    return np.array(world)


CHANNELS = [axis + kind for axis in "XYZ" for kind in ("position", "rotation")]


@pytest.mark.parametrize("seed", range(8))
def test_any_channels_against_a_slow_twin(bvh, seed):
    rng = np.random.default_rng(seed)
    b, t = 7, 3
    parents = [-1] + [int(rng.integers(-1, j)) for j in range(1, b)]
    text, joints, order = "hierarchy\n", [], []
    children = {j: [k for k in range(b) if parents[k] == j] for j in range(-1, b)}

    def write(j, parent):
        nonlocal text
        at = len(order)
        order.append(j)
        # Three axes, or two with the first repeated: Z X Z is an order of Euler angles, too.
        channels = rng.permutation(CHANNELS)[: rng.integers(0, 7)].tolist()
        channels = [*channels[:4], "Zrotation"] if rng.random() < 0.3 else channels
        offset = rng.normal(size=3)
        joints.append((parent, offset, channels))
        kind = "ROOT" if parent < 0 else "Joint"
        text += f"{kind} j{j} {{ OFFSET {' '.join(map(str, offset))} CHANNELS {len(channels)} {' '.join(channels)}\n"
        for child in children[j]:
            write(child, at)
        text += "}\n"

    for root in children[-1]:
        write(root, -1)
    n = sum(len(channels) for _, _, channels in joints)
    motion = rng.normal(size=(t, n)) * 100
    # In the first frame positions are the OFFSETs, as most files have it.
    held = [(channel, offset) for _, offset, channels in joints for channel in channels]
    motion[0] = [offset["XYZ".index(channel[0])] if channel[1] == "p" else 50 for channel, offset in held]
    text += f"Motion\nframes: {t}\nFRAME TIME: .1\n" + "\n".join(" ".join(map(str, row)) for row in motion)
    parts = bvh(text)
    assert parts.skeleton.names == tuple(f"j{j}" for j in order)
    assert all("take the place of their OFFSETs" in note for note in parts.notes)
    rest = slow_twin([(parent, offset, []) for parent, offset, _ in joints], [])
    expected = np.array([slow_twin(joints, row) @ np.linalg.inv(rest) for row in motion])
    assert np.abs(parts.clips[0].B - expected).max() < 1e-9 * np.abs(expected).max()


def test_spaces_tabs_and_cases(bvh):
    tight = (
        WALK.replace("\n\t", " ")
        .replace("\t", "")
        .replace(" {", "{")
        .replace("{ ", "{")
        .replace("Frames: ", "frames :")
    )
    same, other = bvh(WALK).clips[0], bvh(tight.replace("\n", "\r\n\r\n").replace("Frame Time", "FRAME  TIME")).clips[0]
    assert same.skeleton.names == other.skeleton.names
    assert np.array_equal(same.skeleton.C, other.skeleton.C)
    assert np.array_equal(same.B, other.B)


def test_equal_names_are_numbered(bvh):
    parts = bvh(WALK.replace("Spine", "Toe"))
    assert parts.skeleton.names == ("Hips", "Left Leg", "Toe", "Toe_2")
    assert parts.notes == ("names used twice were numbered: 'Toe' became 'Toe_2'",)


def test_no_frames(bvh):
    (clip,) = bvh(WALK[: WALK.index("Frames")] + "Frames: 0\nFrame Time: 0.1").clips
    assert clip.B.shape == (0, 4, 4, 4)
    assert clip.times.shape == (0,)


def test_an_end_site_beside_joints(bvh):
    text = "ROOT a { OFFSET 0 0 0 End Site { OFFSET 0 3 0 } JOINT b { OFFSET 1 0 0 End { OFFSET 0 0 0 } } }\n"
    with pytest.raises(FileFormatError, match="End needs a name"):
        bvh(text)
    s = bvh(text.replace("End {", "End Site {") + "MOTION\nFrames: 0\nFrame Time: 0").skeleton
    assert s.C[s.BE].tolist() == [[[0, 0, 0], [0, 3, 0]], [[1, 0, 0], [1, 0, 0]]]
    assert s.BE[1, 0] == s.BE[1, 1]
    assert s.forks.tolist() == [[0, 1]]


HEAD = WALK[: WALK.index("Frames")]
TOP = "HIERARCHY\nROOT a\n{\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": the file is empty"),
        ("HIERARCHY\n", ":1: the hierarchy has no joint"),
        ("MOTION\n", ": the hierarchy has no joint"),
        ("x" + WALK, ":1: 'xHIERARCHY' at the wrong place in the hierarchy"),
        (TOP + "OFFSET 0 0\n}", ":4: '}' is not a finite number"),
        (TOP + "OFFSET 0 0", ":4: OFFSET needs three numbers"),
        (TOP + "OFFSET 0 0 nan\n}", ":4: 'nan' is not a finite number"),
        (TOP + "OFFSET 0 0 1e999\n}", ":4: '1e999' is not"),
        (TOP + "OFFSET 0 0 1", ":4: a brace is not closed before MOTION"),
        (TOP + "}\nMOTION\n", ":2: joint 'a' has no OFFSET"),
        (TOP + "CHANNELS 2 Xrotation Yscale\n}", ":4: CHANNELS needs their number, up to 6, and as many of"),
        (TOP + "CHANNELS 7 " + "Xrotation " * 7, ":4: CHANNELS needs"),
        (TOP + "CHANNELS 2 Xrotation", ":4: CHANNELS needs"),
        (TOP + "CHANNELS", ":4: CHANNELS needs"),
        (TOP + "ROOT b", ":4: ROOT at the wrong place: is a brace missing?"),
        (TOP + "}\nJOINT b", ":5: JOINT at the wrong place"),
        ("End Site {", ":1: End at the wrong place"),
        (TOP + "End Site { JOINT b {", ":4: JOINT at the wrong place"),
        (TOP + "End Site { CHANNELS 0 }", ":4: 'CHANNELS' at the wrong place"),
        ("OFFSET 0 0 0", ":1: 'OFFSET' at the wrong place"),
        (TOP + "}}", ":4: '}' at the wrong place"),
        (TOP + "HIERARCHY", ":4: 'HIERARCHY' at the wrong place"),
        ("ROOT\n{", ":1: ROOT needs a name in its line, and then a brace"),
        ("ROOT a\nOFFSET 0 0 0 {", ":1: ROOT needs"),
        ("ROOT a", ":1: a brace is not closed before MOTION"),
        (HEAD, ': a line "Frames: NUMBER" must follow MOTION'),
        (HEAD + "\nframes 3", ':28: a line "Frames: NUMBER" must follow MOTION'),
        (HEAD + "Frames: -1", ":27: a line"),
        (HEAD + "Frames: 1\n", ':27: a line "Frame Time: SECONDS" must follow the number of frames'),
        (HEAD + "Frames: 1\nFrame Time: nan\n", ":28: 'nan' is not a finite number"),
        (HEAD + "Frames: 1\nFrame Time: -1\n", ':28: a line "Frame Time'),
        (HEAD + "Frames: 1\nFrame Time: 1 2\n", ':28: a line "Frame Time'),
        (WALK.replace("0 9 1 0", "9 1 0"), ":29: a frame has 10 numbers, one for every channel"),
        (WALK.replace(" -70", " 1 2"), ":30: a frame has 10 numbers"),
        (WALK.replace("-70", "nan"), ":30: 'nan' is not a finite number"),
        (WALK.replace("-70", "7_0"), ":30: '7_0' is not"),
        (WALK.replace("0 9 1 0", "0 9 1 x"), ":29: 'x' is not"),
        (
            WALK.replace("OFFSET 0 -4 0.5", "OFFSET 0 -1e308 0").replace("0 9 1", "0 -1e308 0"),
            ": the joints are farther",
        ),
        (WALK.replace("OFFSET 0 9", "OFFSET 0 1e308").replace("\n1 2 3", "\n1 -1e308 3"), ": the joints are farther"),
        (WALK + "\0", ":31: binary data"),
    ],
)
def test_errors_name_file_and_line(bvh, text, message):
    with pytest.raises(FileFormatError) as caught:
        bvh(text)
    assert f"walk.bvh{message}" in str(caught.value)


def test_a_bad_number_is_found_in_a_long_motion(bvh):
    row = " ".join(["1"] * 10) + "\n"
    start = HEAD + "Frames: 60000\nFrame Time: 0.01\n"
    assert len(bvh(start + row * 60000).clips[0].B) == 60000
    with pytest.raises(FileFormatError, match=r"walk\.bvh:50029: 'x' is not a finite number"):
        bvh(start + row * 50000 + row.replace("1", "x", 1) + row * 9999)


def test_many_frames_of_joints_without_channels(bvh):
    # Otherwise a few bytes a frame would become 128 bytes a joint and frame.
    joints = "JOINT a { OFFSET 0 0 0 }\n" * 5000
    text = f"ROOT r {{ OFFSET 0 0 0 CHANNELS 1 Xrotation\n{joints}}}\nMOTION\nFrames: 5000\nFrame Time: 1\n"
    with pytest.raises(FileFormatError, match="5000 frames of 5001 joints, in 5000 bytes: hardly any joint"):
        bvh(text + "0\n" * 5000)
    joints = "JOINT a { OFFSET 0 0 0 }\n" * 299
    text = f"ROOT r {{ OFFSET 0 0 0 CHANNELS 1 Xrotation\n{joints}}}\nMOTION\nFrames: 1000\nFrame Time: 1\n"
    with pytest.raises(FileFormatError, match="1000 frames of 300 joints, in 100000 bytes: hardly any joint"):
        bvh(text + ("0" * 100 + "\n") * 1000)
    assert len(bvh(text + ("0" * 2000 + "\n") * 1000).clips[0].B) == 1000


def test_two_thousand_frames(bvh, tmp_path, rng):
    b, t = 61, 2000
    s = Skeleton(
        rng.normal(size=(b, 3)), np.repeat(np.arange(b)[:, None], 2, 1), np.arange(-1, b - 1) // 2, map(str, range(b))
    )
    B = forward_kinematics(s.C, s.BE, s.P, rng.normal(size=(t, b, 3)), root_translation=rng.normal(size=(t, 3)))
    write_bvh(tmp_path / "long.bvh", Clip("long", s, np.arange(t) / 60, B))
    (clip,) = read_bvh(tmp_path / "long.bvh").clips
    assert clip.B.shape == (t, b, 4, 4)
    assert np.abs(clip.B[:, :1] - B[:, :1]).max() < 1e-6  # the root comes first in both


def by_name(clip, names):
    order = [clip.skeleton.names.index(name) for name in names]
    return clip.B[:, order], clip.skeleton.C[clip.skeleton.BE[order]], [clip.skeleton.names[j] for j in order]


RIGS = {
    "tgf": (np.array([[0, 1], [1, 2], [1, 3], [3, 4]]), [-1, 0, 0, 2]),
    "no length": (np.array([[0, 1], [1, 1], [3, 4], [4, 4]]), [-1, 0, 0, 2]),
    "apart": (np.array([[0, 1], [2, 3], [4, 5], [2, 0]]), [-1, 0, 1, 1]),
    "roots": (np.array([[0, 1], [2, 2], [3, 4]]), [-1, -1, -1]),
    "inner without length": (np.array([[0, 0], [1, 2], [2, 2]]), [-1, 0, 1]),
    "fork": (np.array([[0, 1], [1, 1], [2, 2]]), [-1, 0, 0]),
    "child first": (np.array([[1, 2], [0, 1]]), [1, -1]),
}


@pytest.mark.parametrize("form", RIGS)
@pytest.mark.parametrize("moves", ["turns", "comes apart", "collapses"])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_round_trip(tmp_path, rng, form, moves, size):
    BE, P = RIGS[form]
    b, t = len(BE), 5
    s = Skeleton(rng.normal(size=(6, 3)) * size, BE, P, [f"bone {j}" for j in range(b)])
    theta = rng.normal(size=(t, b, 3))
    theta[1, :, 0], theta[1, :, 1:] = np.pi / 2, 0  # where angles are not unique
    theta[2] = 1e-7
    B = forward_kinematics(s.C, s.BE, s.P, theta, root_translation=rng.normal(size=(t, 3)) * size)
    if moves == "comes apart":
        B[..., :3, 3] += rng.normal(size=(t, b, 3)) * size
    elif moves == "collapses":  # every bone starts near the origin, as with positions relative to the OFFSETs
        B[..., :3, 3] = -(B[..., :3, :3] @ s.C[s.BE[:, 0]][:, :, None])[..., 0] + 1e-3 * size
    times = 2 + np.arange(t) / 24
    notes = write_bvh(tmp_path / "a.bvh", Clip("a", s, times, B))
    assert notes == ("the motion starts at 2 s, in the file at 0 s",)
    parts = read_bvh(tmp_path / "a.bvh")
    read_B, ends, names = by_name(parts.clips[0], s.names)
    assert names == list(s.names)
    parents = [parts.skeleton.names[p] if p >= 0 else None for p in parts.skeleton.P]
    assert dict(zip(parts.skeleton.names, parents, strict=True)) == {
        name: s.names[p] if p >= 0 else None for name, p in zip(s.names, s.P, strict=True)
    }
    assert np.abs(ends - s.C[s.BE]).max() < 1e-12 * size
    assert np.abs(parts.clips[0].times - times + 2).max() < 1e-12
    # Points on and around the bones land at the same place.
    x = rng.normal(size=(50, 1, 1, 3)) * size
    assert np.abs(transform_points(read_B, x) - transform_points(B, x)).max() < 1e-6 * size


def test_a_flat_skeleton_and_single_frames(tmp_path):
    s = Skeleton([[0, 0], [2, 0]], [[0, 1]], [-1], ["a"])
    B = np.eye(4)[None, None].copy()
    B[0, 0, :3, :3] = rotation_matrices([0, 0, 0.5])
    for t in (0, 1):
        write_bvh(tmp_path / f"{t}.bvh", Clip("a", s, np.zeros(t), B[:t]))
        (clip,) = read_bvh(tmp_path / f"{t}.bvh").clips
        assert clip.skeleton.C.tolist() == [[0, 0, 0], [2, 0, 0]]
        assert clip.B.shape == (t, 1, 4, 4)
        assert np.abs(clip.B - B[:t]).max(initial=0) < 1e-10


def test_bones_that_stay_together_have_rotations_only(tmp_path, rng):
    s = Skeleton(rng.normal(size=(3, 3)), [[0, 1], [1, 2]], [-1, 0], ["a", "b"])
    B = forward_kinematics(s.C, s.BE, s.P, rng.normal(size=(4, 2, 3)))
    # In float32, as most files have it.
    write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(4), B.astype(np.float32).astype(float)))
    text = (tmp_path / "a.bvh").read_text()
    assert text.count("CHANNELS 6") == text.count("CHANNELS 3") == 1
    B[2, 1, 0, 3] += 1e-5  # of a size of about one
    write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(4), B))
    assert np.abs(read_bvh(tmp_path / "a.bvh").clips[0].B - B).max() < 1e-8


def test_what_the_file_cannot_hold(tmp_path):
    s = Skeleton([[0, 0, 0], [1, 0, 0]], [[0, 1], [1, 1]], [-1, 0], ["a", "b"])
    still = np.tile(np.eye(4), (4, 2, 1, 1))
    for row, column, value in [(0, 0, 1.1), (0, 1, 0.1), (2, 2, -1), (3, 0, 0.5)]:
        B = still.copy()
        B[2, 1, row, column] = value
        with pytest.raises(ValueError, match="bone 'b' is scaled, sheared or mirrored in frame 2"):
            write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(4), B))
    with pytest.raises(ValueError, match=r"frame 2, at 2\.5 s, is not: give the motion at a constant rate"):
        write_bvh(tmp_path / "a.bvh", Clip("a", s, np.array([0, 1, 2.5, 3]), still))
    with pytest.raises(ValueError, match="must be"):
        write_bvh(tmp_path / "a.bvh", Clip("a", s, np.arange(3), still))
    assert not (tmp_path / "a.bvh").exists()
    names = Skeleton(s.C, s.BE, s.P, ["a{b}\n", "  two  words "])
    (note,) = write_bvh(tmp_path / "a.bvh", Clip("a", names, np.arange(4), still))
    assert read_bvh(tmp_path / "a.bvh").skeleton.names == ("a_b_", "_two_words_")
    assert "'  two  words ' became '_two_words_'" in note


@given(data=st.data())
def test_anything_is_read_or_refused(bvh, data):
    content = bytearray(WALK.encode())
    words = [
        b"ROOT",
        b"JOINT a",
        b"End Site",
        b"{",
        b"}",
        b"OFFSET 0 0 0",
        b"CHANNELS 1 Xrotation",
        b"\n",
        b"1",
        b"-1e308",
    ]
    words += [b"MOTION\n", b"Frames: 0\n", b"Frames: 99999999\n", b"Frame Time: 0\n", b"nan", b"", b"\xff"]
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content)))
        stop = at + data.draw(st.sampled_from([0, 0, 1, 10, 1000]))
        content[at:stop] = b" " + data.draw(st.sampled_from(words) | st.binary(max_size=4)) + b" "
    parts = message = None
    try:
        parts = bvh(bytes(content))
    except FileFormatError as error:
        message = str(error)
    if parts is None:
        assert "walk.bvh" in message
        assert "\n" not in message
    else:
        assert np.isfinite(parts.clips[0].B).all()


@pytest.mark.parametrize(
    ("name", "b", "t"), [("walk1", 75, 14), ("zombieWalk1", 75, 31), ("dance1", 75, 1), ("tpose", 173, 1)]
)
def test_real_files(data, tmp_path, name, b, t):
    parts = read_bvh(data / "makehuman" / f"{name}.bvh")
    (clip,) = parts.clips
    assert clip.B.shape == (t, b, 4, 4)
    decided = {"tpose": ["are added to their OFFSETs (143)"], "walk1": ["the root 'Root' are zero: it stays"]}
    assert all(words in note for words, note in zip(decided.get(name, []), parts.notes, strict=True))
    write_bvh(tmp_path / "a.bvh", clip)
    read_B, ends, _ = by_name(read_bvh(tmp_path / "a.bvh").clips[0], clip.skeleton.names)
    assert np.abs(ends - clip.skeleton.C[clip.skeleton.BE]).max() < 1e-12
    x = clip.skeleton.C
    assert np.abs(
        transform_points(read_B[:, :, None], x) - transform_points(clip.B[:, :, None], x)
    ).max() < 1e-5 * np.ptp(x)
