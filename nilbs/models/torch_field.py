"""The field of a model in torch: where there is no engine, and where derivatives are asked for."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from nilbs.characters.character import Character
from nilbs.engine.answer import Answer
from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.compiled import announce, each
from nilbs.engine.derivatives import root_gradients
from nilbs.engine.rest_state import RestState
from nilbs.engine.search import SearchEngine
from nilbs.engine.unit_frame import UnitFrame
from nilbs.fields.field import Field, like
from nilbs.fields.search import SearchField
from nilbs.methods.base import Method
from nilbs.models.posed_model import check_near, check_pose_shape

if TYPE_CHECKING:
    from nilbs.engine.answer import Engine
    from nilbs.fields.gpu_search import GpuSearch
    from nilbs.models.model import Model

# Points that go through a field at once; bounds the memory of a query of any size.
CHUNK = 16_384


def field_of(
    character: Character,
    method: Method,
    parameters: Mapping[str, np.ndarray],
    rest: RestState,
    *,
    device: str | None = None,
    dtype: torch.dtype | None = None,
) -> Field:
    """The field around the grids of a character, with these parameters; by default in their precision.

    Raises
    ------
    ValueError
        If the parameters are not those of a field of this method.
    """
    field = method.field_around(character, rest)
    if dtype is None:
        double = any(a.dtype == np.float64 for a in parameters.values())
        dtype = torch.float64 if double else torch.float32
    field = field.to(device=device, dtype=dtype)
    if parameters or not rest.arrays:  # trained, or nothing to train
        try:
            field.load_state_dict({name: torch.from_numpy(a) for name, a in parameters.items()})
        except RuntimeError as error:
            reason = " ".join(str(error).split())  # torch explains itself over several lines
            raise ValueError(f"the model is not complete: {reason}") from None
    return field


def parameters_of(field: Field) -> dict[str, np.ndarray]:
    """What a field has learned, by name."""
    return {name: tensor.cpu().numpy() for name, tensor in field.state_dict().items()}


def gpu_engine(engine: "Engine | None", device: str) -> "GpuSearch | None":
    """The same search as the compiled one, on a GPU; None, for the field, where there is none of it."""
    if not isinstance(engine, SearchEngine) or device.partition(":")[0] != "cuda":
        return None
    from nilbs.fields.gpu_kernel import PROBLEM
    from nilbs.fields.gpu_search import GpuSearch

    if PROBLEM is not None:
        announce(f"triton cannot be imported ({PROBLEM}): the GPU answers by torch, many times slower")
        return None
    return GpuSearch(engine, device)


class TorchEngine:
    """A field behind the interface of an engine, in one pose.

    Attributes
    ----------
    posed : PosedField
        The field in the pose.
    """

    def __init__(self, method: Method, field: Field, B: np.ndarray, mapping: str | None, *, ghost: bool) -> None:
        self.like = like(field)
        with torch.inference_mode():
            self.posed = method.posed(
                field, torch.from_numpy(np.ascontiguousarray(B)).to(self.like), mapping, ghost=ghost
            )

    def __call__(self, x: np.ndarray, to_unit: np.ndarray) -> Answer[np.ndarray]:
        """Answers at points (n, d), which the transform (d, d+1) moves into the unit frame."""
        d = x.shape[1]
        x_unit = torch.from_numpy(x @ to_unit[:, :d].T + to_unit[:, d]).to(self.like)
        with torch.inference_mode():
            answers = [self.posed(chunk) for chunk in x_unit.split(CHUNK)]
        columns = zip(*(answer[:3] for answer in answers), strict=True)
        level, distance, x_rest = (torch.cat(column).cpu().numpy() for column in columns)
        return Answer(level, distance, x_rest, answers[0].width)

    @property
    def queries(self) -> int:
        """Points queried so far, if the method counts them, else 0."""
        return getattr(self.posed, "queries", 0)

    @property
    def evaluations(self) -> int:
        """Evaluations of weights for them."""
        return getattr(self.posed, "evaluations", 0)


def predicted_weights(model: "Model", B: np.ndarray, x_unit: np.ndarray) -> np.ndarray:
    """Weights (n, b+1) that the network predicts for points (n, d) in a pose, both of the unit frame."""
    field = _searching(model)
    if not model.parameters:
        raise ValueError("training had 0 steps: there is no network")
    pose, x = (torch.from_numpy(np.ascontiguousarray(array)).to(like(field)) for array in (B, x_unit))
    with torch.inference_mode():
        parts = [field.inverse.weights(chunk[None], pose[None])[0] for chunk in x.split(CHUNK)]
    return torch.cat(parts).cpu().numpy()


def images(model: "Model", B: np.ndarray, x_rest: np.ndarray) -> np.ndarray:
    """Images (n, d) of rest points (n, d) under the forward map in a pose, all in the unit frame."""
    skinning = _searching(model).skinning
    pose, x = (torch.from_numpy(np.ascontiguousarray(array)).to(like(model.field)) for array in (B, x_rest))
    with torch.inference_mode():
        blends = skinning.blends(pose)
        return torch.cat([skinning.pose(chunk, blends).x for chunk in x.split(CHUNK)]).cpu().double().numpy()


def _searching(model: "Model") -> SearchField:
    if not isinstance(model.field, SearchField):
        raise ValueError(
            f"the method {model.method.name} has no skinning weights of posed points; nilbs and paper have"
        )
    return model.field


def differentiable_answer(model: "Model", x: Tensor, pose: Tensor, mapping: str | None) -> Answer[Tensor]:
    """What `Model.answer` returns.

    Raises
    ------
    ValueError
        As for all queries.
    """
    c, d = model.character, model.character.d
    for name, tensor in (("x", x), ("pose", pose)):
        kinds = "torch.float32 or torch.float64"
        if not isinstance(tensor, torch.Tensor) or tensor.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"{name} must be a tensor of {kinds}, got {getattr(tensor, 'dtype', None)}")
        if not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"{name} has numbers that are not finite")
    check_pose_shape(c, tuple(pose.shape))
    poses = tuple(pose.shape[:-3])
    if x.ndim != 2 + len(poses) or tuple(x.shape[:-2]) != poses or x.shape[-1] != d:
        letters = f"(p, n, d) = ({poses[0]}, n, {d})" if poses else f"(n, {d})"
        raise ValueError(f"x must be {letters}, got {tuple(x.shape)}")
    model.method.check_mapping(mapping)
    engine: Any = model.engine(mapping)
    if isinstance(engine, SearchEngine):
        return _engine_answer(model, engine, x, pose)
    if hasattr(engine, "device") and not (torch.is_grad_enabled() and (x.requires_grad or pose.requires_grad)):
        return _gpu_answer(model, engine, x, pose)
    frame, as_field = UnitFrame(c, pose), like(model.field)
    x_unit, B = frame.points(x.to(pose)).to(as_field), frame.B.to(as_field)
    center = torch.as_tensor(c.center).to(as_field)
    answers = [model.method.posed(model.field, B[k], mapping)(x_unit[k]) for k in np.ndindex(poses)]
    if not poses:
        return answers[0].in_mesh_units(c.L, center)
    if not answers:  # of no pose
        return Answer(x_unit[..., 0], x_unit[..., 0], x_unit)
    level, distance, x_rest = map(torch.stack, zip(*(answer[:3] for answer in answers), strict=True))
    return Answer(level, distance, x_rest, answers[0].width).in_mesh_units(c.L, center)


def _engine_answer(model: "Model", engine: SearchEngine, x: Tensor, pose: Tensor) -> Answer[Tensor]:
    """The answer of the compiled search at points and in poses whose shapes fit."""
    c, precision = model.character, torch.promote_types(x.dtype, pose.dtype)
    x, pose = (tensor.to("cpu", torch.float64) for tensor in (x, pose))
    frame = UnitFrame(c, pose)
    check_near("x", x, frame.points(x.detach()).detach())
    given = (x, pose, frame.to_unit, frame.B)
    distance, x_rest = _Search.apply(model, engine, *(given if pose.ndim == 4 else (tensor[None] for tensor in given)))
    if pose.ndim == 3:
        distance, x_rest = distance[0], x_rest[0]
    center = torch.as_tensor(c.center)
    level, distance, x_rest, width = Answer(distance, distance, x_rest, engine.width).in_mesh_units(c.L, center)
    return Answer(level.to(precision), distance.to(precision), x_rest.to(precision), width)


def _gpu_answer(model: "Model", engine: "GpuSearch", x: Tensor, pose: Tensor) -> Answer[Tensor]:
    """The answer of a GPU at points and in poses whose shapes fit; nothing waits for it but the checks."""
    frame, x = UnitFrame(model.character, pose.to("cpu", torch.float64)), x.to(engine.device, torch.float64)
    move = frame.to_unit.to(x)
    x_unit = x @ move[..., :-1].mT + move[..., None, :, -1]
    check_near("x", x, x_unit)
    distance, x_rest = (torch.empty(shape, device=x.device) for shape in (x.shape[:-1], x.shape))
    for k in np.ndindex(tuple(pose.shape[:-3])):
        distance[k], x_rest[k] = engine(frame.B[k].numpy()).roots(x_unit[k])
    center = torch.as_tensor(model.character.center).to(x_rest)
    return Answer(distance, distance, x_rest, engine.engine.width).in_mesh_units(model.character.L, center)


class _Outside(NamedTuple):
    """Points of a pose without a canonical point: which they are, and their closest places, in mesh units."""

    which: np.ndarray
    places: ClosestPoints


class _Search(torch.autograd.Function):
    """Distances (p, n) and canonical points (p, n, d) in the unit frame, by the compiled search.

    Poses (p, b, d+1, d+1) are given in mesh units, where the posed skin is, and in the unit frame. Transforms
    (p, d, d+1) move the points (p, n, d) there.
    """

    @staticmethod
    def forward(
        ctx: Any, model: "Model", engine: SearchEngine, x: Tensor, pose: Tensor, to_unit: Tensor, B: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Answers; what `backward` needs is kept."""
        (p, n, d), L = x.shape, model.character.L
        points, poses, moves, unit_poses = (tensor.detach().numpy() for tensor in (x, pose, to_unit, B))
        distance, x_rest = np.empty((p, n)), np.empty((p, n, d), dtype=np.float32)
        outside: dict[int, _Outside] = {}

        def answer(k: int) -> None:
            distance[k], _, x_rest[k], _ = engine(unit_poses[k])(points[k], moves[k])
            which = np.flatnonzero(np.isposinf(distance[k]))
            if len(which):
                places = model.surface_tree.posed(model.skinning.posed(poses[k])).closest(points[k][which])
                distance[k][which] = places.distance / L
                outside[k] = _Outside(which, places)

        each(answer, p)
        ctx.model, ctx.engine, ctx.x_rest, ctx.outside = model, engine, x_rest, outside
        ctx.save_for_backward(x, to_unit, B)
        return torch.from_numpy(distance), torch.from_numpy(x_rest.astype(np.float64))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients by points and poses, of each pose by itself."""
        of_distance, of_x_rest, x, to_unit, B = (tensor.numpy() for tensor in (*gradients, *ctx.saved_tensors))
        d, L = x.shape[-1], ctx.model.character.L
        by_x, by_pose, by_to_unit, by_B = (np.zeros(array.shape) for array in (x, B, to_unit, B))

        def add(k: int) -> None:
            by_x_unit, by_B[k] = root_gradients(ctx.engine, B[k], ctx.x_rest[k], of_distance[k], of_x_rest[k])
            by_x[k] = by_x_unit @ to_unit[k, :, :d]
            # Not by a library, which might add in another order on more threads.
            by_to_unit[k, :, :d], by_to_unit[k, :, d] = np.einsum("ni,nj->ij", by_x_unit, x[k]), by_x_unit.sum(axis=0)
            if k in ctx.outside:
                which, places = ctx.outside[k]
                by_x[k][which], by_pose[k] = ctx.model.skin_gradients(x[k][which], places, of_distance[k][which] / L)

        each(add, len(B))
        return None, None, *(torch.from_numpy(found) for found in (by_x, by_pose, by_to_unit, by_B))


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
