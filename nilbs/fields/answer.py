"""What every field returns at posed points, whatever its method."""

from typing import NamedTuple, Self

import torch
from torch import Tensor


class Answer(NamedTuple):
    """Values of a field at posed points.

    Attributes
    ----------
    level : (n,) tensor
        Negative inside and zero on the surface, smooth where occupancy has saturated; a length where the method has
        distances.
    distance : (n,) tensor
        Signed distance at the canonical point, negative inside; nan if the method has none.
    x_rest : (n, d) tensor
        Canonical points; nan if the method has none.
    width : float
        Occupancy is sigmoid(-level / width).
    """

    level: Tensor
    distance: Tensor
    x_rest: Tensor
    width: float = 1.0

    @classmethod
    def of_logit(cls, logit: Tensor, d: int) -> Self:
        """The answer of a method that has occupancy alone."""
        nan = torch.full_like(logit, torch.nan)
        return cls(-logit, nan, nan[..., None].expand(-1, d))

    @property
    def occupancy(self) -> Tensor:
        """Occupancy (n,): 0 outside, 1 inside, one half on the surface."""
        return torch.sigmoid(-self.level / self.width)

    def in_mesh_units(self, L: float, center: Tensor) -> Self:
        """The same with lengths multiplied by L, and canonical points moved by the centre as well."""
        return self._replace(
            level=self.level * L, distance=self.distance * L, x_rest=self.x_rest * L + center, width=self.width * L
        )
