"""What every field is: a module that has values at posed points, in any pose."""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from nilbs.engine.answer import Answer

# A field in one pose: its answer at posed points (n, d), queried any number of times.
PosedField = Callable[[Tensor], Answer]
# Numbers of one hidden layer that fit a processor's caches; larger layers wait for memory.
CACHED = 2**18


class Field(nn.Module):
    """Occupancy of a posed character by some method.

    Points and poses are in the unit frame: relative to the root bone, whose transform is the identity, with the rest
    mesh's box centred and its longest edge of length one.

    Attributes
    ----------
    piece : int
        Points that go through the networks together in a query.
    has_distance, has_canonical_points : bool
        Whether answers hold more than occupancy.
    """

    piece: int = CACHED
    has_distance = False
    has_canonical_points = False

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy, positive inside, differentiable by the parameters: what a training compares with truth.

        Parameters
        ----------
        x : (p, n, d) tensor
            Posed points, n for each pose.
        B : (p, b, d+1, d+1) tensor
            Poses, rest to posed.

        Returns
        -------
        logit : (p, n) tensor
        """
        raise NotImplementedError

    def posed(self, B: Tensor) -> PosedField:
        """The field in a pose, (b, d+1, d+1) rest to posed."""

        def answer(x: Tensor) -> Answer:
            logit = torch.cat([self.logit(part[None], B[None])[0] for part in x.split(self.piece)])
            nan = torch.full_like(logit, torch.nan)
            return Answer(-logit, nan, nan[:, None].expand(-1, x.shape[-1]))

        return answer


def like(field: Field) -> Tensor:
    """A tensor of the field's precision, on its device."""
    return next(tensor for tensor in (*field.parameters(), *field.buffers()) if tensor.is_floating_point())
