"""A trained model: one object that is queried at any point in any pose, and is kept in one file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.engine.answer import Answer, Engine
from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.derivatives import SkinGradients
from nilbs.engine.rest_state import RestState
from nilbs.engine.skinning import SparseSkinning
from nilbs.engine.surface_tree import SurfaceTree
from nilbs.engine.unit_frame import root_bone
from nilbs.geometry.grids import Grid
from nilbs.geometry.surface import Surface
from nilbs.methods.base import Method
from nilbs.methods.registry import values_of
from nilbs.models.model_file import ModelParts, read_model_file, write_model_file
from nilbs.models.posed_model import PosedModel
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from nilbs.fields.field import Field


@dataclass
class Model:
    """A trained method of a character, with the motion that it was trained on.

    All queries take

    - x: (n, d) float array of posed points in mesh units, any number;
    - pose: (b, d+1, d+1) float array of bone transforms, rest to posed;
    - mapping: the way to the canonical points, one of `method.mappings`; by default the method's own.

    All but `extract` also take p poses at once, faster than one by one: points (p, n, d), n for each pose, and poses
    (p, b, d+1, d+1). Results then are (p, n), (p, n, d) and so on. Every thread works on poses of its own.

    They raise ValueError if x or pose has another shape, they disagree on p, a number is not finite, a bone's transform
    is singular or very far from the root, the method has no such mapping, or it has not what is queried. What the
    compiled engine or arrays answer needs no torch: the default search, and the baselines that learn nothing.

    Attributes
    ----------
    character : Character
    motion : Motion
        The training frames.
    method : Method
        With its settings.
    history : (steps,) float array
        Loss at each training step.
    parameters : mapping of str to array
        What was trained, by the names in the field's state.
    rest : RestState
        Grids of the rest pose.
    """

    character: Character
    motion: Motion
    method: Method
    history: np.ndarray
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict)
    rest: RestState = field(default_factory=RestState)

    def __post_init__(self) -> None:
        self._place: dict[str, Any] = {}  # device and precision that `to` moved the field to
        self._engines: dict[tuple[str | None, str], Engine | None] = {}

    @cached_property
    def field(self) -> "Field":
        """What was trained, in torch, in the frame of `nilbs.engine.unit_frame`."""
        from nilbs.models.torch_field import field_of

        return field_of(self.character, self.method, self.parameters, self.rest, **self._place)

    def engine(self, mapping: str | None = None) -> Engine | None:
        """What answers by a mapping without the field: arrays or compiled code, on a GPU a kernel; else None."""
        if not self._in_single_precision:
            return None
        mapping = mapping or getattr(self.method, "mapping", None)
        if (mapping, "cpu") not in self._engines:
            self._engines[mapping, "cpu"] = self.method.engine(self.character, self.rest, mapping)
        device = str(self._place.get("device", "cpu"))
        if (mapping, device) not in self._engines:
            from nilbs.models.torch_field import gpu_engine

            self._engines[mapping, device] = gpu_engine(self._engines[mapping, "cpu"], device)
        return self._engines[mapping, device]

    @property
    def _in_single_precision(self) -> bool:
        """Whether the field was trained in single precision, or moved to it."""
        dtype = self._place.get("dtype")
        if dtype is None:
            return all(a.dtype != np.float64 for a in self.parameters.values())
        return str(dtype) == "torch.float32"

    @cached_property
    def skinning(self) -> SparseSkinning:
        """The mesh, posed by linear blend skinning (eq. 1)."""
        return SparseSkinning(self.character.V, self.character.W)

    @cached_property
    def surface_tree(self) -> SurfaceTree:
        """The tree of the mesh's facets for closest points."""
        return SurfaceTree(self.character.V, self.character.F)

    @cached_property
    def skin_gradients(self) -> SkinGradients:
        """Derivatives of distances to the posed mesh."""
        return SkinGradients(self.character.V, self.character.F, self.character.W)

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
        """The model in one pose, which is cheaper to query repeatedly than the model itself, or in several.

        Without the ghost bone (`ghost` False) the mappings "inverse" and "reverse" are eq. 7, with it eq. 8.
        """
        return PosedModel(self, pose, mapping=mapping, ghost=ghost)

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        """Occupancy (n,) of posed points: between 0 outside and 1 inside; above one half is inside."""
        return self.posed(pose, mapping=mapping, ghost=ghost).occupancy(x)

    def distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance (n,) of the *rest* shape at the canonical points, in mesh units, negative inside.

        Where skinning stretches, it differs from the distance in the pose by the stretch; where there is no canonical
        point, by the default mapping, it is the distance to the posed skin. The sign always agrees with `occupancy`: a
        point without a canonical point, or one that the ghost bone overrules, is outside.
        """
        return self.posed(pose, mapping=mapping).distance(x)

    def posed_distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance (n,) to the posed skin, in mesh units; its sign agrees with `occupancy`.

        Its length is exact, see `closest_points`. Where the body overlaps itself, skin inside another part counts.
        """
        return self.posed(pose, mapping=mapping).posed_distance(x)

    def closest_points(self, x: np.ndarray, pose: np.ndarray) -> ClosestPoints:
        """Closest places on the posed skin: distances, facets, places and their barycentric coordinates.

        They are those of the mesh posed by linear blend skinning, exact but for rounding, at any distance.
        """
        return self.posed(pose).closest_points(x)

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

        Where there is none it is nan; by a mapping that starts from the network's answer, that answer.
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

        Raises
        ------
        ValueError
            As for all queries, and if there are several poses.

        Returns
        -------
        surface : Surface
            Vertices U (n, d), in mesh units, and facets F (m, d), triangles or edges, oriented outward:
            `U, F = model.extract(pose)`, or `model.extract(pose).to_trimesh()`.
        """
        if np.ndim(pose) == 4:
            raise ValueError("pose must be (b, d+1, d+1): a surface is extracted in one pose; extract each by itself")
        posed = self.posed(pose)
        return posed.extract_on(Grid.cube(posed.U, resolution))

    def answer(self, x: "Tensor", pose: "Tensor", *, mapping: str | None = None) -> "Answer[Tensor]":
        """Level, distance and canonical points as tensors, differentiable by the points and by the pose.

        Parameters
        ----------
        x : (n, d) or (p, n, d) tensor
            Posed points, in mesh units, on any device; the answer is on the field's.
        pose : (b, d+1, d+1) or (p, b, d+1, d+1) tensor
            Bone transforms, rest to posed.
        mapping
            As for all queries.

        Returns
        -------
        answer : Answer
            In mesh units. Derivatives are of first order. Those of a root follow from the implicit function theorem. By
            the default mapping a point without a canonical point has the distance to the posed skin, with its
            derivatives, also as level; its canonical point is nan and has none. The compiled engine answers in the
            higher precision of x and pose; another mapping, or a field that was moved, in that of the field. The
            methods nearest, rigid-parts and mesh-lbs have no derivatives. On a GPU, where neither x nor pose needs a
            derivative, level and distance are infinite without a canonical point: nothing is left to the processor.
        """
        from nilbs.models.torch_field import differentiable_answer

        return differentiable_answer(self, x, pose, mapping)

    def to(self, *, device: str | None = None, dtype: "torch.dtype | None" = None) -> Self:
        """Move the field to a device or a precision, in place.

        In double precision, or on another device than the processor, it answers instead of the compiled engine. On a
        GPU a kernel of Triton answers the default search where no derivative is needed, as the engine does; closest
        points of the posed skin are found by the processor. Without Triton the field answers, many times slower.
        """
        self._place |= {name: value for name, value in {"device": device, "dtype": dtype}.items() if value is not None}
        if "field" in self.__dict__:
            self.field.to(device=device, dtype=dtype)
        return self

    def save(self, path: str | Path) -> None:
        """Write the model to one self-contained file, without pickle.

        Raises
        ------
        OSError
            If the file cannot be written; what was there before is kept.
        """
        parameters = self.parameters
        if parameters and "field" in self.__dict__:  # which may have been moved to another precision, or trained on
            from nilbs.models.torch_field import parameters_of

            parameters = parameters_of(self.field)
        parts = ModelParts(self.character, self.motion, self.method, self.history, parameters, self.rest)
        write_model_file(path, parts)


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
    model = Model(*read_model_file(path))
    if device == "cpu":
        return model
    from nilbs.models.torch_field import torch_device

    return model.to(device=torch_device(device))
