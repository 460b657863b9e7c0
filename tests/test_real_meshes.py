"""Real meshes, rigs, weights and a motion; NILBS_DATA names their folder."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import nilbs
from nilbs.characters.bundle import fit_together, read_files
from nilbs.geometry.copyleft.decimation import decimated
from nilbs.geometry.domain import volume_domain
from nilbs.geometry.facets import components, is_watertight
from nilbs.geometry.handles import bone_conditions, bone_points, distinct_points
from nilbs.geometry.interpolation import surface_interpolation
from nilbs.geometry.kinematics import forward_kinematics, local_rotations
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.weight_transfer import transfer_weights
from nilbs.geometry.weights import biharmonic_energy, bounded_biharmonic_weights
from nilbs.io import read_transforms, read_weights


@pytest.fixture(scope="module")
def arm(data: Path) -> nilbs.Character:
    return nilbs.load_character(data / "arm" / "arm.obj", data / "arm" / "arm.tgf")


@pytest.fixture(scope="module")
def elephant(data: Path) -> nilbs.Character:
    """The elephant with the weights that came with it."""
    return nilbs.load_character(*(data / "elephant" / f"elephant{end}" for end in (".obj", ".tgf", "-weights.dmat")))


def assert_on_the_simplex(W: np.ndarray) -> None:
    assert W.min() >= 0
    assert W.max() <= 1
    assert np.abs(W.sum(axis=1) - 1).max() <= 1e-9


def enclosed_volume(V: np.ndarray, F: np.ndarray) -> float:
    return np.linalg.det(V[F]).sum() / 6


def test_the_arm_is_filled_and_its_weights_are_those_of_the_authors(arm: nilbs.Character, data: Path) -> None:
    assert (arm.d, arm.V.shape, arm.F.shape, arm.skeleton.BE.shape) == (3, (8311, 3), (16618, 3), (4, 2))
    assert is_watertight(arm.F)
    volumes = element_volumes(arm.V_volume, arm.T)
    assert volumes.min() > 0
    # Its few bones are solved for inside a surface of fewer triangles, of the same shape.
    assert volumes.sum() == pytest.approx(enclosed_volume(arm.V, arm.F), rel=5e-3)
    assert_on_the_simplex(arm.W_volume)
    theirs = read_weights(data / "arm" / "arm-weights.dmat")
    assert np.abs(arm.W - theirs).mean() <= 0.012
    # Every bone has its own column: with two of them exchanged the weights would be far off.
    for order in ([1, 0, 2, 3], [0, 2, 1, 3], [0, 1, 3, 2]):
        assert np.abs(arm.W[:, order] - theirs).mean() > 0.05


def test_the_elephant_with_weights_that_came_with_it(elephant: nilbs.Character, data: Path) -> None:
    assert (elephant.d, elephant.V.shape, elephant.F.shape) == (3, (6034, 3), (12064, 3))
    assert len(elephant.skeleton.BE) == len(elephant.skeleton.names) == 24
    assert abs(elephant.L - 127.726) < 1e-3
    assert is_watertight(elephant.F)
    assert components(elephant.F, len(elephant.V)) == 1
    assert_on_the_simplex(elephant.W_volume)
    np.testing.assert_allclose(elephant.W, read_weights(data / "elephant" / "elephant-weights.dmat"), atol=1e-6)
    # The volume mesh holds the same body, from the same vertices.
    assert element_volumes(elephant.V_volume, elephant.T).sum() == pytest.approx(
        enclosed_volume(elephant.V, elephant.F), rel=1e-9
    )
    outside = boundary_facets(elephant.T)
    assert enclosed_volume(elephant.V_volume, outside) == pytest.approx(enclosed_volume(elephant.V, elephant.F))


def test_the_elephant_s_own_motion(elephant: nilbs.Character, data: Path) -> None:
    path, c = data / "elephant" / "elephant-anim.dmat", elephant
    motion = nilbs.load_motion(path, c)
    assert motion.B.shape == (457, 24, 4, 4)
    np.testing.assert_array_equal(motion.B, read_transforms(path))
    np.testing.assert_array_equal(motion[0], np.broadcast_to(np.eye(4), (24, 4, 4)))
    np.testing.assert_allclose(linear_blend_skinning(c.V, c.W, motion[0]), c.V, atol=1e-12 * c.L)
    theta, root_translation = local_rotations(c.skeleton.C, c.skeleton.BE, c.skeleton.P, motion.B)
    recomposed = forward_kinematics(c.skeleton.C, c.skeleton.BE, c.skeleton.P, theta, root_translation=root_translation)
    assert np.abs(recomposed - motion.B).max() <= 1e-9
    # The bones do turn.
    assert motion.rms_rotation(c) == pytest.approx(0.61, abs=0.005)
    assert np.linalg.norm(theta[:, c.skeleton.P >= 0], axis=-1).max() == pytest.approx(2.26, abs=0.005)
    # Bones that share a joint keep it together.
    child = np.flatnonzero(c.skeleton.P >= 0)
    joint = np.append(c.skeleton.C[c.skeleton.BE[child, 0]], np.ones((len(child), 1)), axis=1)[:, :, None]
    np.testing.assert_allclose(motion.B[:, child] @ joint, motion.B[:, c.skeleton.P[child]] @ joint, atol=1e-9 * c.L)


@pytest.fixture(scope="module")
def person(data: Path) -> Callable[[str], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Vertices, triangles and weights of a group of MakeHuman's mesh."""
    files = read_files([data / "makehuman" / name for name in ("base.obj", "default.mhskel", "default_weights.mhw")])

    def group(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        bundle = fit_together(files, group=name)
        return bundle.mesh.V, bundle.mesh.E, bundle.influences.dense(*bundle.influences.shape, name)

    return group


def wrong_parts(W: np.ndarray, W_true: np.ndarray) -> np.ndarray:
    """For each row the part of the weights that is on wrong bones: 0 if equal, 1 if no bone is the same."""
    return np.abs(W - W_true).sum(axis=1) / 2


def nearest_rows(V: np.ndarray, V_source: np.ndarray, W_source: np.ndarray) -> np.ndarray:
    return W_source[cKDTree(V_source).query(V)[1]]


def remeshed(V: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of equal size, about as many as before."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V, F))
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PercentageValue(0.6), iterations=3, checksurfdist=False
    )
    return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()


@pytest.mark.parametrize("other_mesh", [remeshed, partial(decimated, facets=4000)])
def test_a_remesh_takes_the_weights_of_the_person(person: Callable, other_mesh: Callable) -> None:
    V_source, E_source, W_source = person("body")
    V, E = other_mesh(V_source, E_source)
    found = transfer_weights(V, E, V_source, E_source, W_source)
    assert_on_the_simplex(found.W)
    W_true = surface_interpolation(V_source, E_source, W_source, V)
    wrong = wrong_parts(found.W, W_true)
    assert wrong.mean() <= 0.03
    assert np.percentile(wrong, 95) <= 0.15
    assert wrong.mean() < wrong_parts(nearest_rows(V, V_source, W_source), W_true).mean()


# The skirt's weights are painted by hand: where it lies on the body, the closest points' are wrong by 0.10 already.
@pytest.mark.parametrize(("cloth", "most", "of_nearest"), [("helper-tights", 0.05, 0.8), ("helper-skirt", 0.15, 0.75)])
def test_clothes_take_the_weights_of_the_person(person: Callable, cloth: str, most: float, of_nearest: float) -> None:
    V_source, E_source, W_source = person("body")
    V, E, W_true = person(cloth)
    found = transfer_weights(V, E, V_source, E_source, W_source)
    assert_on_the_simplex(found.W)
    assert (found.accepted | found.filled).all()
    mean = wrong_parts(found.W, W_true).mean()
    assert mean <= most
    assert mean <= of_nearest * wrong_parts(nearest_rows(V, V_source, W_source), W_true).mean()


# Energy of libigl's weights in the test below, clipped and divided by their sums. It takes minutes:
# W = bounded_biharmonic_weights(V, T, known.fixed, known.W_fixed, method="igl"); biharmonic_energy(V, T, W)
IGL_ENERGY = 185.410


@pytest.mark.slow
def test_the_elephant_s_weights_have_less_energy_than_those_of_libigl(elephant: nilbs.Character) -> None:
    x, bone = bone_points(elephant.skeleton, spacing=0.01 * elephant.L)
    domain = volume_domain(elephant.V, elephant.F, x[distinct_points(x, 1e-3 * elephant.L)])
    V, T, near = domain.V, domain.T, 0.01 * elephant.L
    known = bone_conditions(V, np.unique(T), x, bone, np.ones(len(x), dtype=bool), bones=24, snap=near, reach=near)
    assert (len(V), len(T)) == (11765, 53463)  # the energy is of this volume
    W = bounded_biharmonic_weights(V, T, known.fixed, known.W_fixed)
    assert_on_the_simplex(W)
    assert 0 < biharmonic_energy(V, T, W) <= IGL_ENERGY


@pytest.mark.slow
def test_a_short_training_reconstructs_the_arm(arm: nilbs.Character) -> None:
    motion = nilbs.random_motion(arm, frames=10)
    model = nilbs.fit(
        arm, motion, device="cpu", steps=400, width=48, points_per_pose=32, samples_per_frame=4000, cache_resolution=64
    )
    scores = nilbs.evaluate(model, points=4000, resolution=32, poses=("seen", "unseen")).values["poses"]
    for name in ("seen", "unseen"):
        assert scores[name]["iou_bbox"]["mean"] > 0.95
        assert scores[name]["iou_surface"]["mean"] > 0.8
        assert scores[name]["chamfer_l1"]["mean"] < 1
        assert scores[name]["normal_consistency"]["mean"] > 0.85
        assert scores[name]["watertight"]["mean"] == 1
