"""Where bodies on the page meet each other or themselves, and which points they contain."""

from typing import NamedTuple

import numpy as np

from nilbs.contacts.pairs import contacts
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.viewer.state import Body

# Points in the volume of a body that are followed, fewer than `nilbs check` does: the page answers while it moves.
SAMPLES = 10_000


class Places(NamedTuple):
    """Places where something meets.

    Attributes
    ----------
    point : (k, d) float array
    depth : (k,) float array
        In L of the first body.
    """

    point: np.ndarray
    depth: np.ndarray


class Meetings:
    """Contacts of each pair of bodies, and of each with itself.

    Parameters
    ----------
    bodies : sequence of Body
        A body whose field searches no roots has no contacts with itself.
    """

    def __init__(self, bodies: tuple[Body, ...]) -> None:
        self.bodies = bodies
        self._finders: dict[int, SelfContactFinder] = {}

    def pairs(self, poses: tuple[np.ndarray, ...]) -> dict[str, Places]:
        """Contacts of each two bodies, by "first and second"."""
        L, found = self.bodies[0].character.L, {}
        for j, b in enumerate(self.bodies):
            for i, a in enumerate(self.bodies[:j]):
                met = contacts(a.model, poses[i], b.model, poses[j])
                found[f"{a.name} and {b.name}"] = Places(met.point, met.depth / L)
        return found

    def themselves(self, poses: tuple[np.ndarray, ...]) -> dict[str, Places]:
        """Contacts of each body with itself.

        Raises
        ------
        ValueError
            If no root search answers for a body.
        """
        L, found = self.bodies[0].character.L, {}
        for i, body in enumerate(self.bodies):
            if i not in self._finders:
                self._finders[i] = SelfContactFinder(body.model, samples=SAMPLES)
            met = self._finders[i](poses[i])
            found[f"{body.name} and itself"] = Places(met.point, met.depth / L)
        return found


def inside(bodies: tuple[Body, ...], poses: tuple[np.ndarray, ...], x: np.ndarray, row: str) -> np.ndarray:
    """Whether points (n, d) are inside one of the bodies, (n,); bodies without that row answer by their own."""
    found = np.zeros(len(x), dtype=bool)
    for body, pose in zip(bodies, poses, strict=True):
        found |= body.posed(pose, body.row_like(row)).occupancy(x) > 0.5
    return found
