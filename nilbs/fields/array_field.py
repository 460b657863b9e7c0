"""Fields with nothing to learn: geometry on arrays, asked as every field is asked."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from nilbs.fields.answer import Answer
from nilbs.fields.field import Field, PosedField

# Posed points (n, d) -> their signed distances (n,) and rest images (n, d), nan by a method that has none.
ArrayAnswers = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# In units of the body's longest edge: the step by which the logit of occupancy is read from distance.
WIDTH = 0.003


class ArrayField(Field):
    """A field that computes in double precision on arrays, whatever tensors it is asked with.

    Answers have the type and the device that the module was moved to; nothing is differentiable.

    Parameters
    ----------
    V, F, W : arrays
        Rest vertices (n, d), facets (m, d) and skinning weights (n, b).
    """

    knows_distance = True
    knows_rest_images = True
    like: Tensor  # empty: the type and the device of answers

    def __init__(self, V: np.ndarray, F: np.ndarray, W: np.ndarray) -> None:
        super().__init__()
        self.V, self.F, self.W = V, F, W
        self.register_buffer("like", torch.zeros(0, dtype=torch.float64), persistent=False)

    def posed_arrays(self, B: np.ndarray) -> ArrayAnswers:
        """The method itself, in a pose (b, d+1, d+1)."""
        raise NotImplementedError

    def posed(self, B: Tensor) -> PosedField:
        """The field in a pose, (b, d+1, d+1) rest to posed."""
        answers = self.posed_arrays(_array(B))

        def answer(x: Tensor) -> Answer:
            distance, x_rest = (torch.as_tensor(found).to(self.like) for found in answers(_array(x)))
            return Answer(-distance / WIDTH, distance, x_rest)

        return answer

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy (p, n) of points (p, n, d) in poses (p, b, d+1, d+1): a constant, without a gradient."""
        return torch.stack([self.posed(pose)(points).logit for points, pose in zip(x, B, strict=True)])


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()
