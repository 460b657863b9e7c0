"""What every field returns at posed points, whatever its method."""

from collections.abc import Callable
from typing import Generic, NamedTuple, Self, TypeVar

import numpy as np

# A numpy array or a torch tensor.
Array = TypeVar("Array")


class Answer(NamedTuple, Generic[Array]):
    """Values of a field at posed points.

    Attributes
    ----------
    level : (n,) array or tensor
        Negative inside and zero on the surface, smooth where occupancy has saturated; a length where the method has
        distances.
    distance : (n,) array or tensor
        Signed distance at the canonical point, negative inside; nan if the method has none.
    x_rest : (n, d) array or tensor
        Canonical points; nan if the method has none.
    width : float
        Occupancy is sigmoid(-level / width).
    """

    level: Array
    distance: Array
    x_rest: Array
    width: float = 1.0

    @property
    def occupancy(self) -> Array:
        """Occupancy (n,): 0 outside, 1 inside, one half on the surface."""
        half = self.level / (-2 * self.width)  # type: ignore[operator]
        # sigmoid(z) = (1 + tanh(z / 2)) / 2, which overflows nowhere.
        return (1 + (np.tanh(half) if isinstance(half, np.ndarray) else half.tanh())) / 2  # type: ignore[no-any-return]

    def in_mesh_units(self, L: float, center: Array) -> Self:
        """The same with lengths multiplied by L, and canonical points moved by the centre as well."""
        level, distance, x_rest, width = self
        return self._replace(level=level * L, distance=distance * L, x_rest=x_rest * L + center, width=width * L)  # type: ignore[operator]


# In one pose: posed points (n, d) and the transform (d, d+1) that moves them into the unit frame -> their answers.
PosedEngine = Callable[[np.ndarray, np.ndarray], Answer[np.ndarray]]
# A method of a character in arrays: a pose (b, d+1, d+1) of the unit frame -> the method in it.
Engine = Callable[[np.ndarray], PosedEngine]
