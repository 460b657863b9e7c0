"""Weights of a damaged mesh are nearly those of the mesh before, and neither unit nor place changes them."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from nilbs.geometry.copyleft.tetrahedra import conforming_tetrahedra
from nilbs.geometry.rig_weights import solve_weights
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.triangles import conforming_triangles
from nilbs.geometry.weights import bounded_biharmonic_weights
from nilbs.io.mesh import read_mesh
from nilbs.io.tgf import read_tgf

from .bodies import Mesh, person, person_skeleton, plate, plate_spine, skeleton
from .damage import with_flips, with_holes, with_two_shells
from .defects import boundary_edges, holes, misoriented_edges, pieces


def real(data: Path, name: str) -> tuple[Mesh, Skeleton]:
    return read_mesh(data / name / f"{name}.obj"), skeleton(*read_tgf(data / name / f"{name}.tgf")[:2])


def damaged(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Three holes, a facet in twenty flipped, an open tube and a ball through the surface; vertices stay in front."""
    holed = with_holes(mesh, rng, 3, 0.025)
    assert holes(holed[1]) >= 3
    assert boundary_edges(holed[1]) >= 15
    return with_two_shells(with_flips(holed, rng, 0.05), rng)


def difference(W: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Half the sum over bones of what weights differ by: 0 where they agree, 1 where they share no bone."""
    return 0.5 * np.abs(W - other).sum(axis=1)


@lru_cache
def reference(data: Path, name: str, damage: bool) -> tuple[Mesh, Skeleton, np.ndarray]:
    """A real mesh, damaged or not, its bones and its weights in a coarse volume."""
    mesh, bones = real(data, name)
    if damage:
        mesh = damaged(mesh, np.random.default_rng(0))
    return mesh, bones, solve_weights(*mesh, bones).W


@pytest.mark.slow
def test_damage_changes_weights_little(data: Path) -> None:
    (V, F), bones = real(data, "arm")
    W = solve_weights(V, F, bones).W
    for seed in (0, 1):
        V_damaged, F_damaged = damaged((V, F), np.random.default_rng(seed))
        assert pieces(F_damaged) >= 3
        assert misoriented_edges(F_damaged) > 0.05 * len(F)
        change = difference(solve_weights(V_damaged, F_damaged, bones).W[: len(V)], W)
        assert change.mean() <= 0.05
        assert np.quantile(change, 0.95) <= 0.2


PLACES = [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e5)]  # scale, and offset in sizes


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "offset"), PLACES)
def test_on_one_volume_mesh_neither_unit_nor_place_changes_weights(d: int, scale: float, offset: float) -> None:
    mesh, bones = (plate(10), plate_spine()) if d == 2 else (person(20), person_skeleton())
    x = bones.C[bones.BE]
    points = np.concatenate([x[:, 0], x[:, 1], x.mean(axis=1)])
    fill = conforming_triangles if d == 2 else conforming_tetrahedra
    V, T = fill(*mesh, np.unique(points, axis=0))
    distance = np.linalg.norm(V[:, None] - points, axis=2)
    fixed = np.flatnonzero(distance.min(axis=1) < 1e-9)
    W_fixed = np.eye(len(x))[distance[fixed].argmin(axis=1) % len(x)]
    W = bounded_biharmonic_weights(V, T, fixed, W_fixed)
    assert W[np.setdiff1d(np.arange(len(V)), fixed)].std() > 0.1
    moved = scale * (V + offset * np.linalg.norm(np.ptp(V, axis=0)))
    np.testing.assert_allclose(bounded_biharmonic_weights(moved, T, fixed, W_fixed), W, atol=1e-6)


@lru_cache
def whole(d: int) -> tuple[Mesh, Skeleton, np.ndarray]:
    """A clean body, its bones and its weights."""
    mesh, bones = (plate(10), plate_spine()) if d == 2 else (person(20), person_skeleton())
    return mesh, bones, solve_weights(*mesh, bones).W


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("scale", "offset"), PLACES)
def test_from_end_to_end_neither_unit_nor_place_changes_weights(d: int, scale: float, offset: float) -> None:
    (V, F), bones, W = whole(d)
    shift = offset * np.linalg.norm(np.ptp(V, axis=0))
    moved = solve_weights(scale * (V + shift), F, skeleton(scale * (bones.C + shift), bones.BE, bones.P)).W
    assert difference(moved, W).mean() <= 0.02


@pytest.mark.usefixtures("coarse_volumes")
@pytest.mark.parametrize(("damage", "scale", "offset"), [(False, 1e-4, 1e5), (True, 1e-4, 0.0), (True, 1.0, 1e5)])
@pytest.mark.parametrize("name", ["elephant", "arm"])
def test_real_meshes_in_another_unit_and_place(
    data: Path, name: str, damage: bool, scale: float, offset: float
) -> None:
    (V, F), bones, W = reference(data, name, damage)
    shift = offset * np.linalg.norm(np.ptp(V, axis=0))
    moved = solve_weights(scale * (V + shift), F, skeleton(scale * (bones.C + shift), bones.BE, bones.P)).W
    assert difference(moved, W).mean() <= 0.02
