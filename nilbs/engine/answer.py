"""What every field returns at posed points, whatever its method."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Self, TypeVar

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
        level: Any = self.level
        half: Any = level / (-2 * self.width)
        # sigmoid(z) = (1 + tanh(z / 2)) / 2, which overflows nowhere.
        ramp: Any = np.tanh(half) if isinstance(half, np.ndarray) else half.tanh()
        return (1 + ramp) / 2

    def in_mesh_units(self, L: float, center: Array) -> Self:
        """The same with lengths multiplied by L, and canonical points moved by the centre as well."""
        lengths: Any = self[:3]
        level, distance, x_rest = (array * L for array in lengths)
        return self._replace(level=level, distance=distance, x_rest=x_rest + center, width=self.width * L)


# In one pose: posed points (n, d) and the transform (d, d+1) that moves them into the unit frame -> their answers.
PosedEngine = Callable[[np.ndarray, np.ndarray], Answer[np.ndarray]]
# A method of a character in arrays: a pose (b, d+1, d+1) of the unit frame -> the method in it.
Engine = Callable[[np.ndarray], PosedEngine]
