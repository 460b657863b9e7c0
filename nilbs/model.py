"""A trained model: one object and one file that answers for any point and any pose."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from nilbs.character import Character
from nilbs.fields.answer import Answer
from nilbs.fields.cache import RestCache
from nilbs.fields.forward import ForwardField
from nilbs.fields.network import WeightNetwork
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.search import SearchField
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.kinematics import bone_order
from nilbs.geometry.rotations import rigid_transforms
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.validation import arrays
from nilbs.motion import Motion
from nilbs.settings import RESOLUTION, Settings

if TYPE_CHECKING:
    from typing import Self

KIND = "nilbs model 2"
# Points that go through the network at once; bounds the memory of a query of any size.
CHUNK = 16_384
# A distance that changes by less than this share of the way tells nothing of how far the skin is.
LEAST_SLOPE = 0.01
# Names of the field's parts that hold grids of the rest pose.
CACHE, FORWARD = "inverse.cache", "forward_field"


@dataclass
class Model:
    """A trained field with the character and the motion that it was trained on.

    Attributes
    ----------
    character : Character
    motion : Motion
        The training frames.
    settings : Settings
    history : (steps,) float array
        Loss at each training step.
    field : SearchField
        The network, the rest cache and the rest weights, in torch, in the frame of `in_unit_frame`.
    """

    character: Character
    motion: Motion
    settings: Settings
    history: np.ndarray
    field: SearchField

    @property
    def config(self) -> dict[str, Any]:
        """Settings of the training and where its motion came from, as JSON holds them."""
        return {**asdict(self.settings), "motion": self.motion.source, "frames": len(self.motion)}

    @property
    def root(self) -> int:
        """Bone whose frame the field works in, and whose transform the ghost bone copies: the first root."""
        return root_bone(self.character)

    def occupancy(
        self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> np.ndarray:
        """Occupancy of posed points.

        Parameters
        ----------
        x : (n, d) float array
            Posed points, in mesh units; any number, they are answered in chunks of bounded memory.
        pose : (b, d+1, d+1) float array
            Bone transforms, rest to posed.
        mapping : "search" or "inverse", optional
            Where rest images come from: a root search that begins at the network's answer, or the network's inverse map
            alone (eq. 6). By default what the settings say.
        ghost : bool
            Whether the ghost bone takes part in the inverse map's answer (eq. 8); without it this is eq. 7.

        Returns
        -------
        values : (n,) float array
            Between 0 outside and 1 inside; a point is inside where the value is above one half.

        Raises
        ------
        ValueError
            If x or pose has another shape, the root's transform is singular, or the mapping is unknown.
        """
        return _joined([torch.sigmoid(answer.logit) for answer in self._answers(x, pose, mapping, ghost)])

    def distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance of posed points, read at their rest images: that of the *rest* shape, not of the posed one.

        Where skinning stretches, the two differ by the stretch. The sign always agrees with `occupancy`: a point
        without a rest image, or one that the ghost bone overrules, is outside.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        distance : (n,) float array
            In mesh units, negative inside.
        """
        return _joined([answer.distance for answer in self._answers(x, pose, mapping)]) * self.character.L

    def posed_distance(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Signed distance of posed points in the posed frame, to first order.

        The distance at rest is divided by how much less it changes with the posed point than with the rest image: exact
        to first order at the skin, which skinning may stretch or press, and for any similarity.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        distance : (n,) float array
            In mesh units, negative inside. Where the gradient says nothing (no rest image, the middle of a limb) it is
            that at rest.
        """
        x, pose = self._checked(x, pose)
        B, found = torch.tensor(pose), []
        for start in range(0, max(len(x), 1), CHUNK):
            part = torch.tensor(x[start : start + CHUNK], requires_grad=True)
            answer = self.answer(part, B, mapping=mapping)
            (slope,) = torch.autograd.grad(answer.distance.sum(), part)
            center = torch.as_tensor(rest_center(self.character)).to(answer.x_rest)
            x_rest = ((answer.x_rest.detach() - center) / self.character.L).requires_grad_()
            (slope_rest,) = torch.autograd.grad(self.field.inverse.cache.distance(x_rest).sum(), x_rest)
            length, length_rest = (vector.norm(dim=-1).to(answer.distance) for vector in (slope, slope_rest))
            told = (length > 0) & (length_rest > LEAST_SLOPE)
            found.append((answer.distance * torch.where(told, length_rest / length, 1.0)).detach())
        return _joined(found)

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
        """
        inverse = self.field.inverse
        return _joined([inverse(chunk[None], B[None]).weights[0] for chunk, B in self._chunks(x, pose)])

    def rest_points(self, x: np.ndarray, pose: np.ndarray, *, mapping: str | None = None) -> np.ndarray:
        """Rest images of posed points; where several points of the body are posed there, one that lies inside.

        Parameters
        ----------
        x, pose, mapping
            As for `occupancy`.

        Returns
        -------
        x_rest : (n, d) float array
            In mesh units. A point without a rest image has that of the inverse map.
        """
        unit = _joined([answer.x_rest for answer in self._answers(x, pose, mapping)])
        return unit * self.character.L + rest_center(self.character)

    def extract(self, pose: np.ndarray, resolution: int = RESOLUTION) -> tuple[np.ndarray, np.ndarray]:
        """Surface of the posed character, where occupancy is one half.

        Parameters
        ----------
        pose : (b, d+1, d+1) float array
            Bone transforms, rest to posed.
        resolution : int
            Cells along each edge of the cube around the posed character.

        Returns
        -------
        U : (n, d) float array
            Vertices, in mesh units.
        F : (m, d) int array
            Triangles (3D) or edges (2D), oriented outward.
        """
        U = linear_blend_skinning(self.character.V, self.character.W, pose)
        return self.extract_on(Grid.cube(U, resolution), pose)

    def extract_on(
        self, grid: Grid, pose: np.ndarray, *, mapping: str | None = None, stride: int = 4
    ) -> tuple[np.ndarray, np.ndarray]:
        """Surface of the posed character on a grid of one's own; `stride` 1 asks the field at every node."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            answers = list(self._answers(x, pose, mapping))
            # In mesh units the level is near the signed distance, so that marching cubes' linear interpolation is too.
            L = self.character.L
            level = -_joined([answer.logit for answer in answers]) * self.field.inverse.cache.width * L
            return level, _joined([answer.distance for answer in answers]) * L

        return field_surface(levels, grid, stride=stride)

    def answer(self, x: torch.Tensor, pose: torch.Tensor, *, mapping: str | None = None) -> Answer:
        """Answers in torch, differentiable by the points and by the pose.

        Parameters
        ----------
        x : (n, d) tensor
            Posed points, in mesh units, on the field's device.
        pose : (b, d+1, d+1) tensor
            Bone transforms, rest to posed.
        mapping
            As for `occupancy`.

        Returns
        -------
        answer : Answer
            Distance and rest images in mesh units. Derivatives are of first order: by the root search they are those of
            the root, by the implicit function theorem, and do not pass through its iterations.

        Raises
        ------
        ValueError
            If the mapping is unknown.
        """
        x_unit, B = unit_frame(self.character, x, pose)
        like = next(self.field.parameters())
        answer = self._posed(B.to(like), mapping)(x_unit.to(like))
        L, center = self.character.L, torch.as_tensor(rest_center(self.character)).to(like)
        return Answer(answer.logit, answer.distance * L, answer.x_rest * L + center)

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
        from nilbs.io.archive import write_archive

        contents = {f"field.{name}": tensor.cpu().numpy() for name, tensor in self.field.state_dict().items()}
        for name in ("V", "F", "C", "BE", "P", "W", "V_volume", "T", "W_volume"):
            contents[f"character.{name}"] = getattr(self.character, name)
        contents |= {f"motion.{name}": getattr(self.motion, name) for name in ("B", "frames", "times")}
        contents["history"] = self.history
        text = {
            "name": self.character.name,
            "bones": list(self.character.names),
            "motion": self.motion.source,
            "spacing": {CACHE: self.field.inverse.cache.spacing, FORWARD: self.field.forward_field.spacing},
            "settings": asdict(self.settings),
        }
        write_archive(path, contents, text, kind=KIND)

    def _answers(
        self, x: np.ndarray, pose: np.ndarray, mapping: str | None = None, ghost: bool = True
    ) -> Iterator[Answer]:
        posed = None
        for chunk, B in self._chunks(x, pose):
            with torch.inference_mode():
                posed = posed or self._posed(B, mapping, ghost)
                yield posed(chunk)

    def _chunks(self, x: np.ndarray, pose: np.ndarray) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Points in pieces, and the pose, in the field's frame."""
        x, pose = self._checked(x, pose)
        like = next(self.field.parameters())
        x_unit, B_unit = in_unit_frame(self.character, x, pose)
        B = torch.as_tensor(B_unit, dtype=like.dtype, device=like.device)
        for start in range(0, max(len(x_unit), 1), CHUNK):
            with torch.inference_mode():
                yield torch.as_tensor(x_unit[start : start + CHUNK], dtype=like.dtype, device=like.device), B

    def _checked(self, x: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, pose = arrays(x=(x, "n d"), pose=(pose, "b d+1 d+1"))
        wanted = (len(self.character.BE), self.character.d + 1, self.character.d + 1)
        if pose.shape != wanted:
            raise ValueError(f"pose must be (b, d+1, d+1) = {wanted}, got {pose.shape}")
        return x, pose

    def _posed(self, B: torch.Tensor, mapping: str | None, ghost: bool = True) -> Callable[[torch.Tensor], Answer]:
        mapping = self.settings.mapping if mapping is None else mapping
        if mapping == "search":
            return self.field.posed(B)
        if mapping == "inverse":
            return partial(self.field.inverse.answer, B=B, ghost=ghost)
        raise ValueError(f"mapping must be 'search' or 'inverse', got {mapping!r}")


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
    OSError
        If it cannot be opened.
    """
    from nilbs.io.archive import read_archive
    from nilbs.io.errors import FileFormatError

    contents, text = read_archive(path, kind=KIND)
    try:
        part = {name.removeprefix("character."): a for name, a in contents.items() if name.startswith("character.")}
        character = Character(name=str(text["name"]), names=tuple(map(str, text["bones"])), **part)
        check_character(character)
        times = contents.get("motion.times", np.zeros(0))  # which files of before motions had times do not hold
        motion = Motion(contents["motion.B"], contents["motion.frames"], str(text["motion"]), times, character.skeleton)
        settings = Settings.from_mapping(text["settings"])
        state = {name.removeprefix("field."): a for name, a in contents.items() if name.startswith("field.")}
        check_field(state, character)
        field = blank_field(character, settings, state, text["spacing"])
        field.load_state_dict({name: torch.from_numpy(a) for name, a in state.items()})
        arrays(history=(contents["history"], "s"))
        model = Model(character, motion, settings, contents["history"], field)
    except (KeyError, TypeError, ValueError, OverflowError, RuntimeError) as error:
        reason = " ".join(str(error).split())  # torch explains itself over several lines
        raise FileFormatError(path, f"is not a complete nilbs model: {reason}") from None
    return model.to(device=torch_device(device))


def check_character(character: Character) -> None:
    """Check that a character's arrays fit each other.

    Raises
    ------
    ValueError
        Naming the array that does not.
    """
    c = character
    arrays(
        V=(c.V, "n d"), F=(c.F, "m d", int), C=(c.C, "k d"), BE=(c.BE, "b 2", int), P=(c.P, "b", int), W=(c.W, "n b"),
        V_volume=(c.V_volume, "v d"), T=(c.T, "t d+1", int), W_volume=(c.W_volume, "v b"),
    )  # fmt: skip
    for name, indices, size in (("F", c.F, len(c.V)), ("BE", c.BE, len(c.C)), ("T", c.T, len(c.V_volume))):
        if len(indices) and not (indices.min() >= 0 and indices.max() < size):
            raise ValueError(f"{name} has an index outside 0 to {size - 1}")
    if any(indices.dtype.kind != "i" for indices in (c.F, c.BE, c.P, c.T)):
        raise ValueError("F, BE, P and T must be stored as integers")
    if not c.L > 0:
        raise ValueError("all vertices lie in one place")
    if not len(c.BE) or len(c.names) != len(c.BE) or len(c.P) != len(c.BE):
        raise ValueError("names or parents of bones do not fit the bones")
    bone_order(c.P)


def check_field(state: Mapping[str, np.ndarray], character: Character) -> None:
    """Check that the grids of a field's state fit the character and themselves.

    Raises
    ------
    KeyError, ValueError
        Naming what does not.
    """
    d, b = character.d, len(character.BE)
    values, row, first = state[f"{CACHE}.values"], state[f"{FORWARD}.row"], state[f"{FORWARD}.first"]
    for name, grid in (("rest cache", values), ("grid of rest weights", row)):
        if grid.ndim != d or min(grid.shape) < 2:
            raise ValueError(f"the {name} has shape {grid.shape}")
    bone, weight, node = (state[f"{FORWARD}.{name}"] for name in ("bone", "weight", "node"))
    arrays(
        values=(values.ravel(), "n"), origin=(state[f"{CACHE}.origin"], f"{d}"),
        weight=(weight, "s"), weight_origin=(state[f"{FORWARD}.origin"], f"{d}"),
    )  # fmt: skip
    if any(indices.dtype != np.int32 for indices in (row, node, bone, first)):
        raise ValueError("row, node, bone and first must be stored as 32-bit integers")
    steps = np.diff(first.astype(np.int64))
    if first.ndim != 1 or len(first) < 2 or first[0] != 0 or first[-1] != len(bone) or (steps < 1).any():
        raise ValueError("the rows of rest weights do not follow each other")
    if bone.shape != weight.shape or row.min() < 0 or row.max() >= len(steps) or bone.min() < 0 or bone.max() >= b:
        raise ValueError("a row or a bone of the rest weights does not exist")
    if node.shape != steps.shape or node.min() < 0 or node.max() >= row.size:
        raise ValueError("a node of the rest weights does not exist")


def blank_field(
    character: Character, settings: Settings, state: Mapping[str, np.ndarray], spacing: Mapping[str, float]
) -> SearchField:
    """An untrained field around the grids of the rest pose, in the unit frame.

    Parameters
    ----------
    character : Character
    settings : Settings
    state : mapping of str to array
        Grids, named as in the field's state; other names are passed over.
    spacing : mapping of str to float
        Edge of a cell of each of the two grids, by its part's name.
    """
    part = {name: torch.as_tensor(array) for name, array in state.items()}
    centers = (character.C[character.BE[:, 0]] - rest_center(character)) / character.L
    cache = RestCache(
        part[f"{CACHE}.values"], part[f"{CACHE}.origin"], float(spacing[CACHE]), width=settings.cache_width
    )
    network = WeightNetwork(torch.as_tensor(centers), scale=1.0, width=settings.width, depth=settings.depth)
    forward_field = ForwardField(
        row=part[f"{FORWARD}.row"],
        node=part[f"{FORWARD}.node"],
        bone=part[f"{FORWARD}.bone"],
        weight=part[f"{FORWARD}.weight"],
        first=part[f"{FORWARD}.first"],
        origin=part[f"{FORWARD}.origin"],
        spacing=float(spacing[FORWARD]),
    )
    field = SearchField(NilbsField(network, cache, root=root_bone(character)), forward_field)
    return field.to(cache.values.dtype)


def rest_center(character: Character) -> np.ndarray:
    """Centre (d,) of the rest mesh's bounding box."""
    return (character.V.min(axis=0) + character.V.max(axis=0)) / 2


def root_bone(character: Character) -> int:
    """The first bone without a parent."""
    return int(np.flatnonzero(character.P < 0)[0])


def in_unit_frame(character: Character, x: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and poses as the field sees them: relative to the root bone, centred, in units of L.

    The field thereby gives one and the same answer for a character and its rigidly moved, scaled or far-away copy;
    what single precision would lose far from the origin is taken off in double precision first.

    Parameters
    ----------
    character : Character
    x : (..., n, d) float array
        Posed points.
    B : (..., b, d+1, d+1) float array
        Poses, rest to posed.

    Returns
    -------
    x_unit : (..., n, d) float array
    B_unit : (..., b, d+1, d+1) float array

    Raises
    ------
    ValueError
        If the root's transform is singular.
    """
    x_unit, B_unit = unit_frame(character, *(torch.tensor(np.asarray(a), dtype=torch.float64) for a in (x, B)))
    return x_unit.numpy(), B_unit.numpy()


def unit_frame(character: Character, x: torch.Tensor, B: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What `in_unit_frame` does, on tensors and differentiable."""
    d, L, center = character.d, character.L, rest_center(character)
    root = B[..., root_bone(character), :, :]
    if bool((torch.linalg.det(root[..., :d, :d]).abs() < 1e-12).any()):
        raise ValueError(f"bone {root_bone(character)}, the root, has a singular transform")
    to_unit = torch.as_tensor(rigid_transforms(np.eye(d) / L, -center / L)).to(B)
    from_unit = torch.as_tensor(rigid_transforms(np.eye(d) * L, center)).to(B)
    to_root = to_unit @ torch.linalg.inv(root)
    x_unit = x @ to_root[..., :d, :d].mT + to_root[..., None, :d, d]
    return x_unit, to_root[..., None, :, :] @ B @ from_unit


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
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        raise ValueError(f"torch cannot use the device {name!r}: {str(error).splitlines()[0]}") from None
    return name


def _joined(chunks: list[torch.Tensor]) -> np.ndarray:
    return torch.cat(chunks).cpu().numpy()
