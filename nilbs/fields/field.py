"""What every method is: a field that answers for posed points, in any pose."""

from collections.abc import Callable

from torch import Tensor, nn

from nilbs.fields.answer import Answer

# A field in one pose: answers at posed points (n, d), asked any number of times.
PosedField = Callable[[Tensor], Answer]


class Field(nn.Module):
    """Occupancy of a posed character by some method.

    Points and poses are in the unit frame: relative to the root bone, whose transform is the identity, with the rest
    mesh's box centred and its longest edge of length one.
    """

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
        return lambda x: Answer.of_logit(self.logit(x[None], B[None])[0], x.shape[-1])
