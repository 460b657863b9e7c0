"""What every test may ask for: a seeded generator and the shared data, where there is any."""

import os
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real meshes and rigs; tests that need it skip where NILBS_DATA is not set."""
    folder = os.environ.get("NILBS_DATA")
    if not folder:
        pytest.skip("NILBS_DATA is not set: it names a folder of real meshes, see CONTRIBUTING.md")
    return Path(folder)
