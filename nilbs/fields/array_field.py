"""Fields with nothing to learn: geometry on arrays behind the interface of every field."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from nilbs.engine.answer import Answer
from nilbs.fields.field import Field, PosedField

# Posed points (n, d) -> their signed distances (n,) and canonical points (n, d), nan if the method has none.
ArrayAnswers = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# In units of the body's longest edge: the step by which occupancy is read from distance.
WIDTH = 0.003


class ArrayField(Field):
    """A field that computes in double precision on arrays, whatever the precision of the query.

    Answers have the type and the device that the module was moved to; nothing is differentiable.

    Parameters
    ----------
    in_pose : function of (b, d+1, d+1) array
        The method in a pose.
    canonical_points : bool
        Whether its answers have them.
    """

    has_distance = True
    like: Tensor  # empty: the type and the device of answers

    def __init__(self, in_pose: Callable[[np.ndarray], ArrayAnswers], *, canonical_points: bool = True) -> None:
        super().__init__()
        self.in_pose, self.has_canonical_points = in_pose, canonical_points
        self.register_buffer("like", torch.zeros(0, dtype=torch.float64), persistent=False)

    def posed(self, B: Tensor) -> PosedField:
        """The field in a pose, (b, d+1, d+1) rest to posed."""
        answers = self.in_pose(_array(B))

        def answer(x: Tensor) -> Answer:
            distance, x_rest = (torch.as_tensor(found).to(self.like) for found in answers(_array(x)))
            return Answer(distance, distance, x_rest, WIDTH)

        return answer


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()
