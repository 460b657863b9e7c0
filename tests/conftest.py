"""Fixtures that all tests share: a seeded generator, small characters and models, and real data where there is any."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.models.model import Model


# Programs: run by Blender's own Python, and before the tests.
collect_ignore = ["io/blender_characters.py", "examples/blender_scene.py", "compile_engine.py"]


def pytest_configure(config: pytest.Config) -> None:
    """Before several workers begin, compile the engine: each would compile it for itself, at the same time."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        subprocess.run([sys.executable, str(Path(__file__).parent / "compile_engine.py")], check=True)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def curve_value() -> Callable[..., np.ndarray]:
    """One curve of one part at one time, as in appendix C of the glTF specification."""

    def value(curve, part: str, t: float) -> np.ndarray:
        times, values, interpolation = curve
        keys = values[:, 1] if interpolation == "cubicspline" else values
        if part == "rotation" and interpolation != "cubicspline":
            keys = keys / np.linalg.norm(keys, axis=1, keepdims=True)
        if t <= times[0]:
            found = keys[0]
        elif t >= times[-1]:
            found = keys[-1]
        else:
            k = max(k for k in range(len(times)) if times[k] <= t)
            h = times[k + 1] - times[k]
            s = (t - times[k]) / h
            if interpolation == "step":
                found = keys[k]
            elif interpolation == "cubicspline":
                found = (2 * s**3 - 3 * s**2 + 1) * keys[k] + h * (s**3 - 2 * s**2 + s) * values[k, 2]
                found = found + (-2 * s**3 + 3 * s**2) * keys[k + 1] + h * (s**3 - s**2) * values[k + 1, 0]
            elif part == "rotation":
                d = keys[k] @ keys[k + 1]
                a = np.arccos(abs(d))
                found = (np.sin(a * (1 - s)) * keys[k] + np.sign(d) * np.sin(a * s) * keys[k + 1]) / np.sin(a)
            else:
                found = (1 - s) * keys[k] + s * keys[k + 1]
        return found / np.linalg.norm(found) if part == "rotation" else found

    return value


@pytest.fixture
def coarse_volumes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights are solved quickly, in volumes of few elements."""
    for name, value in {
        "SPACING": 0.1,
        "ELEMENTS": 2000,
        "RESOLUTIONS": (32,),
        "DECIMATED": 2000,
        "BLOCKS": 24,
        "FLAT_SPACING": 0.04,
    }.items():
        monkeypatch.setattr(f"nilbs.geometry.domain.{name}", value)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real meshes and rigs; tests that need it skip where NILBS_DATA is not set."""
    folder = os.environ.get("NILBS_DATA")
    if not folder:
        pytest.skip("NILBS_DATA is not set: it names a folder of real meshes, see CONTRIBUTING.md")
    return Path(folder)


@pytest.fixture(scope="session")
def characters() -> "dict[int, Character]":
    """By dimension: the gingerbread man of the plane, and in space a capsule of three bones."""
    from nilbs.characters.character import assemble
    from nilbs.characters.gingerbread import gingerbread
    from nilbs.geometry.grids import Grid
    from nilbs.geometry.level_sets import isosurface
    from nilbs.geometry.skeleton import skeleton_of_bones

    grid = Grid.box(np.array([[-0.9, -0.3, -0.3], [0.9, 0.3, 0.3]]), 24)
    x = grid.points()
    axis = np.stack([np.clip(x[:, 0], -0.6, 0.6), np.zeros(len(x)), np.zeros(len(x))], axis=1)
    V, F = isosurface(np.linalg.norm(x - axis, axis=1) - 0.25, grid)
    C, BE = np.array([[-0.7, 0, 0], [-0.2, 0.02, 0], [0.2, 0, 0.03], [0.7, 0, 0]]), np.array([[0, 1], [1, 2], [2, 3]])
    V2, T2, C2, BE2 = gingerbread(2)
    flat = assemble(V2, T2, skeleton_of_bones(C2, BE2), name="gingerbread")
    return {2: flat, 3: assemble(V, F, skeleton_of_bones(C, BE), name="capsule")}


@pytest.fixture(scope="session")
def models(characters: "dict[int, Character]") -> "dict[int, Model]":
    """By dimension: a model after a few steps, enough to differ from an untrained one."""
    from nilbs.characters.motion import random_motion
    from nilbs.models.fitting import fit

    return {d: fit(c, random_motion(c, frames=6), device="cpu", steps=30, **SMALL) for d, c in characters.items()}


@pytest.fixture
def saved(models: "dict[int, Model]", tmp_path: Path) -> dict[int, Path]:
    """By dimension: the file of a model."""
    for d, model in models.items():
        model.save(tmp_path / f"{d}.nilbs")
    return {d: tmp_path / f"{d}.nilbs" for d in models}


@pytest.fixture
def rigid(rng: np.random.Generator) -> Callable[..., np.ndarray]:
    """A random rigid transform (d+1, d+1) of a dimension."""
    from nilbs.geometry.rotations import rigid_transforms, rotation_matrices

    def transform(d: int, *, far: float = 1.0) -> np.ndarray:
        return rigid_transforms(rotation_matrices(rng.normal(size=3 if d == 3 else 1)), far * rng.normal(size=d))

    return transform


@pytest.fixture
def queries(rng: np.random.Generator) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Points around a posed character, and the pose."""
    from nilbs.geometry.grids import Grid

    def drawn(model: "Model", n: int) -> tuple[np.ndarray, np.ndarray]:
        pose = model.motion[3]
        cube = Grid.cube(model.character.skin(pose), 1)
        return rng.uniform(cube.lower, cube.upper, (n, model.character.d)), pose

    return drawn


SMALL = {
    "width": 16,
    "depth": 3,
    "poses_per_step": 4,
    "points_per_pose": 128,
    "samples_per_frame": 500,
    "cache_resolution": 32,
    "weight_resolution": 32,
}
