from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nilbs.geometry.kinematics import forward_kinematics, local_rotations
from nilbs.io.errors import FileFormatError
from nilbs.io.motion import write_motion_json, write_transforms
from nilbs.motion import Motion, random_motion, read_motion


def counted(frames: int) -> Motion:
    """A motion whose frame k moves its only bone by k."""
    B = np.broadcast_to(np.eye(3), (frames, 1, 3, 3)).copy()
    B[:, 0, 0, 2] = np.arange(frames)
    return Motion(B, np.arange(100, 100 + frames), "counted")


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
def test_what_is_no_motion_is_refused(B: np.ndarray, frames: np.ndarray) -> None:
    with pytest.raises(ValueError, match="must be"):
        Motion(B, frames, "nothing")


@pytest.mark.parametrize("d", [2, 3])
def test_a_random_motion_is_the_seed_s_and_has_its_amplitude(d: int, characters) -> None:
    c = characters[d]
    motion = random_motion(c, frames=50, amplitude=0.3, seed=4)
    assert motion.B.shape == (50, len(c.BE), d + 1, d + 1)
    np.testing.assert_array_equal(motion.frames, np.arange(50))
    assert motion.source == "random, amplitude 0.3 rad rms, 50 frames, seed 4"
    assert motion.rms_rotation(c) == pytest.approx(0.3, rel=1e-6)
    # Every bone but the roots, not only on the mean.
    theta, root = local_rotations(c.C, c.BE, c.P, motion.B)
    rms = np.sqrt((theta**2).sum(axis=-1).mean(axis=0))
    np.testing.assert_allclose(rms, np.where(c.P < 0, 0, 0.3), atol=1e-6)
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
    only_roots = replace(c, P=np.full(3, -1), BE=np.array([[0, 1]] * 3))
    assert Motion(np.broadcast_to(np.eye(4), (2, 3, 4, 4)), np.arange(2), "still").rms_rotation(only_roots) is None


@pytest.mark.parametrize("d", [2, 3])
def test_transforms_from_a_file(d: int, characters, tmp_path: Path) -> None:
    c = characters[d]
    motion = random_motion(c, frames=4)
    write_transforms(tmp_path / "m.dmat", motion.B if d == 3 else in_space(motion.B))
    again = read_motion(tmp_path / "m.dmat", c)
    np.testing.assert_allclose(again.B, motion.B, atol=1e-12)
    np.testing.assert_array_equal(again.frames, np.arange(4))
    assert again.source == "m.dmat"


@pytest.mark.parametrize("d", [2, 3])
def test_local_rotations_from_a_file(d: int, characters, tmp_path: Path, rng: np.random.Generator) -> None:
    c = characters[d]
    theta = rng.uniform(-1, 1, (4, len(c.BE), 3 if d == 3 else 1))
    move = rng.normal(size=(4, d))
    write_motion_json(tmp_path / "m.json", c.names, theta, move)
    B = forward_kinematics(c.C, c.BE, c.P, theta, root_translation=move)
    np.testing.assert_allclose(read_motion(tmp_path / "m.json", c).B, B, atol=1e-9)


def test_motions_of_other_rigs_or_of_no_known_format_are_refused(characters, tmp_path: Path) -> None:
    flat, solid = characters[2], characters[3]
    write_transforms(tmp_path / "m.dmat", random_motion(solid, frames=2).B)
    with pytest.raises(FileFormatError, match=r"m\.dmat: moves 3 bones, but the rig has 13$"):
        read_motion(tmp_path / "m.dmat", flat)
    B = in_space(random_motion(flat, frames=3).B)
    B[2, 5, 0, 2] = 0.1
    write_transforms(tmp_path / "tilted.dmat", B)
    with pytest.raises(FileFormatError, match=r"frame 2 moves bone 5 out of the plane of a flat character$"):
        read_motion(tmp_path / "tilted.dmat", flat)
    for name, said in (("m.bvh", "not .bvh"), ("m", "without suffix")):
        with pytest.raises(FileFormatError, match=said):
            read_motion(tmp_path / name, flat)
    with pytest.raises(FileNotFoundError):
        read_motion(tmp_path / "none.json", flat)
