"""What a training minimises: a sum of losses, each on the batch that a step's own generator draws."""

from collections.abc import Callable

import numpy as np
from torch import Tensor

from nilbs.fields.occupancy_term import OccupancyTerm

# A loss on a batch that the generator draws.
Term = Callable[[np.random.Generator], Tensor]
# Steps between two refreshes of the errors at labelled points.
REFRESH = 500


class Objective:
    """Sum of losses at a training step; a step's batch depends on the seed and on the step alone.

    The occupancy loss may refresh the field's errors on its points every `REFRESH` steps. Between two, the loss
    depends on the last one, so that a training may be continued at multiples of `memory` steps only.
    """

    def __init__(self, occupancy: OccupancyTerm | None, *others: Term, seed: int) -> None:
        self.occupancy, self.seed = occupancy, seed
        self.memory = REFRESH if occupancy is not None and occupancy.adaptive else 1
        self.terms: list[Term] = [*([] if occupancy is None else [occupancy]), *others]
        if not self.terms:
            raise ValueError("every loss is off: there is nothing to train for")

    def __call__(self, step: int) -> Tensor:
        """Sum of the losses on the batch of a step."""
        if self.occupancy is not None and step % REFRESH == 0:
            self.occupancy.refresh(step // REFRESH)
        rng = np.random.default_rng([self.seed, step])
        first, *others = (term(rng) for term in self.terms)
        return sum(others, first)
