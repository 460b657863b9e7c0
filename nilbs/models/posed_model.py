"""A model in one pose, queried in mesh units any number of times."""

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from nilbs.characters.character import Character
from nilbs.engine.answer import Answer, PosedEngine
from nilbs.engine.surface_tree import ClosestPoints, PosedSurface
from nilbs.engine.unit_frame import FAR, UnitFrame, at_rest, rest_center
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.facets import facet_normals
from nilbs.geometry.grids import Grid
from nilbs.geometry.surface import Surface
from nilbs.geometry.validation import arrays

if TYPE_CHECKING:
    from nilbs.models.model import Model
    from nilbs.models.torch_field import TorchEngine


class PosedModel:
    """A model in one pose; its methods are described at those of `Model`.

    Parameters
    ----------
    model : Model
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

    def __init__(self, model: "Model", pose: np.ndarray, *, mapping: str | None = None, ghost: bool = True) -> None:
        model.method.check_mapping(mapping)
        (pose,) = arrays(pose=(pose, "b d+1 d+1"))
        check_pose_shape(model.character, pose.shape)
        self.model, self.character, self.pose = model, model.character, np.array(pose)
        self.mapping, self.ghost = mapping, ghost
        self.frame = UnitFrame(model.character, self.pose)
        self._engine = model.engine(mapping)
        self._source: Any = self._engine or model.field

    def occupancy(self, x: np.ndarray) -> np.ndarray:
        """Occupancy (n,) of posed points (n, d)."""
        return self._answer(x).occupancy

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) at the canonical points of posed points (n, d)."""
        return self._completed(x, self._answer(x).distance)

    def posed_distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance (n,) to the posed skin."""
        inside = self._answer(x).level < 0
        length = self.closest_points(x).distance
        return np.where(inside, -length, length)

    def closest_points(self, x: np.ndarray) -> ClosestPoints:
        """Closest places on the posed skin."""
        return self.surface.closest(self._points(x))

    def closest_places(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Closest places on the posed skin, by name.

        Signed `distance` (n,) in mesh units, with the field's sign, `facet` (n,), `barycentric` (n, d), `point` (n, d)
        and the outward unit `normal` (n, d) of the facet.
        """
        found = self.closest_points(x)
        distance = np.where(self._answer(x).level < 0, -found.distance, found.distance)
        normal = facet_normals(self.U, self.character.F)[found.facet]
        return {**found._asdict(), "distance": distance, "normal": normal}

    def rest_points(self, x: np.ndarray) -> np.ndarray:
        """Canonical points (n, d) of posed points (n, d)."""
        self._check_canonical_points()
        return self._at_rest(self._answer(x))

    def values(self, rest_field: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, outside: float) -> np.ndarray:
        """Values (n, ...) of any field of the rest pose at the canonical points of posed points (n, d)."""
        self._check_canonical_points()
        answer = self._answer(x)
        inside = answer.level < 0
        x_rest = self._at_rest(answer)[inside].astype(np.float64)
        found = np.asarray(rest_field(x_rest), dtype=np.float64)
        if found.shape[:1] != (len(x_rest),):
            raise ValueError(f"the rest field must have values at {len(x_rest)} points, got an array {found.shape}")
        values = np.full((len(inside), *found.shape[1:]), outside)
        values[inside] = found
        return values

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights (n, b+1) that the network predicts for posed points (n, d); the ghost bone's last."""
        from nilbs.models.torch_field import predicted_weights

        return predicted_weights(self.model, self.frame.B, self.frame.points(self._near_points(x)))

    def posed_points(self, x_rest: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d) under forward skinning."""
        (x_rest,) = arrays(x_rest=(x_rest, f"n {self.character.d}"))
        unit = at_rest(self.character, x_rest)
        _check_near("x_rest", x_rest, unit)
        if self._engine is not None and hasattr(self._posed, "images"):
            return self.frame.points_back(self._posed.images(unit).astype(np.float64))
        from nilbs.models.torch_field import images

        return self.frame.points_back(images(self.model, self.frame.B, unit))

    def extract_on(self, grid: Grid, *, stride: int = 4) -> Surface:
        """Surface on a grid; with `stride` 1 the field is evaluated at every node."""

        def levels(x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
            answer = self._answer(x)
            if not self._source.has_distance:
                return answer.level * self.character.L, None
            distance = self._completed(x, answer.distance)
            level = np.where(np.isfinite(answer.level), answer.level * self.character.L, distance)
            return level, distance

        return field_surface(levels, grid, stride=stride)

    @property
    def lookups(self) -> float | None:
        """Evaluations of the weights of rest points per query so far; None if the method does not count them."""
        posed: Any = self._posed
        queries = getattr(posed, "queries", 0)
        return posed.evaluations / queries if queries else None

    @cached_property
    def U(self) -> np.ndarray:
        """Posed vertices (n, d)."""
        return self.model.skinning.posed(self.pose)

    @cached_property
    def surface(self) -> PosedSurface:
        """The posed mesh, for closest points."""
        return self.model.surface_tree.posed(self.U)

    @cached_property
    def _posed(self) -> "PosedEngine | TorchEngine":
        if self._engine is not None:
            return self._engine(self.frame.B)
        from nilbs.models.torch_field import TorchEngine

        return TorchEngine(self.model.method, self.model.field, self.frame.B, self.mapping, ghost=self.ghost)

    def _points(self, x: np.ndarray) -> np.ndarray:
        """Checked points (n, d)."""
        (x,) = arrays(x=(x, f"n {self.character.d}"))
        return x

    def _answer(self, x: np.ndarray) -> Answer[np.ndarray]:
        """The answer in the unit frame; inf is the level of a point without a canonical point that no one asked for."""
        return self._posed(self._near_points(x), self.frame.to_unit)

    def _near_points(self, x: np.ndarray) -> np.ndarray:
        """Checked points (n, d) that single precision holds in the unit frame."""
        x = self._points(x)
        _check_near("x", x, self.frame.points(x))
        return x

    def _completed(self, x: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Distances in mesh units; to the posed skin where there is no canonical point."""
        if not self._source.has_distance:
            raise ValueError(f"the method {self.model.method.name} has no distance, only occupancy")
        distance = distance * self.character.L
        missing = np.flatnonzero(np.isposinf(distance))
        if len(missing):
            distance[missing] = self.closest_points(self._points(x)[missing]).distance
        return distance

    def _check_canonical_points(self) -> None:
        if not self._source.has_canonical_points:
            raise ValueError(f"the method {self.model.method.name} has no canonical points of posed points")

    def _at_rest(self, answer: Answer[np.ndarray]) -> np.ndarray:
        return answer.x_rest * self.character.L + rest_center(self.character)


def _check_near(name: str, x: np.ndarray, x_unit: np.ndarray) -> None:
    """Raise ValueError if a point is very far away in the unit frame."""
    far = ~(np.abs(x_unit) < FAR).all(axis=-1)
    if far.any():
        i = int(np.flatnonzero(far)[0])
        raise ValueError(f"{name}[{i}] = {x[i].tolist()} is {FAR:g} times the character's size away, or more")


def check_pose_shape(character: Character, shape: tuple[int, ...]) -> None:
    """Raise ValueError if a pose does not have one transform for each bone."""
    expected = (len(character.skeleton.BE), character.d + 1, character.d + 1)
    if tuple(shape) != expected:
        raise ValueError(f"pose must be (b, d+1, d+1) = {expected}, got {tuple(shape)}")
