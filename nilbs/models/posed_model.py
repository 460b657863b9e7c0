"""A model in one pose: asked in mesh units, any number of times and points."""

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.fields.answer import Answer
from nilbs.fields.field import Field, PosedField
from nilbs.fields.search import SearchField
from nilbs.fields.unit_frame import FAR, at_rest, in_unit_frame, rest_center, root_bone, unit_frame
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.rotations import transform_points
from nilbs.geometry.surface import Surface
from nilbs.geometry.validation import arrays

# Points that go through a field at once; bounds the memory of a query of any size.
CHUNK = 16_384
# A distance that changes by less than this share of the way tells nothing of how far the skin is.
LEAST_SLOPE = 0.01


class PosedModel:
    """What a field says of points, for one pose that it is told once.

    Parameters
    ----------
    character : Character
    field : Field
    pose : (b, d+1, d+1) float array
        Bone transforms, rest to posed.
    mapping : str, optional
        One of `nilbs.methods.settings.MAPPINGS`, for a `SearchField`; other fields have no choice.
    ghost : bool
        Whether the ghost bone takes part in the maps "inverse" and "reverse".

    Raises
    ------
    ValueError
        If the pose has another shape, a bone's transform is singular or absurdly far, or the field has no such mapping.
    """

    def __init__(
        self, character: Character, field: Field, pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True
    ) -> None:
        (self.pose,) = arrays(pose=(pose, "b d+1 d+1"))
        self.character, self.field, self.mapping, self.ghost = character, field, mapping, ghost
        wanted = (len(character.skeleton.BE), character.d + 1, character.d + 1)
        if self.pose.shape != wanted:
            raise ValueError(f"pose must be (b, d+1, d+1) = {wanted}, got {self.pose.shape}")
        _, B = in_unit_frame(character, np.zeros((0, character.d)), self.pose)
        self._B = torch.as_tensor(B).to(like(field))

    def occupancy(self, x: np.ndarray) -> np.ndarray:
        """Occupancy (n,) of posed points (n, d): see `Model.occupancy`."""
        return _joined([torch.sigmoid(answer.logit) for answer in self._answers(x)])

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) at rest of posed points (n, d): see `Model.distance`."""
        if not self.field.knows_distance:
            raise ValueError("this model was trained by a method that knows no distance, only occupancy")
        return _joined([answer.distance for answer in self._answers(x)]) * self.character.L

    def rest_points(self, x: np.ndarray) -> np.ndarray:
        """Rest images (n, d) of posed points (n, d): see `Model.rest_points`."""
        self._check_rest_images()
        unit = _joined([answer.x_rest for answer in self._answers(x)])
        return unit * self.character.L + rest_center(self.character)

    def posed_distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) in the posed frame, to first order: see `Model.posed_distance`."""
        (x,) = arrays(x=(x, f"n {self.character.d}"))
        cache, found = searching(self.field).inverse.cache, []
        posed = posed_field(self.field, self._B, self.mapping, ghost=self.ghost)
        # Out of the unit frame, which the root bone may stretch as well.
        out = torch.as_tensor(np.linalg.inv(self.pose[root_bone(self.character), :-1, :-1])).to(like(self.field))
        for chunk in self._chunks(x):
            part = chunk.clone().requires_grad_()
            answer = posed(part)
            (slope,) = torch.autograd.grad(answer.distance.sum(), part)
            x_rest = answer.x_rest.detach().requires_grad_()
            (slope_rest,) = torch.autograd.grad(cache.distance(x_rest).sum(), x_rest)
            length, length_rest = (vector.norm(dim=-1) for vector in (slope @ out, slope_rest))
            told = (length > 0) & (length_rest > LEAST_SLOPE)
            found.append((answer.distance * torch.where(told, length_rest / length, 1.0)).detach())
        return _joined(found) * self.character.L

    def values(self, rest_field: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, outside: float) -> np.ndarray:
        """Values (n, ...) of any field that is known at rest: see `Model.values`."""
        self._check_rest_images()
        answers = list(self._answers(x))
        images = _joined([answer.x_rest for answer in answers]) * self.character.L + rest_center(self.character)
        inside = _joined([answer.logit for answer in answers]) > 0
        found = np.asarray(rest_field(images[inside].astype(np.float64)), dtype=np.float64)
        if found.shape[:1] != (inside.sum(),):
            raise ValueError(f"the rest field must answer {inside.sum()} points, got an array of shape {found.shape}")
        values = np.full((len(inside), *found.shape[1:]), outside)
        values[inside] = found
        return values

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights (n, b+1) that the network predicts for posed points (n, d); the ghost bone's last."""
        inverse = searching(self.field).inverse
        with torch.inference_mode():
            return _joined([inverse(chunk[None], self._B[None]).weights[0] for chunk in self._chunks(x)])

    def posed_points(self, x_rest: np.ndarray) -> np.ndarray:
        """Where forward skinning sends rest points (n, d): see `Model.posed_points`."""
        skinning, c = searching(self.field).skinning, self.character
        (x_rest,) = arrays(x_rest=(x_rest, f"n {c.d}"))
        found = []
        with torch.inference_mode():
            blends = skinning.blends(self._B)
            for start in range(0, max(len(x_rest), 1), CHUNK):
                unit = torch.as_tensor(at_rest(c, x_rest[start : start + CHUNK])).to(like(self.field))
                found.append(skinning.pose(unit, blends).x)
        # Out of the root's frame again.
        moved = _joined(found).astype(np.float64) * c.L + rest_center(c)
        return transform_points(self.pose[root_bone(c)], moved)

    def extract_on(self, grid: Grid, *, stride: int = 4) -> Surface:
        """Surface on a grid, vertices (k, d) and facets (m, d); `stride` 1 asks the field at every node."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
            answers = list(self._answers(x))
            # In mesh units the level is near the signed distance, so that marching cubes' linear interpolation is too.
            level = -_joined([answer.logit for answer in answers]) * self._width * self.character.L
            if not self.field.knows_distance:
                return level, None
            return level, _joined([answer.distance for answer in answers]) * self.character.L

        return field_surface(levels, grid, stride=stride)

    @property
    def lookups(self) -> float | None:
        """Evaluations of the weights of rest points per query so far; None of a method that counts none."""
        queries = getattr(self._posed, "queries", 0)
        return self._posed.evaluations / queries if queries else None  # type: ignore[attr-defined]

    @cached_property
    def _posed(self) -> PosedField:
        with torch.inference_mode():
            return posed_field(self.field, self._B, self.mapping, ghost=self.ghost)

    @property
    def _width(self) -> float:
        return self.field.inverse.cache.width if isinstance(self.field, SearchField) else 1.0

    def _check_rest_images(self) -> None:
        if not self.field.knows_rest_images:
            raise ValueError("this model was trained by a method that knows no rest images of posed points")

    def _answers(self, x: np.ndarray) -> Iterator[Answer]:
        for chunk in self._chunks(x):
            # Not around the yield: who reads the answer is not to be in this mode too.
            with torch.inference_mode():
                answer = self._posed(chunk)
            yield answer

    def _chunks(self, x: np.ndarray) -> Iterator[torch.Tensor]:
        """Points in pieces, in the field's frame."""
        (x,) = arrays(x=(x, f"n {self.character.d}"))
        x_unit, _ = in_unit_frame(self.character, x, self.pose)
        far = np.flatnonzero(~(np.abs(x_unit) < FAR).all(axis=1))
        if len(far):
            raise ValueError(f"x[{far[0]}] = {x[far[0]].tolist()} is {FAR:g} times the character's size away, or more")
        for start in range(0, max(len(x_unit), 1), CHUNK):
            yield torch.as_tensor(x_unit[start : start + CHUNK]).to(like(self.field))


def answer_in_mesh_units(
    character: Character, field: Field, x: torch.Tensor, pose: torch.Tensor, *, mapping: str | None
) -> Answer:
    """Answers of a field at tensors (n, d) in mesh units: see `Model.answer`."""
    b, d = len(character.skeleton.BE), character.d
    for name, tensor, shape in (("x", x, ("n", d)), ("pose", pose, (b, d + 1, d + 1))):
        wanted = f"{name} must be a tensor ({', '.join(map(str, shape))}) of torch.float32 or torch.float64"
        if not isinstance(tensor, torch.Tensor):
            raise ValueError(f"{wanted}, got {type(tensor).__name__}")
        fits = tensor.ndim == len(shape) and all(
            want in ("n", is_) for want, is_ in zip(shape, tensor.shape, strict=True)
        )
        if not fits or tensor.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"{wanted}, got {tuple(tensor.shape)} of {tensor.dtype}")
        if not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"{name} has numbers that are not finite")
    x_unit, B = unit_frame(character, x.to(pose), pose)
    answer = posed_field(field, B.to(like(field)), mapping)(x_unit.to(like(field)))
    L, center = character.L, torch.as_tensor(rest_center(character)).to(like(field))
    return Answer(answer.logit, answer.distance * L, answer.x_rest * L + center)


def posed_field(field: Field, B: torch.Tensor, mapping: str | None, *, ghost: bool = True) -> PosedField:
    """A field in a pose of the unit frame, by one of its mappings where it has any.

    Raises
    ------
    ValueError
        If it has no such mapping.
    """
    if mapping is None:
        return field.posed(B)
    return searching(field).posed(B, mapping, ghost=ghost)


def searching(field: Field) -> SearchField:
    """A field of the method "nilbs".

    Raises
    ------
    ValueError
        If it is of another method.
    """
    if not isinstance(field, SearchField):
        raise ValueError("this model was trained by a method without skinning weights of posed points; use 'nilbs'")
    return field


def like(field: Field) -> torch.Tensor:
    """A tensor of the field's precision, on its device."""
    tensors = (*field.parameters(), *field.buffers())
    return next(tensor for tensor in tensors if tensor.is_floating_point())


def _joined(chunks: list[torch.Tensor]) -> np.ndarray:
    return torch.cat(chunks).cpu().numpy()
