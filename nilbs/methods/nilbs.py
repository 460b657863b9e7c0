"""The default method: a weight network supervised in the rest volume in any pose, and a root search."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from nilbs.methods.base import setting
from nilbs.methods.inverse_skinning import ENCODED, ENCODINGS, InverseSkinning

if TYPE_CHECKING:
    from nilbs.characters.character import Character
    from nilbs.fields.field import Field
    from nilbs.fields.inverse_map import InverseField
    from nilbs.fields.occupancy_term import OccupancyTerm
    from nilbs.fields.samples import RestSamples
    from nilbs.fields.scene import Scene
    from nilbs.fields.weight_term import WeightTerm

# About a minute's work on two cores for a character of 24 bones.
STEPS = 2000


@dataclass(frozen=True)
class Nilbs(InverseSkinning):
    """Neural inverse linear blend skinning with a root search.

    The network of the paper is trained on points of the rest volume and of a thin shell around it, which skinning
    moves into the motion's poses and into random ones, so that their weights are exact and cost nothing. Every part of
    the body near a posed point is a start of Newton's method on the forward map.

    Differs from the paper: supervision in the volume, in random poses and by position, without labelled points unless
    they are asked for (then points with a large error are drawn more often, and occupancies are compared by
    cross-entropy); distances from posed bones as input; and the root search.

    References
    ----------
    .. [1] Jeruzalski et al., NiLBS: Neural Inverse Linear Blend Skinning, 2020, arXiv:2004.05980.
    """

    name: ClassVar[str] = "nilbs"
    summary: ClassVar[str] = "the root search, from a weight network and from every part of the body (the default)"

    steps: int | None = setting(None, "training steps (default: 2000); 0: no network, the grids alone")
    poses_per_step: int = setting(32, "poses in the batch of each loss", least=1)
    occupancy_loss: float = setting(0.0, "factor of the occupancy loss; 0: no points are labelled")
    encoding: str = setting("distances", ENCODED, choices=ENCODINGS)
    shell: float = setting(0.01, "standard deviation of the shell around the surface where weights are supervised")
    position_loss: float = setting(20.0, "factor of the distance by which the inverse map misses canonical points")
    random_pose_std: float = setting(
        1.0, "largest standard deviation of the angles of random poses, in radians; 0: only the motion's poses"
    )
    adaptive: bool = setting(True, "whether half of the labelled points are drawn by the field's error")

    def resolved(self, character: "Character") -> Self:
        """With steps, and grids as fine as fits the dimension."""
        return replace(super().resolved(character), steps=STEPS if self.steps is None else self.steps)

    def occupancy_term(self, field: "Field", scene: "Scene", **options: bool) -> "OccupancyTerm":
        """The loss that all methods share; half of its points can be drawn by the field's error."""
        return super().occupancy_term(field, scene, adaptive=self.adaptive, **options)

    def supervised_points(self, scene: "Scene") -> "RestSamples":
        """Points of the rest volume and of the shell."""
        return scene.volume_points(shell=self.shell)

    def weight_term(self, field: "InverseField", points: "RestSamples", scene: "Scene") -> "WeightTerm | None":
        """The weights in any pose, and the canonical points themselves."""
        from nilbs.fields.weight_term import WeightTerm

        if not (self.weight_loss or self.position_loss):
            return None
        random_poses = scene.random_poses(self.random_pose_std) if self.random_pose_std else None
        return WeightTerm(
            field,
            scene.poses,
            points,
            random_poses=random_poses,
            factor=self.weight_loss,
            position_loss=self.position_loss,
            **self.batch,
        )
