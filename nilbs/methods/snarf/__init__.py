"""SNARF: occupancy at rest, read at every canonical point that learned forward skinning sends to the posed point."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import WIDEST, NetworkMethod, setting

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.field import Field
    from nilbs.fields.objective import Term
    from nilbs.fields.scene import Scene
    from nilbs.methods.snarf.field import SnarfField


@dataclass(frozen=True)
class Snarf(NetworkMethod):
    """Differentiable forward skinning: learned rest weights, and roots by Broyden's method from every bone.

    Details that the paper leaves open are those of its authors' code.

    Differs from the paper:

    - Networks are smaller by default, for a training of minutes on a processor: 5 linear layers of 64 units instead
      of 9 of 256, and 4 of 64 instead of 5 of 128. They have no weight normalisation and no skip connection.
    - Few labelled points are drawn at a time, because the search makes each expensive.
    - Activations are h sigmoid(100 h), as close to a ramp as the softplus of the authors' code.
    - The softmax of the weights is over all bones, not one after the other down the tree of a human body.
    - A search takes at most 10 steps, not 50, and always begins with the map's whole derivative; the authors' code
      leaves out the derivative of the weights when it does not train.
    - A root that several searches find counts once, and a search begins from every bone; the authors' code leaves out
      some bones of its human body.
    - Matrices are trained by Muon, as in every network here; the authors use Adam and clip gradients.
    - Poses are relative to the root bone, and lengths in units of the body, the search's thresholds too.
    - The two losses that start the paper's training stay to the end; there they end with the first pass over the data.

    References
    ----------
    .. [1] Chen et al., SNARF: Differentiable Forward Skinning for Animating Non-Rigid Neural Implicit Shapes, 2021,
       arXiv:2104.03953.
    """

    name: ClassVar[str] = "snarf"
    summary: ClassVar[str] = "learned forward skinning, with roots searched from every bone (SNARF)"

    width: int = setting(64, "units of a hidden layer of the occupancy network", least=1, most=WIDEST)
    poses_per_step: int = setting(4, "poses in the batch of each loss", least=1)
    weight_loss: float = setting(1.0, "factor of the losses on bones and joints that start the paper's training")

    def field(self, character: "Character") -> "SnarfField":
        """An untrained pair of networks."""
        import torch

        from nilbs.engine.unit_frame import first_joints
        from nilbs.methods.snarf.field import SnarfField

        P, centers = torch.as_tensor(character.skeleton.P), torch.as_tensor(first_joints(character))
        return SnarfField(P, centers, width=self.width, depth=self.depth)

    def terms(self, field: "Field", scene: "Scene") -> "list[Term]":
        """Bones are inside, and joints belong to two bones."""
        from nilbs.methods.snarf.field import SnarfBoneTerm, SnarfField

        assert isinstance(field, SnarfField)
        return [SnarfBoneTerm(field, *scene.unit_bones(), factor=self.weight_loss)] if self.weight_loss else []
