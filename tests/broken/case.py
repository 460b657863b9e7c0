"""One broken character, and the list of all kinds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nilbs.geometry.skeleton import Skeleton

from .bodies import Mesh


@dataclass(frozen=True)
class Case:
    """A character as a user might bring it.

    Attributes
    ----------
    V, F : (n, d) and (m, 3) array
        Its mesh: a surface in space, triangles that fill the figure in the plane.
    skeleton : Skeleton
    solid : Mesh or None
        The same body intact, by which places are inside; None where the mesh itself is closed, or nothing is inside.
    """

    V: np.ndarray
    F: np.ndarray
    skeleton: Skeleton
    solid: Mesh | None = None


@dataclass(frozen=True)
class Kind:
    """One way to be broken.

    Attributes
    ----------
    name : str
    make : function of a random generator to Case
    is_broken : function of Case to bool
        Whether the case has the defect of its name.
    outcome : "weights", "error" or "either"
        What must come of it.
    error : str
        A pattern that the error's message matches.
    """

    name: str
    make: Callable[[np.random.Generator], Case]
    is_broken: Callable[[Case], bool]
    outcome: str
    error: str

    def case(self, seed: int = 0) -> Case:
        return self.make(np.random.default_rng([seed, *self.name.encode()]))


KINDS: dict[str, Kind] = {}


def kind(
    is_broken: Callable[[Case], bool], *, outcome: str = "weights", error: str = "", name: str = ""
) -> Callable[[Callable[[np.random.Generator], Case]], Callable[[np.random.Generator], Case]]:
    """Enter a function into the list of kinds, under its own name."""

    def enter(make: Callable[[np.random.Generator], Case]) -> Callable[[np.random.Generator], Case]:
        called = name or make.__name__
        assert called not in KINDS
        KINDS[called] = Kind(called, make, is_broken, outcome, error)
        return make

    return enter
