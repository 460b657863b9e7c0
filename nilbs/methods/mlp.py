"""The baseline without skinning: a plain network on the point and the pose."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import WIDEST, NetworkMethod, setting

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.network import NetworkField


@dataclass(frozen=True)
class Mlp(NetworkMethod):
    """Multilayer perceptron from a posed point and the pose parameters to the logit of occupancy.

    The unstructured baseline of the papers on articulated fields [1]_: nothing in it moves rigidly, so it has to learn
    the shape of each pose.

    Differs from the paper: its layers are those of the weight networks here, and the pose parameters are local
    rotations.

    References
    ----------
    .. [1] Deng et al., NASA: Neural Articulated Shape Approximation, 2020, arXiv:1912.03207.
    """

    name: ClassVar[str] = "mlp"
    summary: ClassVar[str] = "a plain network on the point and the pose parameters, without skinning"

    width: int = setting(256, "units of a hidden layer", least=1, most=WIDEST)
    depth: int = setting(6, "linear layers", least=2, most=WIDEST)
    poses_per_step: int = setting(16, "poses in the batch of each loss", least=1)
    points_per_pose: int = setting(256, "points of each of them", least=1)

    def field(self, character: "Character") -> "NetworkField":
        """An untrained network."""
        import torch

        from nilbs.fields.encoding import ParameterEncoding
        from nilbs.fields.network import EncodedNetwork, NetworkField

        encoding = ParameterEncoding(torch.as_tensor(character.skeleton.P), character.d)
        return NetworkField(EncodedNetwork(encoding, 1, width=self.width, depth=self.depth))
