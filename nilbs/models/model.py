"""A trained model: one object that answers for any point and any pose, and is kept in one file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.fields.answer import Answer
from nilbs.fields.field import Field, like
from nilbs.fields.unit_frame import UnitFrame, rest_center, root_bone
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface
from nilbs.methods.base import Method
from nilbs.methods.registry import values_of
from nilbs.models.posed_model import PosedModel, check_pose_shape
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    from typing import Self


@dataclass
class Model:
    """A trained field with the character and the motion that it was trained on.

    Attributes
    ----------
    character : Character
    motion : Motion
        The training frames.
    method : Method
        With its settings.
    history : (steps,) float array
        Loss at each training step.
    field : Field
        What was trained, in torch, in the frame of `nilbs.fields.unit_frame`.
    """

    character: Character
    motion: Motion
    method: Method
    history: np.ndarray
    field: Field

    @property
    def config(self) -> dict[str, Any]:
        """Settings of the training and where its motion came from, as JSON holds them."""
        return {
            "method": self.method.name,
            **values_of(self.method),
            "motion": self.motion.source,
            "frames": len(self.motion),
        }

    @property
    def root(self) -> int:
        """Bone whose frame the field works in, and whose transform the ghost bone copies: the first root."""
        return root_bone(self.character)

    def posed(self, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True) -> PosedModel:
        """The model in one pose, which is cheaper to ask again than the model itself.

        Parameters
        ----------
        pose : (b, d+1, d+1) float array
            Bone transforms, rest to posed.
        mapping : str, optional
            Way to the canonical points, one of `method.mappings`; by default the method's own.
        ghost : bool
            Whether the ghost bone takes part in the answers "inverse" (eq. 8) and "reverse"; without it this is eq. 7.

        Returns
        -------
        posed : PosedModel

        Raises
        ------
        ValueError
            If the pose has another shape, a bone's transform is singular or absurdly far, or the method has no such
            mapping.
        """
        return PosedModel(self.character, self.method, self.field, pose, mapping=mapping, ghost=ghost)

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        """Occupancy of posed points.

        Parameters
        ----------
        x : (n, d) float array
            Posed points, in mesh units; any number, they are answered in chunks of bounded memory.
        pose, mapping, ghost
            As for `posed`.

        Returns
        -------
        values : (n,) float array
            Between 0 outside and 1 inside; a point is inside where the value is above one half.

        Raises
        ------
        ValueError
            If x or pose has another shape, a bone's transform is singular or absurdly far, or
            the method has no such mapping.
        """
        return self.posed(pose, mapping=mapping, ghost=ghost).occupancy(x)

    def distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance of the *rest* shape at the canonical points of posed points.

        Where skinning stretches, the two differ by the stretch. The sign always agrees with `occupancy`: a point
        without a canonical point, or one that the ghost bone overrules, is outside. Its absolute value is the unsigned
        distance.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        distance : (n,) float array
            In mesh units, negative inside.

        Raises
        ------
        ValueError
            As `occupancy`; or if the method has no distance.
        """
        return self.posed(pose, mapping=mapping).distance(x)

    def posed_distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance of posed points in the posed frame, to first order.

        The distance at rest times the local stretch: the length of its gradient by the canonical point over that by the
        posed point. Exact to first order at the skin, however it is stretched, and for any similarity.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        distance : (n,) float array
            In mesh units, negative inside. Where there is no gradient (no canonical point, the middle of a limb) it is
            that at rest.

        Raises
        ------
        ValueError
            As `occupancy`; or if the method is not "nilbs".
        """
        return self.posed(pose, mapping=mapping).posed_distance(x)

    def values(
        self,
        rest_field: Callable[[np.ndarray], np.ndarray],
        x: np.ndarray,
        pose: np.ndarray,
        *,
        outside: float = np.nan,
        mapping: str | None = None,
    ) -> np.ndarray:
        """Values of any field that is known at rest, read at the canonical points of posed points (eq. 7).

        Parameters
        ----------
        rest_field : function of (n, d) float arrays
            Rest points in mesh units to values (n, ...): a colour, a density, a texture coordinate. Asked at the images
            of points inside.
        x, pose, mapping
            As for `occupancy`.
        outside : float
            What points outside the posed character have.

        Returns
        -------
        values : (n, ...) float array

        Raises
        ------
        ValueError
            As `occupancy`; or if the rest field has another number of values, or the method no canonical points.
        """
        return self.posed(pose, mapping=mapping).values(rest_field, x, outside=outside)

    def weights(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Weights that the network predicts for posed points.

        Parameters
        ----------
        x, pose
            As for `occupancy`.

        Returns
        -------
        W : (n, b+1) float array
            Rows sum to one; the last column is the ghost bone's.

        Raises
        ------
        ValueError
            As `occupancy`; or if the method is not "nilbs".
        """
        return self.posed(pose).weights(x)

    def rest_points(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Rest images of posed points; where several points of the body are posed there, one that lies inside.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        x_rest : (n, d) float array
            In mesh units. A point without a canonical point has the place where its first search began: by default the
            inverse map's; nan by the method "snarf".

        Raises
        ------
        ValueError
            As `occupancy`; or if the method has no canonical points.
        """
        return self.posed(pose, mapping=mapping).rest_points(x)

    def posed_points(self, x_rest: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Where the learnt forward map sends rest points (eq. 4).

        Parameters
        ----------
        x_rest : (n, d) float array
            Rest points, in mesh units, in the body or close to it.
        pose
            As for `posed`.

        Returns
        -------
        x : (n, d) float array
            In mesh units.

        Raises
        ------
        ValueError
            As `occupancy`; or if the method is not "nilbs".
        """
        return self.posed(pose).posed_points(x_rest)

    def extract(self, pose: np.ndarray, resolution: int = RESOLUTION) -> Surface:
        """Surface of the posed character, where occupancy is one half.

        Parameters
        ----------
        pose : (b, d+1, d+1) float array
            Bone transforms, rest to posed.
        resolution : int
            Cells along each edge of the cube around the posed character.

        Returns
        -------
        surface : Surface
            Vertices U (n, d), in mesh units, and facets F (m, d), triangles or edges, oriented outward:
            `U, F = model.extract(pose)`, or `model.extract(pose).to_trimesh()`.

        Raises
        ------
        ValueError
            As `occupancy`; or if the resolution is no whole number from 1 on or makes a grid too large.
        """
        U = linear_blend_skinning(self.character.V, self.character.W, pose)
        return self.posed(pose).extract_on(Grid.cube(U, resolution))

    def answer(self, x: torch.Tensor, pose: torch.Tensor, *, mapping: str | None = None) -> Answer:
        """Answers in torch, differentiable by the points and by the pose.

        Parameters
        ----------
        x : (n, d) tensor
            Posed points, in mesh units, on any device; answers are on the field's.
        pose : (b, d+1, d+1) tensor
            Bone transforms, rest to posed.
        mapping
            As for `posed`.

        Returns
        -------
        answer : Answer
            In mesh units. Derivatives are of first order; those of a root follow from the implicit function theorem.
            The methods nearest, rigid-parts and mesh-lbs have none.

        Raises
        ------
        ValueError
            If the method has no such mapping, a shape, type or device does not fit, or a number is not finite.
        """
        d = self.character.d
        for name, tensor in (("x", x), ("pose", pose)):
            kinds = "torch.float32 or torch.float64"
            if not isinstance(tensor, torch.Tensor) or tensor.dtype not in (torch.float32, torch.float64):
                raise ValueError(f"{name} must be a tensor of {kinds}, got {getattr(tensor, 'dtype', None)}")
            if not bool(torch.isfinite(tensor).all()):
                raise ValueError(f"{name} has numbers that are not finite")
        if x.ndim != 2 or x.shape[1] != d:
            raise ValueError(f"x must be (n, {d}), got {tuple(x.shape)}")
        check_pose_shape(self.character, pose.shape)
        self.method.check_mapping(mapping)
        frame, as_field = UnitFrame(self.character, pose), like(self.field)
        posed = self.method.posed(self.field, frame.B.to(as_field), mapping)
        center = torch.as_tensor(rest_center(self.character)).to(as_field)
        return posed(frame.points(x.to(pose)).to(as_field)).in_mesh_units(self.character.L, center)

    def to(self, *, device: str | None = None, dtype: torch.dtype | None = None) -> "Self":
        """Move the field to a device or a precision, in place."""
        self.field.to(device=device, dtype=dtype)
        return self

    def save(self, path: str | Path) -> None:
        """Write the model to one self-contained file, without pickle.

        Raises
        ------
        OSError
            If the file cannot be written; what was there before is kept.
        """
        from nilbs.models.model_file import save_model

        save_model(self, path)


def torch_device(name: str) -> str:
    """Check the name of a device; "auto" takes a GPU if torch finds one.

    Raises
    ------
    ValueError
        If torch has no such device.
    """
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.zeros(1, device=name).cpu()  # "meta", for one, holds nothing
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ValueError(f"torch cannot use the device {name!r}: {str(error).splitlines()[0]}") from None
    return name
