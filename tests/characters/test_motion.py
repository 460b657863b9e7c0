from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nilbs.characters.motion import Motion, load_motion, motion_of_clips, random_motion
from nilbs.geometry.kinematics import forward_kinematics, interpolate_poses, local_rotations
from nilbs.geometry.rotations import rigid_transforms, rotation_matrices
from nilbs.geometry.skeleton import Skeleton, skeleton_of_joints
from nilbs.io.bone_map import write_bone_map
from nilbs.io.bundle import Bundle, Clip
from nilbs.io.bvh import write_bvh
from nilbs.io.errors import FileFormatError
from nilbs.io.gltf_writer import write_gltf
from nilbs.io.motion import write_motion_json, write_transforms


def counted(frames: int) -> Motion:
    """A motion whose frame k moves its only bone by k."""
    B = np.broadcast_to(np.eye(3), (frames, 1, 3, 3)).copy()
    B[:, 0, 0, 2] = np.arange(frames)
    return Motion(B, np.arange(100, 100 + frames), "counted")


def limb(d: int, *names: str, size: float = 1.0) -> Skeleton:
    """Bones in a row along x."""
    b = len(names)
    joints = size * np.arange(b + 1)[:, None] * np.eye(d)[0]
    return skeleton_of_joints(joints[:b], np.arange(b) - 1, names, ends={b - 1: joints[b]})


def swung(skeleton: Skeleton, rng: np.random.Generator, frames: int = 4) -> np.ndarray:
    """Poses of a skeleton, the first at rest; those of a chain about z stay in the plane."""
    theta = np.zeros((frames, len(skeleton.BE), 3 if skeleton.d == 3 else 1))
    theta[1:, :, -1] = rng.uniform(-1, 1, (frames - 1, len(skeleton.BE)))
    return forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta)


def in_space(B: np.ndarray) -> np.ndarray:
    """Transforms of the plane as transforms of space."""
    full = np.broadcast_to(np.eye(4), (*B.shape[:2], 4, 4)).copy()
    full[..., :2, :2], full[..., :2, 3] = B[..., :2, :2], B[..., :2, 2]
    return full


def test_frames_count_from_zero() -> None:
    motion = counted(5)
    assert len(motion) == 5
    assert motion[3][0, 0, 2] == 3
    assert motion[-1][0, 0, 2] == 4
    assert [pose[0, 0, 2] for pose in motion] == [0, 1, 2, 3, 4]
    for k in (5, -6):
        with pytest.raises(IndexError, match=rf"^frame {k} does not exist: the motion has 5 frames, counted from 0$"):
            motion[k]


def test_lists_become_arrays() -> None:
    motion = Motion(counted(4).B.tolist(), range(3, 7), "lists")
    assert motion.B.dtype == np.float64
    assert motion.frames.dtype == np.int64
    np.testing.assert_array_equal(motion.take(2).frames, [3, 6])


@pytest.mark.parametrize(
    ("n", "expected"), [(1, [0]), (2, [0, 9]), (4, [0, 3, 6, 9]), (10, range(10)), (99, range(10))]
)
def test_evenly_spaced_frames_keep_their_numbers(n: int, expected) -> None:
    taken = counted(10).take(n)
    np.testing.assert_array_equal(taken.B[:, 0, 0, 2], list(expected))
    np.testing.assert_array_equal(taken.frames, 100 + np.array(expected))
    assert taken.source == "counted"


def test_no_frames_cannot_be_taken() -> None:
    with pytest.raises(ValueError, match=r"^a motion needs at least one frame, got 0$"):
        counted(3).take(0)


@pytest.mark.parametrize(
    ("B", "frames"), [(np.zeros((3, 1, 3, 3)), np.arange(2)), (np.zeros((3, 1, 3, 4)), np.arange(3)), (np.eye(3), [0])]
)
def test_wrong_motions_are_refused(B: np.ndarray, frames: np.ndarray) -> None:
    with pytest.raises(ValueError, match="must be"):
        Motion(B, frames, "nothing")


@pytest.mark.parametrize("d", [2, 3])
def test_a_random_motion_is_the_seed_s_and_has_its_amplitude(d: int, characters) -> None:
    c = characters[d]
    motion = random_motion(c, frames=50, amplitude=0.3, seed=4)
    assert motion.B.shape == (50, len(c.skeleton.BE), d + 1, d + 1)
    np.testing.assert_array_equal(motion.frames, np.arange(50))
    assert motion.source == "random, amplitude 0.3 rad rms, 50 frames, seed 4"
    assert motion.rms_rotation(c) == pytest.approx(0.3, rel=1e-6)
    # Every bone but the roots, not only on the mean.
    theta, root = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, motion.B)
    rms = np.sqrt((theta**2).sum(axis=-1).mean(axis=0))
    np.testing.assert_allclose(rms, np.where(c.skeleton.P < 0, 0, 0.3), atol=1e-6)
    np.testing.assert_allclose(root, 0, atol=1e-9)
    np.testing.assert_array_equal(random_motion(c, frames=50, amplitude=0.3, seed=4).B, motion.B)
    assert np.abs(random_motion(c, frames=50, amplitude=0.3, seed=5).B - motion.B).max() > 0.1


def test_random_motions_that_cannot_be(characters) -> None:
    with pytest.raises(ValueError, match=r"^a motion needs at least one frame, got 0$"):
        random_motion(characters[2], frames=0)
    with pytest.raises(ValueError, match=r"^amplitude must not be negative, got -0.1$"):
        random_motion(characters[2], amplitude=-0.1)


def test_a_motion_without_local_rotations_has_no_rms(characters) -> None:
    c = characters[3]
    motion = random_motion(c, frames=3)
    scaled = Motion(motion.B @ np.diag([2, 2, 2, 1.0]), motion.frames, "scaled")
    assert scaled.rms_rotation(c) is None
    only_roots = replace(c, skeleton=replace(c.skeleton, P=np.full(3, -1), BE=np.array([[0, 1]] * 3)))
    assert Motion(np.broadcast_to(np.eye(4), (2, 3, 4, 4)), np.arange(2), "still").rms_rotation(only_roots) is None


@pytest.mark.parametrize("d", [2, 3])
def test_transforms_from_a_file(d: int, characters, tmp_path: Path) -> None:
    c = characters[d]
    motion = random_motion(c, frames=4)
    write_transforms(tmp_path / "m.dmat", motion.B if d == 3 else in_space(motion.B))
    again = load_motion(tmp_path / "m.dmat", c)
    np.testing.assert_allclose(again.B, motion.B, atol=1e-12)
    np.testing.assert_array_equal(again.frames, np.arange(4))
    assert again.source == "m.dmat"


@pytest.mark.parametrize("d", [2, 3])
def test_local_rotations_from_a_file(d: int, characters, tmp_path: Path, rng: np.random.Generator) -> None:
    c = characters[d]
    theta = rng.uniform(-1, 1, (4, len(c.skeleton.BE), 3 if d == 3 else 1))
    move = rng.normal(size=(4, d))
    write_motion_json(tmp_path / "m.json", c.skeleton.names, theta, move)
    B = forward_kinematics(c.skeleton.C, c.skeleton.BE, c.skeleton.P, theta, root_translation=move)
    np.testing.assert_allclose(load_motion(tmp_path / "m.json", c).B, B, atol=1e-9)


def test_motions_of_other_rigs_or_of_no_known_format_are_refused(characters, tmp_path: Path) -> None:
    flat, solid = characters[2], characters[3]
    write_transforms(tmp_path / "m.dmat", random_motion(solid, frames=2).B)
    with pytest.raises(FileFormatError, match=r"m\.dmat: moves 3 bones, but the rig has 13$"):
        load_motion(tmp_path / "m.dmat", flat)
    B = in_space(random_motion(flat, frames=3).B)
    B[2, 5, 0, 2] = 0.1
    write_transforms(tmp_path / "tilted.dmat", B)
    with pytest.raises(FileFormatError, match=r"frame 2 moves bone 5 out of the plane of a flat character$"):
        load_motion(tmp_path / "tilted.dmat", flat)
    for name, message in (
        ("m.abc", r"end in \.dmat or \.json or \.bvh or .*, not \.abc$"),
        ("m", "this one has none$"),
    ):
        with pytest.raises(FileFormatError, match=message):
            load_motion(tmp_path / name, flat)
    with pytest.raises(FileNotFoundError):
        load_motion(tmp_path / "none.json", flat)


def test_frames_without_times_count_at_24_a_second() -> None:
    np.testing.assert_allclose(counted(3).times, np.array([100, 101, 102]) / 24)
    np.testing.assert_allclose(counted(5).take(2).times, np.array([100, 104]) / 24)
    assert len(Motion(np.zeros((0, 1, 3, 3)), np.zeros(0), "none").times) == 0


def test_poses_between_frames_by_number_and_by_time() -> None:
    motion = replace(counted(4), times=np.array([0, 1, 1, 3]))
    for frame, x in ((0, 0), (1.25, 1.25), (3, 3)):
        assert motion.at(frame=frame)[0, 0, 2] == pytest.approx(x)
    # Where two frames stand at one time the later one goes on.
    for seconds, x in ((0, 0), (0.25, 0.25), (1, 2), (2, 2.5), (3, 3)):
        assert motion.at(seconds=seconds)[0, 0, 2] == pytest.approx(x)
    taken = replace(motion, frames=np.arange(4)).take(2)
    assert taken.at(seconds=1.5)[0, 0, 2] == pytest.approx(1.5)


def test_frames_and_times_that_are_not_there() -> None:
    motion = counted(4)
    for frame in (-0.1, 3.5, np.nan):
        with pytest.raises(ValueError, match=r"there is no frame .*: the motion has 4 frames, counted from 0$"):
            motion.at(frame=frame)
    # Before the first frame and after the last the pose is theirs.
    np.testing.assert_array_equal(motion.at(seconds=[-np.inf, 0.0, 5.0, np.inf]), motion.B[[0, 0, 3, 3]])
    with pytest.raises(ValueError, match=r"^there is no pose at nan s$"):
        motion.at(seconds=[4.2, np.nan])
    with pytest.raises(ValueError, match="the motion has no frame"):
        Motion(np.zeros((0, 1, 3, 3)), np.zeros(0), "none").at(seconds=0)
    for both in ({}, {"frame": 0, "seconds": 0}):
        with pytest.raises(ValueError, match="give either frame or seconds"):
            motion.at(**both)
    with pytest.raises(ValueError, match="times decrease after frame 1"):
        replace(motion, times=np.array([0, 2, 1, 3]))
    with pytest.raises(ValueError, match=r"times must be \(4,\)"):
        replace(motion, times=np.arange(3))
    with pytest.raises(ValueError, match=r"shape \(4, 1, 3, 3\), but the skeleton has 2 bones in 2 dimensions"):
        replace(motion, skeleton=limb(2, "a", "b"))


@pytest.mark.parametrize("d", [2, 3])
def test_between_frames_joints_stay_together_where_there_is_a_skeleton(d: int, rng: np.random.Generator) -> None:
    skeleton = limb(d, "a", "b", "c")
    B = swung(skeleton, rng)
    motion = Motion(B, np.arange(4), "swung", skeleton=skeleton)
    pose = motion.at(frame=1.3)
    expected = interpolate_poses(skeleton.C, skeleton.BE, skeleton.P, B[1], B[2], 0.3)
    np.testing.assert_allclose(pose, expected, atol=1e-12)
    local_rotations(skeleton.C, skeleton.BE, skeleton.P, pose)
    with pytest.raises(ValueError, match="comes apart"):
        local_rotations(skeleton.C, skeleton.BE, skeleton.P, replace(motion, skeleton=None).at(frame=1.3))


def test_a_motion_in_json_moves_and_scales_bones_and_has_times(tmp_path: Path) -> None:
    skeleton = limb(3, "a", "b", "c")
    (tmp_path / "m.json").write_text(
        '{"fps": 10, "frames": [{}, {"b": {"rotation": [0, 0, 90], "translation": [0, 0, 1], "scale": 2}}]}'
    )
    motion = load_motion(tmp_path / "m.json", skeleton)
    assert motion.times.tolist() == [0, 0.1]
    assert motion.skeleton is skeleton
    np.testing.assert_allclose(motion[0], np.tile(np.eye(4), (3, 1, 1)))
    np.testing.assert_allclose(motion[1][0], np.eye(4))
    # The joint between b and c lies at distance 1 from b's: twice that, turned upward, and moved.
    np.testing.assert_allclose(motion[1][1:] @ [2, 0, 0, 1], [[1, 2, 1, 1]] * 2, atol=1e-12)
    np.testing.assert_allclose(motion[1][1] @ [1, 0, 0, 1], [1, 0, 1, 1], atol=1e-12)


def test_children_of_a_given_transform_follow_it(tmp_path: Path, rng: np.random.Generator) -> None:
    skeleton = limb(3, "a", "b", "c")
    given = np.eye(4)
    given[:3] = rng.normal(size=(3, 4))
    theta, move = rng.uniform(-1, 1, (2, 3, 3)), rng.normal(size=(2, 3))
    placed, translation = np.full((2, 3, 4, 4), np.nan), np.zeros((2, 3, 3))
    placed[1, 1], translation[0] = given, rng.normal(size=(3, 3))
    write_motion_json(tmp_path / "m.json", skeleton.names, theta, move, translation=translation, given=placed)
    B = load_motion(tmp_path / "m.json", skeleton).B
    c = skeleton
    usual = forward_kinematics(c.C, c.BE, c.P, theta, root_translation=move, translation=translation)
    np.testing.assert_allclose(B[0], usual[0], atol=1e-12)
    np.testing.assert_allclose(B[1, 0], usual[1, 0], atol=1e-12)
    np.testing.assert_allclose(B[1, 1], given, atol=1e-12)
    center = skeleton.C[2]
    local = rigid_transforms(rotation_matrices(theta[1, 2]), center - rotation_matrices(theta[1, 2]) @ center)
    np.testing.assert_allclose(B[1, 2], given @ local, atol=1e-12)


def test_motions_beyond_numbers_are_refused(tmp_path: Path) -> None:
    entry = ", ".join(f'"{name}": {{"scale": 1e150}}' for name in "abc")
    (tmp_path / "m.json").write_text(f'{{"frames": [{{}}, {{{entry}}}]}}')
    with pytest.raises(FileFormatError, match=r"m\.json: frame 1 moves bone 'c' farther than numbers go$"):
        load_motion(tmp_path / "m.json", limb(3, "a", "b", "c"))


def test_a_clip_of_the_same_bones_is_taken_as_it_is(tmp_path: Path, rng: np.random.Generator) -> None:
    skeleton = limb(3, "a", "b", "c")
    clip = Clip("swing", skeleton, np.array([0, 0.5, 1, 1.5]), swung(skeleton, rng))
    write_bvh(tmp_path / "m.bvh", clip)
    notes: list[str] = []
    motion = load_motion(tmp_path / "m.bvh", skeleton, report=notes.append)
    np.testing.assert_allclose(motion.B, clip.B, atol=1e-5)
    np.testing.assert_allclose(motion.times, clip.times, atol=1e-6)
    assert (motion.source, notes) == ("m.bvh", [])
    # Whatever their order and in whatever company.
    other = Skeleton([[1, 0, 0], [0, 0, 0], [2, 0, 0]], [[0, 2], [1, 0]], [1, -1], ("b", "a"))
    np.testing.assert_allclose(load_motion(tmp_path / "m.bvh", other).B, clip.B[:, [1, 0]], atol=1e-5)


def test_a_clip_of_another_skeleton_is_mapped_with_a_note(tmp_path: Path, rng: np.random.Generator) -> None:
    source, target = limb(3, "UpArm_L", "LoArm_L", "Hand_L", "ring"), limb(3, "upperarm.L", "forearm.L", "tail", size=2)
    clip = Clip("swing", source, np.arange(4) / 10, swung(source, rng))
    write_bvh(tmp_path / "m.bvh", clip)
    notes: list[str] = []
    motion = load_motion(tmp_path / "m.bvh", target, report=notes.append)
    np.testing.assert_allclose(motion.B[:, :2, :3, :3], clip.B[:, :2, :3, :3], atol=1e-5)
    np.testing.assert_allclose(motion.B[:, 2], motion.B[:, 1], atol=1e-12)
    assert notes == [
        "m.bvh: 2 of 3 bones follow a bone of the motion, 0 of them one of the same name, and 1 keeps the rest "
        "pose; axes agree; lengths are multiplied by 2",
        "m.bvh: UpArm_L -> upperarm.L",
        "m.bvh: LoArm_L -> forearm.L",
        "m.bvh: keep their rest pose to the bone above: tail",
        "m.bvh: not used of the motion: Hand_L, ring",
    ]
    # Corrected by hand, as a mapping or in a file.
    corrected = {"upperarm.L": "UpArm_L", "forearm.L": None, "tail": "Hand_L"}
    write_bone_map(tmp_path / "map.json", corrected)
    for bone_map in (corrected, tmp_path / "map.json", str(tmp_path / "map.json")):
        B = load_motion(tmp_path / "m.bvh", target, bone_map=bone_map).B
        np.testing.assert_allclose(B[:, :, :3, :3], clip.B[:, [0, 0, 2], :3, :3], atol=1e-5)
    # A map is kept to where the names alone would do, too.
    own = load_motion(tmp_path / "m.bvh", source, bone_map={"ring": "UpArm_L"}).B
    np.testing.assert_allclose(own[:, 3, :3, :3], clip.B[:, 0, :3, :3], atol=1e-5)


def test_other_axes_and_far_starts_are_noted(tmp_path: Path, rng: np.random.Generator) -> None:
    source = limb(3, "a", "b")
    turned = Skeleton(source.C[:, [2, 0, 1]], source.BE, source.P, source.names)
    B = swung(source, rng)
    B[..., 1, 3] += 50
    write_bvh(tmp_path / "m.bvh", Clip("m", source, np.arange(4) / 24, B))
    notes: list[str] = []
    motion = load_motion(tmp_path / "m.bvh", turned, report=notes.append)
    assert "axes differ: its x is y here" in notes[0]
    assert "starts far from its rest pose along" in notes[1]
    np.testing.assert_allclose(motion.B[0], np.tile(np.eye(4), (2, 1, 1)), atol=1e-5)


def test_one_of_several_clips_is_chosen_by_name(tmp_path: Path, rng: np.random.Generator) -> None:
    skeleton = limb(3, "a", "b")
    clips = tuple(Clip(name, skeleton, np.arange(4) / 10, swung(skeleton, rng)) for name in ("walk", "run"))
    write_gltf(tmp_path / "m.glb", Bundle(skeleton=skeleton, clips=clips))
    chosen = load_motion(tmp_path / "m.glb", skeleton, clip="run")
    np.testing.assert_allclose(chosen.B, clips[1].B, atol=1e-5)
    assert chosen.source == "m.glb, run"
    with pytest.raises(FileFormatError, match=r"m\.glb: there is no motion 'swim', but 'walk', 'run'$"):
        load_motion(tmp_path / "m.glb", skeleton, clip="swim")
    names = ("Armature|Walk_01", "Armature|Run_01", "Armature|Run_02", "Idle", "idle_long")
    more = tuple(Clip(name, skeleton, clips[0].times, clips[0].B) for name in names)
    write_gltf(tmp_path / "m.glb", Bundle(skeleton=skeleton, clips=more))
    for given, meant in (("walk", names[0]), ("run_02", names[2]), ("IDLE", "Idle"), ("long", "idle_long")):
        assert load_motion(tmp_path / "m.glb", skeleton, clip=given).source == f"m.glb, {meant}"
    with pytest.raises(FileFormatError, match=r"2 motions have 'run' in their names: .*Run_01', .*Run_02'$"):
        load_motion(tmp_path / "m.glb", skeleton, clip="run")
    with pytest.raises(FileFormatError, match=r"no motion 'idel', but 'Idle', .*\(the nearest: 'Idle'\)$"):
        load_motion(tmp_path / "m.glb", skeleton, clip="idel")
    with pytest.raises(FileFormatError, match=r"\(the nearest: 'Armature.Walk_01'\)$"):
        load_motion(tmp_path / "m.glb", skeleton, clip="wlak")
    write_gltf(tmp_path / "rig.glb", Bundle(skeleton=skeleton))
    with pytest.raises(FileFormatError, match=r"rig\.glb: the file holds no motion"):
        load_motion(tmp_path / "rig.glb", skeleton)


def several(skeleton: Skeleton, rng: np.random.Generator) -> tuple[Clip, ...]:
    """Clips of 4, 2 and 7 frames that last 1, 3 and 2 s and do not start at 0 s."""
    lengths = (("walk", 4, 1.0), ("rest", 2, 3.0), ("run", 7, 2.0))
    return tuple(
        Clip(name, skeleton, np.linspace(0.5, 0.5 + seconds, n), swung(skeleton, rng, n))
        for name, n, seconds in lengths
    )


def test_clips_of_a_file_follow_each_other_and_never_blend(tmp_path: Path, rng: np.random.Generator) -> None:
    skeleton = limb(3, "a", "b")
    clips = several(skeleton, rng)
    write_gltf(tmp_path / "m.glb", Bundle(skeleton=skeleton, clips=clips))
    motion = load_motion(tmp_path / "m.glb", skeleton)
    assert motion.source == "m.glb, walk, rest, run"
    assert motion.clips == (("walk", 0), ("rest", 4), ("run", 6))
    np.testing.assert_allclose(motion.B, np.concatenate([clip.B for clip in clips]), atol=1e-5)
    np.testing.assert_allclose(np.ptp(motion.times), 6, atol=1e-6)
    assert (np.diff(motion.times)[[3, 5]] == 0).all()
    assert motion.gaps().tolist() == [0, 1, 2, 4, 6, 7, 8, 9, 10, 11]
    for last in (3, 5):
        np.testing.assert_array_equal(motion.at(frame=last + 0.5), motion[last])
        np.testing.assert_array_equal(motion.at(seconds=motion.times[last]), motion[last + 1])
    between = interpolate_poses(skeleton.C, skeleton.BE, skeleton.P, motion[4], motion[5], 0.5)
    np.testing.assert_allclose(motion.at(seconds=0.5 + 1 + 1.5), between, atol=1e-6)
    # Where frames are left out time passes between clips: the pose stays.
    few = motion.take(4)
    assert (few.frames.tolist(), few.clips) == ([0, 4, 8, 12], (("walk", 0), ("rest", 1), ("run", 2)))
    assert few.gaps().tolist() == [2]
    np.testing.assert_array_equal(few.at(seconds=1.0), few[0])


def test_frames_are_spread_over_time_and_not_over_keys(tmp_path: Path, rng: np.random.Generator) -> None:
    skeleton = limb(3, "a", "b")
    motion = motion_of_clips([replace(clip, file="m.glb") for clip in several(skeleton, rng)], skeleton)
    spread = motion.spread(7)  # at 0.5, 1.5, ... 6.5 s; keys stand at 0.5 to 1.5, at 1.5 and 4.5, and at 4.5 to 6.5
    assert spread.frames.tolist() == [0, 4, 5, 6, 9, 12]
    assert spread.clips == (("walk", 0), ("rest", 1), ("run", 3))
    np.testing.assert_array_equal(spread.B, motion.B[spread.frames])
    assert motion.spread(13) is motion
    assert motion.spread(2).clips == (("walk", 0), ("run", 1))
    with pytest.raises(ValueError, match="at least one frame, got 0"):
        motion.spread(0)


@pytest.mark.parametrize("frames", [2, 10, 33, 457])
def test_even_frames_are_spread_as_they_are_taken(frames: int) -> None:
    motion = counted(frames)
    for n in (1, 2, 5, 9, 10, 32, 100):
        np.testing.assert_array_equal(motion.spread(n).frames, motion.take(n).frames)
    still = replace(motion, times=np.zeros(frames))
    np.testing.assert_array_equal(still.spread(5).frames, motion.take(5).frames)


@pytest.mark.parametrize("starts", [[1, 2], [0, 2, 2], [0, 5], [0, 3, 1]])
def test_clips_that_cannot_follow_each_other(starts: list[int]) -> None:
    with pytest.raises(ValueError, match="clips must start one after the other from frame 0 of 5"):
        replace(counted(5), clips=tuple((f"clip{start}", start) for start in starts))


def test_creatures_move_by_their_own_clips(data: Path) -> None:
    from nilbs.characters.bundle import load_bundle

    bundle = load_bundle([data / "creatures" / "fox.glb"])
    motion = motion_of_clips(bundle.clips, bundle.skeleton)
    assert (len(motion), len(motion.clips), motion.clips[0]) == (539, 14, ("Bark", 0))
    assert motion.source.startswith("fox.glb, Bark, Bite, ")
    durations = [np.ptp(clip.times) for clip in bundle.clips]
    assert np.ptp(motion.times) == pytest.approx(sum(durations))
    spread = motion.spread(100)
    assert 95 <= len(spread) <= 100
    assert [name for name, _ in spread.clips] == [clip.name for clip in bundle.clips]
    counts = np.diff([start for _, start in spread.clips] + [len(spread)])
    assert np.abs(counts - 100 * np.array(durations) / sum(durations)).max() < 2
    one = motion_of_clips(bundle.clips, bundle.skeleton, clip="Walk")
    assert (one.source, len(one), one.clips) == ("fox.glb, Walk", 30, ())


def test_clips_that_fit_nothing_are_refused_by_the_file_s_name(tmp_path: Path, rng: np.random.Generator) -> None:
    source, target = limb(3, "a", "b"), limb(3, "x", "y")
    write_bvh(tmp_path / "m.bvh", Clip("m", source, np.arange(4) / 24, swung(source, rng)))
    with pytest.raises(ValueError, match=r'm\.bvh: no bone of the motion has a name like .* \{"x": "a"\}'):
        load_motion(tmp_path / "m.bvh", target)
    with pytest.raises(ValueError, match=r"m\.bvh: the bone map names 'z', but the character has no such bone"):
        load_motion(tmp_path / "m.bvh", target, bone_map={"z": "a"})
    (tmp_path / "map.json").write_text("[]")
    with pytest.raises(FileFormatError, match=r"map\.json: a bone map is one object"):
        load_motion(tmp_path / "m.bvh", target, bone_map=tmp_path / "map.json")
    write_bvh(tmp_path / "none.bvh", Clip("m", source, np.zeros(0), np.zeros((0, 2, 4, 4))))
    with pytest.raises(FileFormatError, match=r"none\.bvh: the motion 'none' has no frame"):
        load_motion(tmp_path / "none.bvh", source)


def test_a_file_of_the_character_s_own_bones_takes_no_map(tmp_path: Path) -> None:
    for name in ("m.json", "m.dmat"):
        with pytest.raises(FileFormatError, match="there is no clip to choose"):
            load_motion(tmp_path / name, limb(3, "a"), clip="walk")
        with pytest.raises(FileFormatError, match="there is no bone map to choose"):
            load_motion(tmp_path / name, limb(3, "a"), bone_map={"a": "a"})


def test_clips_in_the_plane(tmp_path: Path, rng: np.random.Generator) -> None:
    flat, solid = limb(2, "a", "b"), limb(3, "a", "b")
    B = swung(flat, rng)
    write_bvh(tmp_path / "m.bvh", Clip("m", solid, np.arange(4) / 24, in_space(B)))
    np.testing.assert_allclose(load_motion(tmp_path / "m.bvh", flat).B, B, atol=1e-5)
    larger = limb(2, "a", "b", size=3)
    np.testing.assert_allclose(load_motion(tmp_path / "m.bvh", larger).B[..., :2, :2], B[..., :2, :2], atol=1e-5)
    deep = Skeleton(solid.C * [1, 1, 0] + np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 0]]), solid.BE, solid.P, solid.names)
    write_bvh(tmp_path / "deep.bvh", Clip("m", deep, np.arange(4) / 24, in_space(B)))
    with pytest.raises(FileFormatError, match=r"deep\.bvh: .*joint"):
        load_motion(tmp_path / "deep.bvh", flat)


@pytest.mark.parametrize(
    ("name", "scale"), [("walk1", 1.046), ("zombieWalk1", 1.046), ("dance1", 1.050), ("tpose", 0.997)]
)
def test_motions_of_a_person_on_another_rig(data: Path, name: str, scale: float) -> None:
    """Clips that are Z up and rest in a T on a rig that is Y up and rests with bent arms, by the map found."""
    from nilbs.geometry.retargeting import guess_bone_map
    from nilbs.io.bvh import read_bvh
    from nilbs.io.makehuman import read_mhskel
    from nilbs.io.mesh import read_mesh

    folder = data / "makehuman"
    target = read_mhskel(folder / "default.mhskel", read_mesh(folder / "base.obj")[0])
    (clip,) = read_bvh(folder / f"{name}.bvh").clips
    bone_map = guess_bone_map(clip.skeleton, target)
    notes: list[str] = []
    motion = load_motion(folder / f"{name}.bvh", target, report=notes.append)
    assert any(
        f"its y is -z here, its z is y here; lengths are multiplied by {scale:.3f}"[:-1] in line for line in notes
    )
    local_rotations(target.C, target.BE, target.P, motion.B)

    def joints(skeleton: Skeleton, B: np.ndarray, *names: str) -> np.ndarray:
        first = np.array([[*skeleton.C[skeleton.BE[skeleton.names.index(bone), 0]], 1] for bone in names])
        return (B[:, [skeleton.names.index(bone) for bone in names]] @ first[..., None])[..., :3, 0]

    # Upper arms, forearms, thighs and shins point where those of the clip point.
    for first, then in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist"), ("upperleg01", "lowerleg01"),
                        ("lowerleg01", "foot")):  # fmt: skip
        for side in ".L", ".R":
            mine = joints(target, motion.B, first + side, then + side)
            theirs = joints(clip.skeleton, clip.B, bone_map[first + side], bone_map[then + side])[..., [0, 2, 1]] * [
                1,
                1,
                -1,
            ]
            way, way_theirs = mine[:, 1] - mine[:, 0], theirs[:, 1] - theirs[:, 0]
            cosine = (way * way_theirs).sum(-1) / np.linalg.norm(way, axis=-1) / np.linalg.norm(way_theirs, axis=-1)
            assert cosine.min() > 1 - (5e-3 if name == "tpose" else 1e-9)  # whose joints come apart
    if "alk" in name:  # one foot or the other on the ground in every frame, to 4 % of a height of 16.7
        heights = joints(target, motion.B, *(n for n in target.names if n.startswith("toe")))[..., 1].min(axis=1)
        assert np.abs(heights - target.C[:, 1].min()).max() < 0.7


def test_model_files_hold_times(models, tmp_path: Path) -> None:
    from nilbs.models.model import load_model

    motion = replace(models[2].motion, times=np.array([0, 1, 1.5, 4, 5, 6]))
    replace(models[2], motion=motion).save(tmp_path / "m.nilbs")
    again = load_model(tmp_path / "m.nilbs").motion
    np.testing.assert_array_equal(again.times, motion.times)
    np.testing.assert_allclose(again.at(seconds=1.5), motion[2])
    assert again.skeleton.names == models[2].character.skeleton.names
    several = replace(motion, clips=(("walk", 0), ("run", 4)))
    replace(models[2], motion=several).save(tmp_path / "m.nilbs")
    assert load_model(tmp_path / "m.nilbs").motion.clips == several.clips
