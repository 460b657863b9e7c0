"""What is too near in the frames of a motion, and the distances that clearing it demands."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nilbs.characters.motion import Motion
from nilbs.contacts.joint_changes import JointChanges
from nilbs.contacts.obstacles import Demands, Obstacles, joined
from nilbs.contacts.pairs import Contacts, contacts, skin_places
from nilbs.contacts.self_contacts import SelfContactFinder, near_along
from nilbs.engine.surface_tree import PosedSurface
from nilbs.geometry.facets import facet_normals
from nilbs.models.model import Model

# Of the depth that is allowed: a contact no deeper than the first is clear; the second is what is demanded.
CLEAR, TARGET = 0.9, 0.8
# More than the distance that is kept, so that it is kept between the places that are searched.
WIDER = 1.1
# Demands of a pair of parts in a frame, and places on a skin.
MOST, PLACES = 6, 4000
# Points that a coarse search follows.
COARSE = 10_000
# Of L: what is nearer to another part is kept from reaching it.
BESIDE = 0.03
# Of a way out's cosine with the mean way out, the least that counts in choosing which part leaves the other.
ALIKE = 0.05
# Cosines of places that face each other: of the way from one to its normal, and of both normals.
FACING, OPPOSED = 0.7, 0.3
_SELF, _MINE, _ITS, _NEAR = range(4)
# The kind of a demand begins its key; of a contact on another body's skin it is this plus the body's number, of a place
# there that is only near it is below zero.
_FIRST_OTHER = 4
# Barycentric coordinates in a key are whole multiples of one over this.
PER_UNIT = 1_000_000


@dataclass(frozen=True)
class Reached:
    """What is in contact in each frame.

    Attributes
    ----------
    count, depth : (t,) int and float arrays
        Places in contact, and how deep the deepest is, in mesh units.
    distance : (t,) float array
        The smallest distance between parts, in mesh units, where one is to be kept, and less the depth in a contact;
        inf where none is near.
    bad : (t,) bool array
        Frames that are not clear.
    found : dict of int to list of (kind, ...) tuples
        What was found in each of them.
    """

    count: np.ndarray
    depth: np.ndarray
    distance: np.ndarray
    bad: np.ndarray
    found: dict[int, list[tuple[Any, ...]]]


class Finders:
    """Finds what is too near in the frames of a motion.

    Parameters
    ----------
    model, motion : Model and Motion
    others : sequence of Model
    depth, distance : float, and float or None
        The deepest contact that is allowed, and the distance that is kept instead, in mesh units.
    finder : SelfContactFinder, optional
    """

    def __init__(
        self,
        model: Model,
        motion: Motion,
        others: Sequence[Model],
        depth: float,
        distance: float | None,
        finder: SelfContactFinder | None,
    ) -> None:
        c = model.character
        self.model, self.motion, self.others = model, motion, list(others)
        self.finder = finder or SelfContactFinder(model)
        self.depth, self.distance = depth, distance
        self.obstacles = Obstacles(model, [(other, self._pose_of(other)) for other in others])
        self._coarse = self.finder.thinned(COARSE)
        self._skin = skin_places(c.V, c.F, samples=PLACES)
        self._skins = [skin_places(o.character.V, o.character.F, samples=PLACES) for o in others]
        self._sides: dict[tuple[int, int, int], int] = {}
        self._linked = near_along(c.skeleton.P, 1)
        self._part = self.finder.part_of_facet[self._skin.facet]

    def _pose_of(self, other: Model) -> Callable[[int], np.ndarray]:
        return lambda frame: other.motion.at(seconds=float(self.motion.times[frame]))

    def reached(
        self, frames: np.ndarray, B: np.ndarray, previous: Reached | None = None, *, coarse: bool = False
    ) -> Reached:
        """What is in contact in some frames (f,), posed (f, b, d+1, d+1); in all others as before.

        A coarse search follows fewer points.
        """
        finder = self._coarse if coarse else self.finder
        t = len(self.motion)
        if previous is None:
            now = Reached(np.zeros(t, dtype=np.int64), np.zeros(t), np.full(t, np.inf), np.zeros(t, dtype=bool), {})
        else:
            p = previous
            now = Reached(p.count.copy(), p.depth.copy(), p.distance.copy(), p.bad.copy(), dict(p.found))
        for frame, pose in zip(frames.tolist(), B, strict=True):
            own = finder(pose)
            count, depth, nearest = len(own.depth), float(own.depth.max(initial=0.0)), np.inf
            found: list[tuple[Any, ...]] = [(_SELF, own)]
            for k, other in enumerate(self.others):
                there = self.obstacles.others[k][1](frame)
                pair = contacts(self.model, pose, other, there, skins=(self._skin, self._skins[k]))
                count, depth = count + len(pair.depth), max(depth, float(pair.depth.max(initial=0.0)))
                found.append((_MINE, k, pair))
            bad = depth > CLEAR * self.depth
            if self.distance is not None:
                near = self._near(frame, pose, WIDER * self.distance)
                nearest = min((float(n[2].min(initial=np.inf)) for n in near), default=np.inf)
                nearest = -depth if count else nearest
                bad = nearest < self.distance
                found += near
            now.count[frame], now.depth[frame], now.distance[frame], now.bad[frame] = count, depth, nearest, bad
            now.found.pop(frame, None)
            if bad:
                now.found[frame] = found
        return now

    def _near(self, frame: int, pose: np.ndarray, reach: float) -> list[tuple[Any, ...]]:
        """Places on the skin that are near to other parts, or to other bodies, and face them; each way."""
        posed, F = self.model.posed(pose), self.model.character.F
        x, normal = self._skin.at(posed.U, F), facet_normals(posed.U, F)[self._skin.facet]
        box = [x.min(axis=0), x.max(axis=0)]
        found: list[tuple[Any, ...]] = []
        for part in np.unique(self._part).tolist():
            mine = np.flatnonzero(self._part == part)
            facets = np.flatnonzero(~self.finder.exempt[part][self.finder.part_of_facet])
            if len(facets):
                number = self.obstacles.part(facets)
                surface = self.obstacles.posed(number, posed.U)
                apart, rows = _facing(surface, posed.U, F[facets], x[mine], normal[mine], reach)
                found.append((_NEAR, number, apart, mine[rows]))
        for k, other in enumerate(self.others):
            there, G = other.posed(self.obstacles.others[k][1](frame)), other.character.F
            apart, rows = _facing(there.surface, there.U, G, x, normal, reach)
            found.append((_NEAR, 1 + k, apart, rows))
            skin = self._skins[k]
            y, outward = skin.at(there.U, G), facet_normals(there.U, G)[skin.facet]
            near = np.flatnonzero(((y > box[0] - reach) & (y < box[1] + reach)).all(axis=1))
            apart, rows = _facing(posed.surface, posed.U, F, y[near], outward[near], reach)
            found.append((_ITS, k, apart, near[rows], y[near[rows]]))
        return found

    def demands(
        self, now: Reached, run: np.ndarray, changes: JointChanges, change: np.ndarray, before: Demands | None,
        *, near: np.ndarray,
    ) -> tuple[Demands, np.ndarray]:  # fmt: skip
        """Demands that clear what was found in frames (f,), and those of before; and which of them were found now (k,).

        In frames `near` also what is only near is kept apart.
        """
        c = self.model.character
        none = np.zeros(0, dtype=np.int64)
        empty = np.zeros((0, c.W.shape[1], c.d + 1)), np.zeros((0, c.d))
        nothing = Demands(none, *empty, none, np.zeros(0), np.zeros((0, 3), dtype=np.int64))
        found = {frame: now.found[frame] for frame in run.tolist() if frame in now.found}
        fresh = [nothing, *self._of_itself(found, changes, change)]
        for frame, entries in found.items():
            fresh += self._of_places(frame, entries)
        more = []
        for frame, pose in zip(near.tolist(), changes.turned(near, change[near]), strict=True):
            reach = max(BESIDE * c.L, WIDER * (self.distance or 0.0))
            more += self._of_places(frame, self._near(frame, pose, reach))
        every = joined([before or nothing, *fresh, *more])
        return every, every.among(joined(fresh))

    def _of_places(self, frame: int, entries: list[tuple[Any, ...]]) -> list[Demands]:
        """Demands of contacts with others, and of places that are near."""
        sets: list[Demands] = []
        # Where overlap is allowed, it is twice as thick as its deepest place is deep.
        least = 2 * self.least if self.distance is None else WIDER * self.distance
        for kind, *rest in entries:
            if kind == _MINE:
                sets += self._of_pair(frame, *rest)
            elif kind == _NEAR:
                number, apart, places = rest
                chosen = _spread(-apart, MOST)
                of_other = 0 < number <= len(self.others)
                sets.append(self._on_skin(frame, places[chosen], number, self.least if of_other else least))
            elif kind == _ITS:
                k, apart, places, y = rest
                chosen = _spread(-apart, 4 * MOST)
                sets.append(self._fixed(frame, y[chosen], k, places[chosen], self.least))
        return sets

    def clear_sides(self, run: np.ndarray) -> None:
        """Choose anew which part leaves which in some frames."""
        frames = set(run.tolist())
        self._sides = {key: side for key, side in self._sides.items() if key[2] not in frames}

    @property
    def least(self) -> float:
        """The distance that is demanded between skins; negative where they may overlap."""
        return -TARGET * self.depth if self.distance is None else self.distance

    def _of_pair(self, frame: int, k: int, pair: Contacts) -> list[Demands]:
        """Demands of contacts with another body: from both sides, since both are searched."""
        deep, sets = pair.depth > TARGET * self.depth if self.distance is None else pair.depth >= 0, []
        mine, its = np.flatnonzero(deep & ~pair.of_b), np.flatnonzero(deep & pair.of_b)
        mine, its = mine[_spread(pair.depth[mine], 4 * MOST)], its[_spread(pair.depth[its], 4 * MOST)]
        c, d = self.model.character, self.model.character.d
        # Two coordinates of a place on a facet decide the third.
        first, second = np.round(pair.barycentric[:, :2].T * PER_UNIT).astype(np.int64)
        keys = np.stack([np.full(len(pair.depth), _MINE), pair.facet, first * (PER_UNIT + 1) + second], axis=1)
        if len(mine):
            home = _homes(c.V, c.F, c.W, pair.facet[mine], pair.barycentric[mine])
            sets.append(self._set(frame, home, np.zeros((len(mine), d)), 1 + k, self.least, keys[mine]))
        if len(its):
            home = np.zeros((len(its), c.W.shape[1], d + 1))
            keys[:, 0] = _FIRST_OTHER + k
            sets.append(self._set(frame, home, pair.point[its], 0, self.least, keys[its]))
        return sets

    def _on_skin(self, frame: int, places: np.ndarray, obstacle: int, least: float) -> Demands:
        c = self.model.character
        home = _homes(c.V, c.F, c.W, self._skin.facet[places], self._skin.barycentric[places])
        keys = np.stack([np.full(len(places), _NEAR), places, places], axis=1)
        return self._set(frame, home, np.zeros((len(places), c.d)), obstacle, least, keys)

    def _fixed(self, frame: int, y: np.ndarray, k: int, places: np.ndarray, least: float) -> Demands:
        c = self.model.character
        keys = np.stack([np.full(len(places), -1 - k), places, places], axis=1)
        return self._set(frame, np.zeros((len(y), c.W.shape[1], c.d + 1)), y, 0, least, keys)

    def _set(
        self, frame: int | np.ndarray, home: np.ndarray, point: np.ndarray, obstacle: int | np.ndarray,
        least: float | np.ndarray, key: np.ndarray,
    ) -> Demands:  # fmt: skip
        k = len(home)
        each = (np.broadcast_to(np.asarray(a), k).copy() for a in (frame, obstacle, least))
        frames, obstacles, leasts = each
        return Demands(frames, home, point, obstacles, leasts.astype(np.float64), key)

    def _of_itself(
        self,
        found: dict[int, list[tuple[Any, ...]]],
        changes: JointChanges,
        change: np.ndarray,
    ) -> list[Demands]:
        """Demands of contacts of the body with itself: of each two parts, one is to leave the other."""
        c = self.model.character
        parts: list[list[np.ndarray]] = []
        for number, entries in found.items():
            own = entries[0][1]
            deep = own.depth > TARGET * self.depth if self.distance is None else own.depth >= 0
            k = int(deep.sum())
            parts.append([np.full(k, number), own.sample[deep], own.part[deep], own.other_part[deep], own.depth[deep]])
        if not sum(len(p[0]) for p in parts):
            return []
        frame, sample, part, other, depth = (np.concatenate(column) for column in zip(*parts, strict=True))
        group = np.unique(np.stack([frame, part, other], axis=1), axis=0, return_inverse=True)[1].ravel()
        kept = np.concatenate([rows[_spread(depth[rows], 4 * MOST)] for rows in _groups(group)])
        frame, sample, part, other, depth, group = (a[kept] for a in (frame, sample, part, other, depth, group))
        obstacle = self._obstacles(part, other, 0)
        W = self.finder.weights[sample].toarray()
        place = np.concatenate([self.finder.x_rest[sample], np.ones((len(sample), 1))], axis=1)
        least = np.full(len(sample), self.least) if self.distance is None else self.least + depth
        key = np.stack([np.full(len(sample), _SELF), sample, other], axis=1)
        home = W[:, :, None] * place[:, None]
        demands = self._set(frame, home, np.zeros((len(sample), c.d)), obstacle, least, key)
        distance, way = self.obstacles.ways(changes, demands, change)
        # Beside the border of an open surface a point inside may seem to lie outside: there more of the skin counts.
        for more in (1, 2):
            left = np.flatnonzero(distance >= least)
            if len(left):
                demands.obstacle[left] = self._obstacles(part[left], other[left], more)
                distance[left], way[left] = self.obstacles.ways(changes, demands.taken(left), change)
        # How far one part must move to leave the other, if it moves along the mean way out.
        need = least - distance
        score: dict[tuple[int, int, int], tuple[float, np.ndarray]] = {}
        for rows in _groups(group):
            wrong = rows[need[rows] > 0]
            if not len(wrong):
                continue
            mean = (need[wrong, None] * way[wrong]).sum(axis=0)
            mean /= max(float(np.linalg.norm(mean)), 1e-300)
            far = float((need[wrong] / np.maximum(way[wrong] @ mean, ALIKE)).max())
            chosen = wrong[_spread(need[wrong], MOST)]
            score[int(frame[rows[0]]), int(part[rows[0]]), int(other[rows[0]])] = far, chosen
        return [demands.taken(self._chosen(score))]

    def _obstacles(self, part: np.ndarray, other: np.ndarray, more: int) -> np.ndarray:
        """The skin (k,) that a place of one part is to leave, where it is in another one.

        It is that of the other and of what may overlap it, without what may overlap the first one; with `more` 1
        without what is linked to the first one only, with `more` 2 all but that.
        """
        near, linked = self.finder.exempt | np.eye(len(self.finder.exempt), dtype=bool), self._linked
        numbers = {}
        for p, o in np.unique(np.stack([part, other], axis=1), axis=0).tolist():
            parts = (near[o] & ~near[p], near[o] & ~linked[p], ~linked[p])[more]
            numbers[p, o] = self.obstacles.part(np.flatnonzero(parts[self.finder.part_of_facet]))
        return np.array([numbers[p, o] for p, o in zip(part.tolist(), other.tolist(), strict=True)])

    def _chosen(self, score: dict[tuple[int, int, int], tuple[float, np.ndarray]]) -> np.ndarray:
        """Rows of the demands of the part of each two that leaves the other, the same in frames that follow."""
        pairs: dict[tuple[int, int], list[int]] = {}
        for frame, p, o in score:
            pairs.setdefault((min(p, o), max(p, o)), []).append(frame)
        chosen = []
        for (p, o), frames in pairs.items():
            frames = sorted(set(frames))
            for run in np.split(np.array(frames), np.flatnonzero(np.diff(frames) > 3) + 1):
                sides = [self._sides[p, o, f] for f in range(run[0] - 3, run[-1] + 4) if (p, o, f) in self._sides]
                if sides:
                    side = max(set(sides), key=sides.count)
                else:
                    # A part that has no place that leaves cannot be the one.
                    far = {
                        a: [score[f, a, z][0] for f in run.tolist() if (f, a, z) in score] for a, z in ((p, o), (o, p))
                    }
                    cost = {a: np.mean(v) if 2 * len(v) > len(run) else np.inf for a, v in far.items()}
                    side = min(cost, key=lambda a: cost[a])
                for f in run.tolist():
                    self._sides[p, o, f] = side
                    for a, z in ((side, p + o - side), (p + o - side, side)):
                        if (f, a, z) in score:
                            chosen.append(score[f, a, z][1])
                            break
        return np.concatenate(chosen) if chosen else np.zeros(0, dtype=np.int64)


def _facing(
    surface: PosedSurface, U: np.ndarray, F: np.ndarray, x: np.ndarray, normal: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distances and rows of the places that a surface is near to and outside of, where the two face each other.

    Of an open surface, whose border is nearest to what lies beside it, that is nothing to keep away from.
    """
    places = surface.closest(x, within=reach)
    rows = np.flatnonzero(places.facet >= 0)
    away, other = x[rows] - places.point[rows], facet_normals(U, F[places.facet[rows]])
    ahead = (away * other).sum(axis=1) > FACING * places.distance[rows]
    rows = rows[ahead & ((normal[rows] * other).sum(axis=1) < -OPPOSED)]
    return places.distance[rows], rows


def _homes(V: np.ndarray, F: np.ndarray, W: np.ndarray, facet: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """For each bone (k, b, d+1), the sum over corners of their shares, weights and (x_rest, 1)."""
    place = np.concatenate([V, np.ones((len(V), 1))], axis=1)
    corners = F[facet]
    return np.einsum("kc,kcb,kcx->kbx", barycentric, W[corners], place[corners], optimize=True)


def _groups(group: np.ndarray) -> list[np.ndarray]:
    """Rows of each group."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def _spread(size: np.ndarray, most: int) -> np.ndarray:
    """At most so many rows: the half of them with the largest values, and others spread over the rest."""
    order = np.argsort(-size, kind="stable")
    if len(order) <= most:
        return order
    rest = np.linspace(most // 2, len(order) - 1, most - most // 2).astype(np.int64)
    return np.concatenate([order[: most // 2], order[rest]])
