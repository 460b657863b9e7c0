"""NASA: one small network for each bone, in that bone's frame; the body is the union of their shapes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import WIDEST, NetworkMethod, setting

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.field import Field
    from nilbs.fields.objective import Term
    from nilbs.fields.scene import Scene
    from nilbs.methods.nasa.field import NasaField


@dataclass(frozen=True)
class Nasa(NetworkMethod):
    """Neural articulated shape approximation: O(x | theta) = max_b O_b(B_b^-1 x | theta).

    Layers, residual connections and leaky units are those of the authors' code (tensorflow/graphics, projects/nasa).

    Differs from the paper:

    - The largest part is taken as it is, as in the paper; the authors' code by default takes a mean of the parts,
      weighted by a softmax.
    - A bone's frame is its rest frame moved to the bone's first joint; its axes are not turned along the bone. A first
      layer can do that itself.
    - The first layer begins with larger weights for the point, so that a few thousand steps are enough.
    - A part's layers are 40 units wide for any number of parts; the authors' code shares 960 units among them.
    - Occupancies are compared by cross-entropy, in the paper by squared difference. The weight loss counts in full, in
      the authors' code by half; that has one loss more, on the size of the parts, which is not here.
    - Matrices are trained by Muon, as in every network here.

    References
    ----------
    .. [1] Deng et al., NASA: Neural Articulated Shape Approximation, 2020, arXiv:1912.03207.
    """

    name: ClassVar[str] = "nasa"
    summary: ClassVar[str] = "one network for each bone, which sees the pose (NASA, deformable)"
    deformable: ClassVar[bool] = True

    width: int = setting(40, "units of a hidden layer of one part", least=1, most=WIDEST)
    depth: int = setting(4, "hidden layers of one part", least=2, most=WIDEST)
    poses_per_step: int = setting(16, "poses in the batch of each loss", least=1)
    points_per_pose: int = setting(64, "points of each of them", least=1)
    weight_loss: float = setting(1.0, "factor of the loss that assigns surface vertices to parts")

    def field(self, character: "Character") -> "NasaField":
        """An untrained network for each bone."""
        import torch

        from nilbs.engine.unit_frame import first_joints, root_bone
        from nilbs.methods.nasa.field import NasaField

        centers = torch.as_tensor(first_joints(character))
        return NasaField(
            centers, deformable=self.deformable, root=root_bone(character), width=self.width, depth=self.depth
        )

    def terms(self, field: "Field", scene: "Scene") -> "list[Term]":
        """The paper's weight loss."""
        from nilbs.methods.nasa.field import NasaField, NasaWeightTerm

        assert isinstance(field, NasaField)
        if not self.weight_loss:
            return []
        points = scene.surface_points()
        return [NasaWeightTerm(field, points, scene.poses, factor=self.weight_loss, **self.batch)]


@dataclass(frozen=True)
class RigidNasa(Nasa):
    """NASA's rigid model: a part sees the point in its bone's frame alone, so it moves with the bone, never bends."""

    name: ClassVar[str] = "nasa-rigid"
    summary: ClassVar[str] = "one network for each bone, which moves rigidly (NASA, rigid)"
    deformable: ClassVar[bool] = False
