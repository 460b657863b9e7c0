"""What every method is: a field that answers for posed points, in any pose."""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from nilbs.fields.answer import Answer

# A field in one pose: answers at posed points (n, d), asked any number of times.
PosedField = Callable[[Tensor], Answer]
# Numbers of one hidden layer that a processor's caches hold: layers of more wait for memory.
CACHED = 2**18


class Field(nn.Module):
    """Occupancy of a posed character by some method.

    Points and poses are in the unit frame: relative to the root bone, whose transform is the identity, with the rest
    mesh's box centred and its longest edge of length one.

    Attributes
    ----------
    piece : int
        Points that go through the networks together where a pose is asked.
    knows_distance, knows_rest_images : bool
        Whether answers hold more than occupancy: signed distances, and rest images where there are any.
    """

    piece: int = CACHED
    knows_distance = False
    knows_rest_images = False

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy, differentiable by the parameters: what a training compares with the truth.

        Parameters
        ----------
        x : (p, n, d) tensor
            Posed points, n for each pose.
        B : (p, b, d+1, d+1) tensor
            Poses, rest to posed.

        Returns
        -------
        logit : (p, n) tensor
            Positive inside.
        """
        raise NotImplementedError

    def posed(self, B: Tensor) -> PosedField:
        """The field in a pose, (b, d+1, d+1) rest to posed."""

        def answer(x: Tensor) -> Answer:
            logits = [self.logit(part[None], B[None])[0] for part in x.split(self.piece)]
            return Answer.of_logit(torch.cat(logits), x.shape[-1])

        return answer
