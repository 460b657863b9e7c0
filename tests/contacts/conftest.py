"""Bodies with closed forms, and models of them without a network."""

from collections.abc import Callable

import numpy as np
import pytest

from nilbs.characters.capsule import capsule
from nilbs.characters.motion import random_motion
from nilbs.geometry.kinematics import forward_kinematics
from nilbs.models.fitting import fit
from nilbs.models.model import Model

RADIUS, LENGTH = 0.2, 1.0
BONES = 8  # of a chain


@pytest.fixture(scope="session")
def capsules() -> dict[int, Model]:
    """By dimension: a capsule of two bones along y."""
    found = {}
    for d in (2, 3):
        c = capsule(length=LENGTH, radius=RADIUS, resolution=64, d=d)
        found[d] = fit(c, random_motion(c, frames=2), steps=0, device="cpu")
    return found


@pytest.fixture
def moved() -> Callable[..., np.ndarray]:
    """The rest pose of a capsule, moved as a whole."""

    def pose(d: int, x: float = 0.0, y: float = 0.0, *, bones: int = 2) -> np.ndarray:
        B = np.tile(np.eye(d + 1), (bones, 1, 1))
        B[:, 0, d], B[:, 1, d] = x, y
        return B

    return pose


@pytest.fixture(scope="session")
def capsule_distance() -> Callable[[np.ndarray], np.ndarray]:
    """Signed distance of the capsule at rest, negative inside."""

    def distance(x: np.ndarray) -> np.ndarray:
        axis = np.zeros_like(x)
        axis[:, 1] = np.clip(x[:, 1], RADIUS - LENGTH / 2, LENGTH / 2 - RADIUS)
        return np.linalg.norm(x - axis, axis=1) - RADIUS

    return distance


@pytest.fixture(scope="session")
def chains() -> dict[int, Model]:
    """By dimension: a long capsule of eight bones."""
    found = {}
    for d in (2, 3):
        c = capsule(bones=BONES, length=2.0, radius=0.09, resolution=24, d=d)
        found[d] = fit(c, random_motion(c, frames=2), steps=0, device="cpu")
    return found


@pytest.fixture(scope="session")
def rolled() -> Callable[..., np.ndarray]:
    """A pose of a chain: every bone turned against the one before, about z, by so many degrees."""

    def pose(model: Model, degrees: float) -> np.ndarray:
        d, s = model.character.d, model.character.skeleton
        theta = np.zeros((BONES, 1 if d == 2 else 3))
        theta[1:, -1] = np.radians(degrees)
        return forward_kinematics(s.C, s.BE, s.P, theta)

    return pose
