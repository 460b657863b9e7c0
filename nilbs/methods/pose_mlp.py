"""A plain network on the point and the pose: the floor among methods that learn, with no skinning in it."""

from torch import Tensor

from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.field import CACHED, Field
from nilbs.fields.network import EncodedNetwork


class PoseMlp(Field):
    """Multilayer perceptron from a posed point and the pose parameters to the logit of occupancy.

    What the papers on articulated fields compare with, as the unstructured baseline of [1]_: nothing tells it that
    parts of a body move rigidly, so it has to learn each pose's shape by heart.

    Differs from the paper: the layers are those of the networks that predict skinning weights here, plain and of a
    width to choose, and the pose is told as local rotations.

    Parameters
    ----------
    P : (b,) tensor
        Parent bones, -1 at a root.
    d : int
        Dimension.
    width : int
        Units of a hidden layer.
    depth : int
        Linear layers, the first and the last included.

    References
    ----------
    .. [1] Deng et al., NASA: Neural Articulated Shape Approximation, 2020, arXiv:1912.03207.
    """

    def __init__(self, P: Tensor, d: int, *, width: int, depth: int) -> None:
        super().__init__()
        self.piece = max(128, CACHED // width)
        self.network = EncodedNetwork(ParameterEncoding(P, d), 1, width=width, depth=depth)

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit of occupancy (p, n) of points (p, n, d) in poses (p, b, d+1, d+1)."""
        logits: Tensor = self.network(x, B)
        return logits[..., 0]
