"""A model in one pose or in several, queried in mesh units any number of times."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from nilbs.characters.character import Character
from nilbs.engine.answer import Answer, PosedEngine
from nilbs.engine.closest_search import ClosestPoints
from nilbs.engine.compiled import each
from nilbs.engine.extraction import dense_surface, surface_near
from nilbs.engine.surface_tree import PosedSurface
from nilbs.engine.unit_frame import FAR, UnitFrame, at_rest
from nilbs.geometry.extraction import field_surface
from nilbs.geometry.facets import facet_normals
from nilbs.geometry.grids import Grid
from nilbs.geometry.surface import Surface
from nilbs.geometry.validation import arrays

if TYPE_CHECKING:
    from nilbs.models.model import Model
    from nilbs.models.torch_field import TorchEngine

# In units of L: how far from the posed skin every piece of a surface has a place, and how far from the field's zero set
# vertices may be. Only specks where no root is found lie farther from the skin than a thousandth.
REACH, TOLERANCE = 0.006, 1e-6
Result = TypeVar("Result")
# Of a pose among several; () is that of the only one.
Index = tuple[int, ...]


class PosedModel:
    """A model in one pose or in p poses; its methods are described at those of `Model`.

    In one pose, what the pose takes is computed once. In several it is computed in every query, pose by pose, on all
    threads, and not kept: it may be large.

    Parameters
    ----------
    model : Model
    pose : (b, d+1, d+1) or (p, b, d+1, d+1) float array
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
        (pose,) = arrays(pose=(pose, "p b d+1 d+1" if np.ndim(pose) == 4 else "b d+1 d+1"))
        check_pose_shape(model.character, pose.shape)
        self.model, self.character, self.pose = model, model.character, np.array(pose)
        self.mapping, self.ghost = mapping, ghost
        self.frame = UnitFrame(model.character, self.pose)
        self._engine = model.engine(mapping)
        self._source: Any = self._engine or model.field
        self._poses: list[Index] = list(np.ndindex(pose.shape[:-3]))

    def occupancy(self, x: np.ndarray) -> np.ndarray:
        """Occupancy (n,) of posed points (n, d), or (p, n) of (p, n, d)."""
        return self._answer(x).occupancy

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance at the canonical points of posed points."""
        return self._completed(x, self._answer(x).distance)

    def posed_distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance to the posed skin."""
        inside = self._answer(x).level < 0
        x = self._points(x)
        length = self._joined(self._in_each(lambda k: self._surface_in(k).distance(x[k])), x.shape[:-1])
        return np.where(inside, -length, length)

    def closest_points(self, x: np.ndarray) -> ClosestPoints:
        """Closest places on the posed skin."""
        x = self._points(x)
        found = self._in_each(lambda k: self._surface_in(k).closest(x[k]))
        shapes = (x.shape[:-1], x.shape[:-1], x.shape, x.shape)
        parts = zip(*found, strict=True) if found else [()] * len(shapes)
        return ClosestPoints(*(self._joined(part, shape) for part, shape in zip(parts, shapes, strict=True)))

    def closest_places(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Closest places on the posed skin, by name.

        Signed `distance` (n,) in mesh units, with the field's sign, `facet` (n,), `barycentric` (n, d), `point` (n, d)
        and the outward unit `normal` (n, d) of the facet; of points (p, n, d) arrays (p, n) and (p, n, d).
        """
        found = self.closest_points(x)
        distance = np.where(self._answer(x).level < 0, -found.distance, found.distance)
        normals = [facet_normals(self.U[k], self.character.F)[found.facet[k]] for k in self._poses]
        return {**found._asdict(), "distance": distance, "normal": self._joined(normals, found.point.shape)}

    def rest_points(self, x: np.ndarray) -> np.ndarray:
        """Canonical points (n, d) of posed points (n, d), or (p, n, d) of (p, n, d)."""
        self._check_canonical_points()
        return self._at_rest(self._answer(x))

    def values(self, rest_field: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, outside: float) -> np.ndarray:
        """Values (n, ...) or (p, n, ...) of any field of the rest pose at the canonical points of posed points."""
        self._check_canonical_points()
        answer = self._answer(x)
        inside = answer.level < 0
        x_rest = self._at_rest(answer)[inside].astype(np.float64)
        found = np.asarray(rest_field(x_rest), dtype=np.float64)
        if found.shape[:1] != (len(x_rest),):
            raise ValueError(f"the rest field must have values at {len(x_rest)} points, got an array {found.shape}")
        values = np.full((*inside.shape, *found.shape[1:]), outside)
        values[inside] = found
        return values

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights (n, b+1) or (p, n, b+1) that the network predicts for posed points; the ghost bone's last."""
        from nilbs.models.torch_field import predicted_weights

        x_unit = self.frame.points(self._near_points(x))
        found = [predicted_weights(self.model, self.frame.B[k], x_unit[k]) for k in self._poses]
        return self._joined(found, (*x_unit.shape[:-1], len(self.character.skeleton.BE) + 1))

    def posed_points(self, x_rest: np.ndarray) -> np.ndarray:
        """Images (n, d) of rest points (n, d), or (p, n, d) of (p, n, d), under forward skinning."""
        x_rest = self._points(x_rest, name="x_rest")
        unit = at_rest(self.character, x_rest)
        check_near("x_rest", x_rest, unit)
        found = self._joined(self._in_each(lambda k: self._images_in(k, unit[k])), unit.shape)
        return self.frame.points_back(found.astype(np.float64))

    def extract_on(self, grid: Grid, *, stride: int = 4, polish: bool = True) -> Surface:
        """Surface on a grid; with `stride` 1 the field is evaluated at every node.

        Where the engine searches roots, vertices are within a millionth of the body's longest edge of a change of sign,
        but for about one in a thousand, where levels jump or hardly change; without `polish`, and for other methods,
        they are where levels interpolated between nodes are zero.
        """
        if not getattr(self._source, "near_skin", False):
            return field_surface(self._levels, grid, stride=stride)
        tolerance = TOLERANCE * self.character.L if polish else None
        if self.character.d == 2 or stride == 1:
            return dense_surface(self._levels, grid, stride=stride, tolerance=tolerance)
        levels, c = (lambda x: self._levels(x)[0]), self.character
        return surface_near(self.U, c.F, levels, grid, reach=REACH * c.L, tolerance=tolerance)

    def _levels(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Levels (n,), negative inside, and distances; in mesh units where they are lengths."""
        answer = self._answer(x)
        if not self._source.has_distance:
            return answer.level * self.character.L, None
        distance = self._completed(x, answer.distance)
        return np.where(np.isfinite(answer.level), answer.level * self.character.L, distance), distance

    @property
    def lookups(self) -> float | None:
        """Evaluations of the weights of rest points per query so far, in one pose; None where they are not counted."""
        if self.pose.ndim == 4:
            return None
        posed: Any = self._posed
        queries = getattr(posed, "queries", 0)
        return posed.evaluations / queries if queries else None

    @cached_property
    def U(self) -> np.ndarray:
        """Posed vertices (n, d), or (p, n, d)."""
        found = [self.model.skinning.posed(self.pose[k]) for k in self._poses]
        return self._joined(found, (*self.pose.shape[:-3], *self.character.V.shape))

    @cached_property
    def surface(self) -> PosedSurface:
        """The posed mesh, for closest points, in one pose."""
        return self.model.surface_tree.posed(self.U)

    @cached_property
    def _posed(self) -> "PosedEngine | TorchEngine":
        """What answers in one pose."""
        return self._query_in(())

    def _posed_in(self, k: Index) -> "PosedEngine | TorchEngine":
        """What answers in a pose."""
        return self._posed if k == () else self._query_in(k)

    def _query_in(self, k: Index) -> "PosedEngine | TorchEngine":
        if self._engine is not None:
            return self._engine(self.frame.B[k])
        from nilbs.models.torch_field import TorchEngine

        return TorchEngine(self.model.method, self.model.field, self.frame.B[k], self.mapping, ghost=self.ghost)

    def _surface_in(self, k: Index) -> PosedSurface:
        """The mesh in a pose."""
        return self.surface if k == () else self.model.surface_tree.posed(self.model.skinning.posed(self.pose[k]))

    def _images_in(self, k: Index, x_rest: np.ndarray) -> np.ndarray:
        """Images of rest points in a pose, all in the unit frame."""
        if self._engine is not None and hasattr(posed := self._posed_in(k), "images"):
            return posed.images(x_rest)
        from nilbs.models.torch_field import images

        return images(self.model, self.frame.B[k], x_rest)

    def _in_each(self, query: Callable[[Index], Result]) -> list[Result]:
        """What a query returns in each pose: on all threads, but for torch, which has threads of its own."""
        if self._engine is None:
            return [query(k) for k in self._poses]
        found: dict[int, Result] = {}
        each(lambda i: found.update({i: query(self._poses[i])}), len(self._poses))
        return [found[i] for i in range(len(found))]

    def _joined(self, parts: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
        """One array of the arrays of all poses."""
        return parts[0] if self.pose.ndim == 3 else np.array(parts).reshape(shape)

    def _points(self, x: np.ndarray, *, name: str = "x") -> np.ndarray:
        """Checked points (n, d) or (p, n, d)."""
        d = self.character.d
        if self.pose.ndim == 3:
            (x,) = arrays(**{name: (x, f"n {d}")})
        else:
            _, x = arrays(pose=(self.pose, "p b d+1 d+1"), **{name: (x, "p n d")})
        return x

    def _near_points(self, x: np.ndarray) -> np.ndarray:
        """Checked points that single precision holds in the unit frame."""
        x = self._points(x)
        to_unit = np.abs(self.frame.to_unit).sum(axis=-1).max(initial=0)
        if not to_unit * max(x.max(initial=1), -x.min(initial=-1)) < FAR:  # no bound for all: each by itself
            check_near("x", x, self.frame.points(x))
        return x

    def _answer(self, x: np.ndarray) -> Answer[np.ndarray]:
        """The answer in the unit frame; inf is the level of a point without a canonical point that no one asked for."""
        x = self._near_points(x)
        to_unit = self.frame.to_unit
        found = self._in_each(lambda k: self._posed_in(k)(x[k], to_unit[k]))
        level = self._joined([answer.level for answer in found], x.shape[:-1])
        distance = self._joined([answer.distance for answer in found], x.shape[:-1])
        x_rest = self._joined([answer.x_rest for answer in found], x.shape)
        return Answer(level, distance, x_rest, *(answer.width for answer in found[:1]))

    def _completed(self, x: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Distances in mesh units; to the posed skin where there is no canonical point."""
        if not self._source.has_distance:
            raise ValueError(f"the method {self.model.method.name} has no distance, only occupancy")
        x, distance = self._points(x), distance * self.character.L

        def complete(k: Index) -> None:
            missing = np.flatnonzero(np.isposinf(distance[k]))
            if len(missing):
                distance[k][missing] = self._surface_in(k).distance(x[k][missing])

        self._in_each(complete)
        return distance

    def _check_canonical_points(self) -> None:
        if not self._source.has_canonical_points:
            raise ValueError(f"the method {self.model.method.name} has no canonical points of posed points")

    def _at_rest(self, answer: Answer[np.ndarray]) -> np.ndarray:
        return answer.x_rest * self.character.L + self.character.center


def check_near(name: str, x: Any, x_unit: Any) -> None:
    """Raise ValueError if a point of an array or a tensor is very far away in the unit frame."""
    far = ~(abs(x_unit) < FAR).all(-1)
    if bool(far.any()):
        i = np.argwhere(np.asarray(far.cpu() if hasattr(far, "cpu") else far))[0].tolist()
        raise ValueError(f"{name}{i} = {x[tuple(i)].tolist()} is {FAR:g} times the character's size away, or more")


def check_pose_shape(character: Character, shape: tuple[int, ...]) -> None:
    """Raise ValueError if a pose does not have one transform for each bone; there may be several poses."""
    expected = (len(character.skeleton.BE), character.d + 1, character.d + 1)
    if tuple(shape[-3:]) != expected or len(shape) not in (3, 4):
        several = ("(p, b, d+1, d+1)", f"(p, {', '.join(map(str, expected))})")
        letters, numbers = several if len(shape) == 4 else ("(b, d+1, d+1)", str(expected))
        raise ValueError(f"pose must be {letters} = {numbers}, got {tuple(shape)}")
