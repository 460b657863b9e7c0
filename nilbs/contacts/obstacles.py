"""Points that must keep a distance from a posed skin, and how that distance changes while joints turn."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.sparse import csr_array

from nilbs.contacts.joint_changes import JointChanges
from nilbs.engine.surface_tree import PosedSurface, SurfaceTree
from nilbs.geometry.facets import facet_areas, facet_normals
from nilbs.models.model import Model

# Of a facet's size: a place that is nearer has the facet's normal as its way out.
NEAR = 1e-9


class Demands(NamedTuple):
    """Points that must keep a distance from an obstacle; the sign of a distance is negative inside.

    Attributes
    ----------
    frame : (k,) int array
    home : (k, b, d+1) float array
        The posed point is `point` + sum_b B_b home_b: a weight times (x_rest, 1), or zero for a point of the world.
    point : (k, d) float array
    obstacle : (k,) int array
        Which obstacle of an `Obstacles`.
    least : (k,) float array
        The signed distance that is demanded, in mesh units.
    key : (k, 3) int array
        Distinguishes demands of one frame and obstacle.
    """

    frame: np.ndarray
    home: np.ndarray
    point: np.ndarray
    obstacle: np.ndarray
    least: np.ndarray
    key: np.ndarray

    def taken(self, rows: np.ndarray) -> Self:
        """Some of them."""
        return type(self)(*(part[rows] for part in self))

    def among(self, others: Self) -> np.ndarray:
        """Which of them (k,) others hold too."""
        names = np.concatenate([np.column_stack([s.frame, s.obstacle, s.key]) for s in (self, others)])
        number = np.unique(names, axis=0, return_inverse=True)[1].ravel()
        return np.isin(number[: len(self.frame)], number[len(self.frame) :])


def joined(sets: Sequence[Demands]) -> Demands:
    """All demands of several sets; of those with one frame, obstacle and key, the first."""
    every = Demands(*(np.concatenate(parts) for parts in zip(*sets, strict=True)))
    _, first = np.unique(np.column_stack([every.frame, every.obstacle, every.key]), axis=0, return_index=True)
    return every.taken(np.sort(first))


class Gaps(NamedTuple):
    """Signed distances (k,) of demands, and their derivatives (k, b, 1 or 3) by the turns of joints."""

    distance: np.ndarray
    slope: np.ndarray


class _Skin:
    """A skin, or some of its facets, that points keep away from."""

    def __init__(self, model: Model, facets: np.ndarray | None = None) -> None:
        c = model.character
        self.F = c.F if facets is None else c.F[facets]
        self.tree = SurfaceTree(c.V, self.F) if facets is not None else model.surface_tree


class Obstacles:
    """Skins that points keep away from: parts of the moving body, the whole of it, and other bodies.

    Parameters
    ----------
    model : Model
        The body whose joints turn.
    others : sequence of (Model, function)
        Other bodies, and their pose in each frame.
    """

    def __init__(self, model: Model, others: list[tuple[Model, Callable[[int], np.ndarray]]]) -> None:
        self.model, self.others = model, others
        self._skins: list[_Skin] = [_Skin(model), *(_Skin(other) for other, _ in others)]
        self._numbers: dict[bytes, int] = {}
        self._normals = [_NormalsOf(m) for m in (model, *(other for other, _ in others))]
        c = model.character
        self._homes = np.concatenate([c.V, np.ones((len(c.V), 1))], axis=1)

    def part(self, facets: np.ndarray) -> int:
        """The obstacle of some facets of the moving body, by their numbers."""
        name = facets.tobytes()
        if name not in self._numbers:
            self._numbers[name] = len(self._skins)
            self._skins.append(_Skin(self.model, facets))
        return self._numbers[name]

    def posed(self, number: int, U: np.ndarray) -> PosedSurface:
        """An obstacle of the moving body where its vertices are (n, d)."""
        return self._skins[number].tree.posed(U)

    def ways(self, changes: JointChanges, demands: Demands, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances (k,) of points to their obstacles, and unit vectors (k, d) along which they grow."""
        return self._searched(changes, demands, change)[:2]

    def gaps(self, changes: JointChanges, demands: Demands, change: np.ndarray) -> Gaps:
        """How far the demands' points are from their obstacles, where a motion is changed (t, b, 1 or 3)."""
        distance, way, home, B, of = self._searched(changes, demands, change)
        return Gaps(distance, changes.slopes(B, of, home, way))

    def _searched(
        self, changes: JointChanges, demands: Demands, change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Distances, ways out, what moves along them, the poses of all frames, and the pose of each demand."""
        c, d = self.model.character, self.model.character.d
        frames, of = np.unique(demands.frame, return_inverse=True)
        B = changes.turned(frames, change[frames])
        x = demands.point + np.einsum("kbrc,kbc->kr", B[of][..., :d, :], demands.home, optimize=True)
        distance, way, home = np.empty(len(x)), np.empty((len(x), d)), demands.home.copy()
        for f, frame in enumerate(frames.tolist()):
            mine = np.flatnonzero(of == f)
            own = self.model.skinning.posed(B[f])
            own_normals = self._normals[0](own)
            for number in np.unique(demands.obstacle[mine]).tolist():
                rows, skin = mine[demands.obstacle[mine] == number], self._skins[number]
                is_other = 0 < number <= len(self.others)
                if is_other:
                    other, pose = self.others[number - 1]
                    U = other.skinning.posed(pose(frame))
                    normals = self._normals[number](U)
                else:
                    U, normals = own, own_normals
                places = skin.tree.posed(U).closest(x[rows])
                corners = skin.F[places.facet]
                normal = np.einsum("nc,ncd->nd", places.barycentric, normals[corners])
                normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
                away = x[rows] - places.point
                sign = np.where((away * normal).sum(axis=1) < 0, -1.0, 1.0)
                distance[rows] = sign * places.distance
                far = (places.distance > NEAR * c.L)[:, None]
                length = np.where(far, places.distance[:, None], 1.0)
                way[rows] = np.where(far, sign[:, None] * away / length, normal)
                if not is_other:
                    for k in range(d):
                        share = places.barycentric[:, k, None, None] * c.W[corners[:, k], :, None]
                        home[rows] -= share * self._homes[corners[:, k], None]
        return distance, way, home, B, of


class _NormalsOf:
    """Normals of a posed body's vertices, between which those of places vary smoothly over edges."""

    def __init__(self, model: Model) -> None:
        self._F = model.character.F
        m, d = self._F.shape
        shape = (len(model.character.V), m)
        self._sum = csr_array((np.ones(m * d), (self._F.ravel(), np.repeat(np.arange(m), d))), shape=shape)

    def __call__(self, U: np.ndarray) -> np.ndarray:
        found: np.ndarray = self._sum @ np.nan_to_num(facet_normals(U, self._F) * facet_areas(U, self._F)[:, None])
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)
