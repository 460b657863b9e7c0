"""A trained model: one object that is queried at any point in any pose, and is kept in one file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.engine.answer import Answer
from nilbs.fields.field import Field, like
from nilbs.engine.unit_frame import UnitFrame, rest_center, root_bone
from nilbs.geometry.grids import Grid
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.surface import Surface
from nilbs.methods.base import Method
from nilbs.methods.registry import values_of
from nilbs.models.model_file import ModelParts, read_model_file, write_model_file
from nilbs.models.posed_model import PosedModel, check_pose_shape
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    from typing import Self


@dataclass
class Model:
    """A trained field with the character and the motion that it was trained on.

    All queries take

    - x: (n, d) float array of posed points in mesh units, any number; they are evaluated in chunks of bounded memory;
    - pose: (b, d+1, d+1) float array of bone transforms, rest to posed;
    - mapping: the way to the canonical points, one of `method.mappings`; by default the method's own.

    They raise ValueError if x or pose has another shape or a number that is not finite, a bone's transform is singular
    or very far from the root, the method has no such mapping, or it has not what is queried.

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
        What was trained, in torch, in the frame of `nilbs.engine.unit_frame`.
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
        """First root bone; the field works in its frame, and the ghost bone copies its transform."""
        return root_bone(self.character)

    def posed(self, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True) -> PosedModel:
        """The model in one pose, which is cheaper to query repeatedly than the model itself.

        Without the ghost bone (`ghost` False) the mappings "inverse" and "reverse" are eq. 7, with it eq. 8.
        """
        return PosedModel(self.character, self.method, self.field, pose, mapping=mapping, ghost=ghost)

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        """Occupancy (n,) of posed points: between 0 outside and 1 inside; above one half is inside."""
        return self.posed(pose, mapping=mapping, ghost=ghost).occupancy(x)

    def distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance (n,) of the *rest* shape at the canonical points, in mesh units, negative inside.

        Where skinning stretches, it differs from the distance in the pose by the stretch. The sign always agrees with
        `occupancy`: a point without a canonical point, or one that the ghost bone overrules, is outside.
        """
        return self.posed(pose, mapping=mapping).distance(x)

    def posed_distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance (n,) in the posed frame to first order, in mesh units, negative inside; of the method nilbs.

        It is the distance at rest times the local stretch: the length of its gradient by the canonical point over that
        by the posed point. Exact to first order at the surface, however it is stretched, and for any similarity. Where
        there is no gradient (no canonical point, the middle of a limb) it is the distance at rest.
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
        """Values (n, ...) of any field of the rest pose at the canonical points of posed points (eq. 7).

        Parameters
        ----------
        rest_field : function of (n, d) float arrays
            Rest points in mesh units to values (n, ...): a colour, a density, a texture coordinate. Evaluated for
            points inside only.
        x, pose, mapping
            As for all queries.
        outside : float
            Value of points outside the posed character.
        """
        return self.posed(pose, mapping=mapping).values(rest_field, x, outside=outside)

    def weights(self, x: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Weights (n, b+1) that the network predicts for posed points, the ghost bone's last; rows sum to one."""
        return self.posed(pose).weights(x)

    def rest_points(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Canonical points (n, d) in mesh units; where the body overlaps itself, one that lies inside.

        Where there is none, it is the point where the first search started: by default that of the inverse map; by the
        method snarf, nan.
        """
        return self.posed(pose, mapping=mapping).rest_points(x)

    def posed_points(self, x_rest: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d), in or close to the body, under the learned forward map (eq. 4)."""
        return self.posed(pose).posed_points(x_rest)

    def extract(self, pose: np.ndarray, resolution: int = RESOLUTION) -> Surface:
        """Surface of the posed character, where occupancy is one half.

        Parameters
        ----------
        pose
            As for all queries.
        resolution : int
            Cells along each edge of the cube around the posed character.

        Returns
        -------
        surface : Surface
            Vertices U (n, d), in mesh units, and facets F (m, d), triangles or edges, oriented outward:
            `U, F = model.extract(pose)`, or `model.extract(pose).to_trimesh()`.
        """
        U = linear_blend_skinning(self.character.V, self.character.W, pose)
        return self.posed(pose).extract_on(Grid.cube(U, resolution))

    def answer(self, x: torch.Tensor, pose: torch.Tensor, *, mapping: str | None = None) -> Answer:
        """Level, distance and canonical points as tensors, differentiable by the points and by the pose.

        Parameters
        ----------
        x : (n, d) tensor
            Posed points, in mesh units, on any device; the answer is on the field's.
        pose : (b, d+1, d+1) tensor
            Bone transforms, rest to posed.
        mapping
            As for all queries.

        Returns
        -------
        answer : Answer
            In mesh units. Derivatives are of first order; those of a root follow from the implicit function theorem.
            The methods nearest, rigid-parts and mesh-lbs have none.
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
        write_model_file(path, ModelParts(self.character, self.motion, self.method, self.history, self.field))


def load_model(path: str | Path, *, device: str = "cpu") -> Model:
    """Read a model file.

    Parameters
    ----------
    path : path
        What `Model.save` wrote.
    device : str
        Where the field goes; "auto" takes a GPU if there is one.

    Returns
    -------
    model : Model

    Raises
    ------
    FileFormatError
        If the file is not a model of this version, or was damaged.
    ValueError
        If torch has no such device.
    OSError
        If it cannot be opened.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.models.fitting import fit
    >>> from nilbs.characters.motion import random_motion
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> path = tempfile.mkdtemp() + "/bar.nilbs"
    >>> model.save(path)
    >>> load_model(path).method.name
    'nearest'
    """
    return Model(*read_model_file(path)).to(device=torch_device(device))


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
