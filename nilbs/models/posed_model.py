"""A model in one pose, queried in mesh units any number of times."""

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from nilbs.characters.character import Character
from nilbs.engine.answer import Answer
from nilbs.fields.field import Field, PosedField, like
from nilbs.fields.search import SearchField
from nilbs.engine.unit_frame import FAR, UnitFrame, at_rest, rest_center
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.grids import Grid
from nilbs.geometry.surface import Surface
from nilbs.geometry.validation import arrays
from nilbs.methods.base import Method

# Points that go through a field at once; bounds the memory of a query of any size.
CHUNK = 16_384
# A distance that changes by less than this share of the way has no reliable slope.
LEAST_SLOPE = 0.01


class PosedModel:
    """A field in one pose; its methods are described at those of `Model`.

    Parameters
    ----------
    character : Character
    method : Method
    field : Field
        Of that method.
    pose : (b, d+1, d+1) float array
        Bone transforms, rest to posed.
    mapping : str, optional
        One of the method's mappings; by default its own.
    ghost : bool
        Whether the ghost bone takes part in the mappings "inverse" and "reverse".

    Raises
    ------
    ValueError
        If the pose has another shape, a bone's transform is singular or very far, or the method has no such mapping.
    """

    def __init__(
        self,
        character: Character,
        method: Method,
        field: Field,
        pose: np.ndarray,
        *,
        mapping: str | None = None,
        ghost: bool = True,
    ) -> None:
        method.check_mapping(mapping)
        (pose,) = arrays(pose=(pose, "b d+1 d+1"))
        check_pose_shape(character, pose.shape)
        self.character, self.method, self.field, self.mapping, self.ghost = character, method, field, mapping, ghost
        self.frame = UnitFrame(character, torch.from_numpy(np.array(pose)))
        self._B = self.frame.B.to(like(field))

    def occupancy(self, x: np.ndarray) -> np.ndarray:
        """Occupancy (n,) of posed points (n, d)."""
        return _joined([answer.occupancy for answer in self._answers(x)])

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) at the canonical points of posed points (n, d)."""
        if not self.field.has_distance:
            raise ValueError(f"the method {self.method.name} has no distance, only occupancy")
        return _joined([answer.distance for answer in self._answers(x)]) * self.character.L

    def rest_points(self, x: np.ndarray) -> np.ndarray:
        """Canonical points (n, d) of posed points (n, d)."""
        self._check_canonical_points()
        return self._at_rest([answer.x_rest for answer in self._answers(x)])

    def posed_distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) in the posed frame, to first order."""
        cache, found = self._searching.inverse.cache, []
        out = self.frame.turn_back.to(self._B)  # of the unit frame, which the root bone may stretch as well
        posed = self.method.posed(self.field, self._B, self.mapping, ghost=self.ghost)
        for chunk in self._chunks(x):
            part = chunk.clone().requires_grad_()
            answer = posed(part)
            (slope,) = torch.autograd.grad(answer.distance.sum(), part)
            x_rest = answer.x_rest.detach().requires_grad_()
            (slope_rest,) = torch.autograd.grad(cache.distance(x_rest).sum(), x_rest)
            length, length_rest = (vector.norm(dim=-1) for vector in (slope @ out, slope_rest))
            reliable = (length > 0) & (length_rest > LEAST_SLOPE)
            found.append((answer.distance * torch.where(reliable, length_rest / length, 1.0)).detach())
        return _joined(found) * self.character.L

    def values(self, rest_field: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, outside: float) -> np.ndarray:
        """Values (n, ...) of any field of the rest pose at the canonical points of posed points (n, d)."""
        self._check_canonical_points()
        answers = list(self._answers(x))
        inside = _joined([answer.level for answer in answers]) < 0
        x_rest = self._at_rest([answer.x_rest for answer in answers])[inside].astype(np.float64)
        found = np.asarray(rest_field(x_rest), dtype=np.float64)
        if found.shape[:1] != (len(x_rest),):
            raise ValueError(f"the rest field must have values at {len(x_rest)} points, got an array {found.shape}")
        values = np.full((len(inside), *found.shape[1:]), outside)
        values[inside] = found
        return values

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights (n, b+1) that the network predicts for posed points (n, d); the ghost bone's last."""
        inverse = self._searching.inverse
        with torch.inference_mode():
            return _joined([inverse.weights(chunk[None], self._B[None])[0] for chunk in self._chunks(x)])

    def posed_points(self, x_rest: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d) under forward skinning."""
        skinning, c = self._searching.skinning, self.character
        (x_rest,) = arrays(x_rest=(x_rest, f"n {c.d}"))
        unit = torch.as_tensor(at_rest(c, x_rest)).to(self._B)
        with torch.inference_mode():
            blends = skinning.blends(self._B)
            posed = torch.cat([skinning.pose(chunk, blends).x for chunk in unit.split(CHUNK)])
            return self.frame.points_back(posed.cpu().double()).numpy()

    def extract_on(self, grid: Grid, *, stride: int = 4) -> Surface:
        """Surface on a grid; with `stride` 1 the field is evaluated at every node."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
            answers = list(self._answers(x))
            level = _joined([answer.level for answer in answers]) * self.character.L
            if not self.field.has_distance:
                return level, None
            return level, _joined([answer.distance for answer in answers]) * self.character.L

        return field_surface(levels, grid, stride=stride)

    @property
    def lookups(self) -> float | None:
        """Evaluations of the weights of rest points per query so far; None if the method does not count them."""
        queries = getattr(self._posed, "queries", 0)
        return self._posed.evaluations / queries if queries else None  # type: ignore[attr-defined]

    @cached_property
    def _posed(self) -> PosedField:
        with torch.inference_mode():
            return self.method.posed(self.field, self._B, self.mapping, ghost=self.ghost)

    @property
    def _searching(self) -> SearchField:
        if not isinstance(self.field, SearchField):
            raise ValueError(
                f"the method {self.method.name} has no skinning weights of posed points; nilbs and paper have"
            )
        return self.field

    def _check_canonical_points(self) -> None:
        if not self.field.has_canonical_points:
            raise ValueError(f"the method {self.method.name} has no canonical points of posed points")

    def _at_rest(self, chunks: list[Tensor]) -> np.ndarray:
        return _joined(chunks) * self.character.L + rest_center(self.character)

    def _answers(self, x: np.ndarray) -> Iterator[Answer]:
        for chunk in self._chunks(x):
            # Not around the yield: the reader of the answer must not be in this mode.
            with torch.inference_mode():
                answer = self._posed(chunk)
            yield answer

    def _chunks(self, x: np.ndarray) -> Iterator[Tensor]:
        """Points in the unit frame, piece by piece."""
        (x,) = arrays(x=(x, f"n {self.character.d}"))
        x_unit = self.frame.points(torch.from_numpy(np.array(x)))
        far = torch.nonzero(~(x_unit.abs() < FAR).all(dim=-1))
        if len(far):
            i = int(far[0])
            raise ValueError(f"x[{i}] = {x[i].tolist()} is {FAR:g} times the character's size away, or more")
        yield from x_unit.to(like(self.field)).split(CHUNK)


def check_pose_shape(character: Character, shape: tuple[int, ...]) -> None:
    """Raise ValueError if a pose does not have one transform for each bone."""
    expected = (len(character.skeleton.BE), character.d + 1, character.d + 1)
    if tuple(shape) != expected:
        raise ValueError(f"pose must be (b, d+1, d+1) = {expected}, got {tuple(shape)}")


def _joined(chunks: list[Tensor]) -> np.ndarray:
    return torch.cat(chunks).cpu().numpy()
