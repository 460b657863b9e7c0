"""glTF that Blender writes is read as Blender poses it, and Blender poses what nilbs writes as nilbs does.

The environment variable NILBS_BPY names a Python that imports Blender's package `bpy`: `make blender` sets it.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nilbs.geometry.kinematics import forward_kinematics
from nilbs.geometry.rotations import rotation_matrices
from nilbs.geometry.skeleton import skeleton_of_joints
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.io.bundle import Bundle, Clip, Influences, Mesh
from nilbs.io.gltf import read_gltf
from nilbs.io.gltf_writer import write_gltf
from nilbs.io.vdb import write_vdb

SCRIPT = Path(__file__).with_name("blender_characters.py")
NAMES = ["dancer", "stretcher", "rider"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def blender():
    """A function that runs the script with Blender."""
    python = os.environ.get("NILBS_BPY")
    if not python:
        pytest.skip("NILBS_BPY is not set: `make blender` installs Blender's package and runs these tests")

    def run(*arguments):
        done = subprocess.run([python, SCRIPT, *arguments], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    return run


@pytest.fixture(scope="module")
def exported(blender, tmp_path_factory):
    """The folder with what Blender wrote."""
    folder = tmp_path_factory.mktemp("blender")
    blender("make", folder)
    return folder


def compare(parts, truth, same=1e-4):
    """Largest distance from Blender's vertices in the world, at rest and in any frame, over the size."""
    size = np.ptp(truth["rest"], axis=0).max()
    # The order changes, and seams are split: the same vertex is where it is at rest.
    away, match = cKDTree(truth["rest"]).query(parts.mesh.V)
    assert away.max() < same * size
    assert len(np.unique(match)) == len(truth["rest"])
    (clip,) = parts.clips
    np.testing.assert_allclose(clip.times, truth["times"], atol=1e-6)
    W = parts.influences.dense(len(parts.mesh.V), len(parts.skeleton.names), "blender")
    U = np.array([linear_blend_skinning(parts.mesh.V, W, B) for B in clip.B])
    moves = np.abs(truth["posed"] - truth["rest"]).max()
    assert moves > 0.5 * size
    return np.abs(U - truth["posed"][:, match]).max() / size


@pytest.mark.parametrize("name", NAMES)
def test_what_blender_writes_moves_as_in_blender(exported, name):
    parts = read_gltf(exported / f"{name}.glb")
    assert {"hip", "spine", "head", "arm.L", "hand.L", "arm.R", "tail"} == set(parts.skeleton.names)
    assert not any("binding" in note for note in parts.notes)
    error = compare(parts, np.load(exported / f"{name}.npz"))
    print(f"{name}: {error:.1e} of the size")
    assert error < 1e-4


def made(stretch):
    """A character with branches and six influences a vertex; its bones are rigid, or stretch along their own axes."""
    rng = np.random.default_rng(3)
    P = np.array([-1, 0, 1, 1, 3, 0, 5, 1])
    C = np.zeros((8, 3))
    for bone in range(8):
        C[bone] = rng.normal(size=3) + (C[P[bone]] if P[bone] >= 0 else 0)
    skeleton = skeleton_of_joints(C, P, [f"bone {b}" for b in range(8)], ends={7: C[7] + [0, 0.5, 0.1]})
    V = C[rng.integers(0, 8, 150)] + 0.5 * rng.normal(size=(150, 3))
    E = np.concatenate([rng.permutation(150).reshape(-1, 3) for _ in range(4)])
    W = np.zeros((150, 8))
    for row in W:
        row[rng.choice(8, 6, replace=False)] = 0.1 + rng.random(6)
    W /= W.sum(axis=1, keepdims=True)
    BE = np.stack([np.arange(8)] * 2, axis=1)
    B = forward_kinematics(C, BE, P, 0.5 * rng.normal(size=(12, 8, 3)), root_translation=rng.normal(size=(12, 3)))
    if stretch:
        axes = rotation_matrices(rng.normal(size=(8, 3)))
        for frame in range(12):
            for bone in range(8):
                local = np.eye(4)
                along = np.diag(0.6 + 0.8 * rng.random(3))
                local[:3, :3] = rotation_matrices(0.5 * rng.normal(size=3)) @ axes[bone] @ along @ axes[bone].T
                local[:3, 3] = C[bone] - local[:3, :3] @ C[bone]
                B[frame, bone] = local if P[bone] < 0 else B[frame, P[bone]] @ local
    vertex, bone = np.nonzero(W)
    clip = Clip("move", skeleton, np.arange(12) / 24, B)
    return Bundle(Mesh(V, E), skeleton, Influences(vertex, bone, W[vertex, bone]), (clip,))


@pytest.mark.parametrize("stretch", [False, True], ids=["rigid", "stretched"])
def test_what_nilbs_writes_moves_the_same_in_blender(blender, tmp_path, stretch):
    parts = made(stretch)
    assert write_gltf(tmp_path / "made.glb", parts) == ()
    blender("open", tmp_path / "made.glb", tmp_path / "opened.npz")
    error = compare(parts, np.load(tmp_path / "opened.npz"))
    print(f"stretched {stretch}: {error:.1e} of the size")
    assert error < 1e-4


def test_openvdb_reads_the_volumes_that_nilbs_writes(blender, tmp_path, rng):
    values = np.where(rng.random((130, 9, 17)) < 0.3, rng.normal(size=(130, 9, 17)), 0).astype(np.float32)
    write_vdb(
        tmp_path / "a.vdb", values, origin=[1, 2, -3], spacing=0.25, name="a", background=0, metadata={"frame": 3}
    )
    blender("volume", tmp_path)
    with np.load(tmp_path / "volume.npz") as found:
        np.testing.assert_array_equal(found["values"], values)
        np.testing.assert_array_equal(found["first"], [1, 2, -3])
        np.testing.assert_array_equal(found["spacing"], [0.25] * 3)
        assert found["frame"] == 3
