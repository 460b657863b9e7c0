"""Engines on arrays behind the interface of every field."""

import numpy as np
import torch
from torch import Tensor

from nilbs.engine.answer import Answer
from nilbs.engine.array_engine import ArrayEngine
from nilbs.fields.field import Field, PosedField


class ArrayField(Field):
    """A field that computes in double precision on arrays, whatever the precision of the query.

    Answers have the type and the device that the module was moved to; nothing is differentiable.
    """

    like: Tensor  # empty: the type and the device of answers

    def __init__(self, engine: ArrayEngine) -> None:
        super().__init__()
        self.engine = engine
        self.has_distance, self.has_canonical_points = engine.has_distance, engine.has_canonical_points
        self.register_buffer("like", torch.zeros(0, dtype=torch.float64), persistent=False)

    def posed(self, B: Tensor) -> PosedField:
        """The field in a pose, (b, d+1, d+1) rest to posed."""
        d = B.shape[-1] - 1
        posed, stay = self.engine(_array(B)), np.eye(d, d + 1)

        def answer(x: Tensor) -> Answer[Tensor]:
            found = posed(_array(x), stay)
            distance, x_rest = (torch.as_tensor(array).to(self.like) for array in (found.distance, found.x_rest))
            return Answer(distance, distance, x_rest, found.width)

        return answer


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()
