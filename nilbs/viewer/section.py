"""A plane that cuts the posed world: the values of a field in it, as a picture."""

from typing import NamedTuple

import numpy as np

from nilbs.figures.views import Section, View
from nilbs.models.posed_model import PosedModel
from nilbs.viewer.colours import DISTANCE, GHOST, OCCUPANCY, Scale
from nilbs.viewer.state import PageFrame

# What can be shown, and its colours.
QUANTITIES = {"occupancy": OCCUPANCY, "distance": DISTANCE, "ghost bone": GHOST}


class Cut(NamedTuple):
    """Values in a plane.

    Attributes
    ----------
    section : Section
        Where its pixels are, in the world.
    values : (pixels, pixels) float array
        Bottom row first; distances in units of L.
    """

    section: Section
    values: np.ndarray

    def picture(self, scale: Scale) -> np.ndarray:
        """Its colours (pixels, pixels, 3), from 0 to 255, top row first."""
        return scale(self.values)[::-1]


def plane(frame: PageFrame, axis: int, height: float, *, edge: float, pixels: int) -> Section:
    """The square across an axis of the world at a height on the page, `edge` wide there; in 2D the plane itself."""
    d = len(frame.center)
    if d == 2:
        return Section(View(np.eye(2)), frame.center, edge * frame.L, pixels)
    toward = np.eye(3)[axis]
    up = np.eye(3)[1 if axis != 1 else 2]
    centre = frame.center + height * frame.L * toward
    return Section(View(np.array([np.cross(up, toward), up, toward])), centre, edge * frame.L, pixels)


def cut(posed: PosedModel, section: Section, quantity: str) -> Cut:
    """A field's values in a plane.

    Raises
    ------
    ValueError
        If the field has no such values.
    """
    x = section.points()
    if quantity == "occupancy":
        values = posed.occupancy(x)
    elif quantity == "distance":
        values = posed.distance(x) / posed.character.L
    else:
        values = posed.weights(x)[:, -1]
    return Cut(section, section.image(np.asarray(values, dtype=np.float64)))
