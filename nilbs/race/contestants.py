"""What takes part: ways to evaluate a posed character, ours and those of other libraries."""

import importlib.metadata
import importlib.util
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from nilbs.models.model import Model

OCCUPANCY, DISTANCE = "occupancy", "distance"
# Seconds that importing a library may take.
_PATIENCE = 180


class Contestant(Protocol):
    """A way to evaluate a character; made once, posed and queried any number of times.

    What `points` does is not timed. What `pose` and `query` do is. One that takes the poses of a stream in one call has
    `together` too, a function of poses (p, b, 4, 4) and points (p, n, 3).
    """

    def points(self, x: np.ndarray) -> Any:
        """Posed points (n, 3) of float64 as the library takes them."""

    def pose(self, B: np.ndarray) -> None:
        """Skin, and build or refit what queries need."""

    def query(self, x: Any) -> np.ndarray:
        """Whether each point is inside (n,), or its signed distance (n,) in mesh units, negative inside."""


@dataclass(frozen=True)
class Kind:
    """A contestant before it is made.

    Attributes
    ----------
    name : str
        What tables call it.
    answers : tuple of str
        `OCCUPANCY`, `DISTANCE` or both.
    make : function of a model, a quantity and a number of threads
    package, distribution : str
        What is imported, and its name on the package index; empty for ours.
    note : str
        What a reader should know of it.
    streams : bool
        Whether it takes part in streams of poses only.
    """

    name: str
    answers: tuple[str, ...]
    make: Callable[[Model, str, int], Contestant]
    package: str = ""
    distribution: str = ""
    note: str = ""
    streams: bool = False


def all_kinds() -> dict[str, Kind]:
    """Every contestant by name, ours first."""
    from nilbs.race import ours, peers

    return {kind.name: kind for kind in (*ours.KINDS, *peers.KINDS)}


def missing(kind: Kind, model: Model) -> str | None:
    """Why a contestant cannot take part, in one line; None if it can.

    Its library is imported in another process, so that a crash there is an answer.
    """
    from nilbs.race import ours

    if not kind.package:
        return ours.missing(kind, model)
    if importlib.util.find_spec(kind.package) is None:
        return f"not installed: pip install {kind.distribution}"
    return import_problem(kind.package)


def import_problem(package: str) -> str | None:
    """Why a package cannot be imported, in one line; None if it can."""
    if package == "warp":
        code = "import warp; warp.config.quiet = True; warp.init(); assert warp.is_cuda_available(), 'there is no GPU'"
    else:
        code = f"import {package}"
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        return f"importing {package} takes more than {_PATIENCE} s"
    if done.returncode < 0:
        return f"importing {package} crashes with signal {-done.returncode}"
    lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return None if done.returncode == 0 else f"{package} cannot be imported: {lines[-1]}"


def version(kind: Kind) -> str:
    """Version of a contestant's library, by the distribution that holds it; of this package for ours."""
    package = kind.package or "nilbs"
    found = importlib.metadata.packages_distributions().get(package, [])
    return importlib.metadata.version(found[0]) if found else "unknown"
