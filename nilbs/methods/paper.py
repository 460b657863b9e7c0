"""The method as its paper trains it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nilbs.methods.base import setting
from nilbs.methods.inverse_skinning import MAPPINGS, InverseSkinning

if TYPE_CHECKING:
    from nilbs.fields.field import Field
    from nilbs.fields.inverse_map import InverseField
    from nilbs.fields.occupancy_term import OccupancyTerm
    from nilbs.fields.samples import RestSamples
    from nilbs.fields.scene import Scene
    from nilbs.fields.weight_term import WeightTerm


@dataclass(frozen=True)
class Paper(InverseSkinning):
    """NiLBS with the supervision of its paper: weights at rest vertices in the rest pose, uniform points.

    Occupancies are compared by their absolute difference, and the inverse map alone (eq. 6 and 8) finds the canonical
    point. Network, encoding, grids and optimiser are those of `nilbs.methods.nilbs.Nilbs`.

    References
    ----------
    .. [1] Jeruzalski et al., NiLBS: Neural Inverse Linear Blend Skinning, 2020, arXiv:2004.05980.
    """

    name: ClassVar[str] = "paper"
    summary: ClassVar[str] = "the inverse map, with the losses and points of the NiLBS paper"

    mapping: str = setting("inverse", "way to the canonical point; training does not depend on it", choices=MAPPINGS)
    noise: float = setting(0.0, "standard deviation of the labelled points near the surface; 0: uniform points")

    def occupancy_term(self, field: "Field", scene: "Scene", **options: bool) -> "OccupancyTerm":
        """The loss that all methods share, by the absolute difference."""
        return super().occupancy_term(field, scene, absolute=True, **options)

    def supervised_points(self, scene: "Scene") -> "RestSamples":
        """Vertices of the rest surface."""
        return scene.surface_points()

    def weight_term(self, field: "InverseField", points: "RestSamples", scene: "Scene") -> "WeightTerm | None":
        """The weights in the rest pose."""
        from nilbs.fields.weight_term import WeightTerm

        if not self.weight_loss:
            return None
        return WeightTerm(field, None, points, random_poses=None, factor=self.weight_loss, **self.batch)
