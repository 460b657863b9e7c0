"""What every field answers, whatever its method."""

from typing import NamedTuple

import torch
from torch import Tensor


class Answer(NamedTuple):
    """What a field says of posed points.

    Attributes
    ----------
    logit : (n,) tensor
        Of occupancy: positive inside, and smooth where occupancy itself has saturated.
    distance : (n,) tensor
        Signed distance at rest, negative inside; nan by a method that knows of no distance.
    x_rest : (n, d) tensor
        Rest images; nan by a method that has none.
    """

    logit: Tensor
    distance: Tensor
    x_rest: Tensor

    @classmethod
    def of_logit(cls, logit: Tensor, d: int) -> "Answer":
        """What a method says that knows occupancy alone."""
        return cls(logit, torch.full_like(logit, torch.nan), torch.full_like(logit, torch.nan)[..., None].expand(-1, d))
