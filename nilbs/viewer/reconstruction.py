"""The surface of a field, with its distance to the truth."""

from typing import NamedTuple

import numpy as np

from nilbs.geometry.grids import Grid
from nilbs.models.posed_model import PosedModel


class Reconstruction(NamedTuple):
    """A field's surface in a pose.

    Attributes
    ----------
    U, F : (n, d) float and (m, d) int arrays
        Vertices, in mesh units, and facets.
    error : (n,) float array
        Distance of the vertices to the posed skin, in L.
    """

    U: np.ndarray
    F: np.ndarray
    error: np.ndarray


def reconstruction(posed: PosedModel, resolution: int) -> Reconstruction:
    """The surface of a field on a grid of so many cells along each edge, as `Model.extract` finds it."""
    U, F = posed.extract_on(Grid.cube(posed.U, resolution))
    error = posed.closest_points(U).distance / posed.character.L if len(U) else np.zeros(0)
    return Reconstruction(U, F, error)
