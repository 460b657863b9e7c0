"""What every field answers, whatever its method."""

from typing import NamedTuple

from torch import Tensor


class Answer(NamedTuple):
    """What a field says of posed points.

    Attributes
    ----------
    logit : (n,) tensor
        Of occupancy: positive inside, and smooth where occupancy itself has saturated.
    distance : (n,) tensor
        Signed distance at rest, negative inside.
    x_rest : (n, d) tensor
        Rest images.
    """

    logit: Tensor
    distance: Tensor
    x_rest: Tensor
