"""Where a posed body meets itself: places in the volume of two of its parts at once."""

from copy import copy
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.sparse import csr_array

from nilbs.contacts.forward_weights import forward_weights
from nilbs.engine.other_roots import other_roots
from nilbs.engine.search import PosedSearch, SearchEngine
from nilbs.engine.unit_frame import at_rest
from nilbs.engine.winding import winding_number
from nilbs.geometry.distance import closest_points
from nilbs.geometry.sampling import uniform_samples
from nilbs.models.model import Model

# Points in the rest volume, how near parts may be at rest, of the longest edge, and how many steps along the skeleton.
SAMPLES, APART, STEPS = 50_000, 0.005, 2
# Winding number above which two sheets of the body cover a place.
TWICE = 1.5


class SelfContacts(NamedTuple):
    """Places where a body overlaps itself.

    Attributes
    ----------
    point : (k, d) float array
        A posed point with two canonical points inside the body, and a winding number above 1.5, in mesh units.
    depth : (k,) float array
        Its distance to the posed skin.
    way_out : (k, d) float array
        From the point to the closest place there.
    x_rest, other : (k, d) float arrays
        Its two canonical points, in mesh units.
    part, other_part : (k,) int arrays
        The bone with the largest weight at each.
    sample : (k,) int array
        Which of the finder's points it is.
    """

    point: np.ndarray
    depth: np.ndarray
    way_out: np.ndarray
    x_rest: np.ndarray
    other: np.ndarray
    part: np.ndarray
    other_part: np.ndarray
    sample: np.ndarray


class SelfContactFinder:
    """Finds where a model meets itself, in any number of poses.

    Parts belong to the bone with the largest weight on the skin that is closest to them. Those that touch at rest or
    are neighbours along the skeleton are exempt: a bent knee is no collision.

    Parameters
    ----------
    model : Model
        Of a method whose compiled engine searches canonical points.
    samples : int
        Points in the rest volume that are followed, of uniform density.
    apart : float
        Parts nearer than this at rest are exempt, as a share of the body's longest edge.
    steps : int
        So are those so many bones from each other along the skeleton, or fewer.
    seed : int
        Of the random number generator that chooses the points.

    Attributes
    ----------
    exempt : (b, b) bool array
        Pairs of bones whose parts may overlap.
    x_rest : (n, d) float array
        The points that are followed.
    part, part_of_facet : (n,) and (m,) int arrays
        The part that each of them, and each facet of the skin, belongs to.

    Raises
    ------
    ValueError
        If the model has no such engine.
    """

    def __init__(
        self, model: Model, *, samples: int = SAMPLES, apart: float = APART, steps: int = STEPS, seed: int = 0
    ) -> None:
        engine = model.engine()
        if not isinstance(engine, SearchEngine):
            raise ValueError(
                "contacts of a body with itself need the compiled search on the processor, "
                f"which the method {model.method.name} has not here"
            )
        c = model.character
        self.model, self.engine = model, engine
        self.x_rest = _inside(c.V, c.F, samples, np.random.default_rng(seed))
        part = c.W.argmax(axis=1)
        self.part_of_facet = sum(c.W[c.F[:, k]] for k in range(c.d)).argmax(axis=1)
        self._rest = model.surface_tree.posed(c.V)
        self.part = self._parts(self.x_rest)
        self.exempt = near_along(c.skeleton.P, steps) | touching(c.V, c.F, part, len(c.skeleton.BE), apart * c.L)

    def __call__(self, pose: np.ndarray) -> SelfContacts:
        """Contacts in a pose (b, d+1, d+1), the deepest first.

        Raises
        ------
        ValueError
            If pose is not (b, d+1, d+1), or as for all queries.
        """
        if np.ndim(pose) != 3:
            raise ValueError(f"pose must be (b, d+1, d+1), got {np.shape(pose)}")
        c, posed = self.model.character, self.model.posed(pose)
        frame = posed.frame
        search = self.engine(frame.B)
        assert isinstance(search, PosedSearch)
        unit = at_rest(c, self.x_rest)
        x = frame.points_back(search.images(unit).astype(np.float64))
        other, _ = other_roots(search, x, frame.to_unit, unit)
        here = np.flatnonzero(~np.isnan(other[:, 0]))
        other = other[here].astype(np.float64) * c.L + c.center
        part, other_part = self.part[here], self._parts(other)
        kept = ~self.exempt[part, other_part]
        # Where the body is folded, a place has two canonical points but is covered once.
        kept[kept] = winding_number(posed.U, c.F, x[here[kept]]) > TWICE
        here, other, part, other_part = here[kept], other[kept], part[kept], other_part[kept]
        places = posed.closest_points(x[here])
        order = np.argsort(-places.distance, kind="stable")
        here = here[order]
        return SelfContacts(
            x[here], places.distance[order], places.point[order] - x[here], self.x_rest[here], other[order],
            part[order], other_part[order], here,
        )  # fmt: skip

    def thinned(self, samples: int) -> Self:
        """A finder of the same that follows the first of the points only: faster and coarser."""
        thin = copy(self)
        thin.__dict__.pop("weights", None)
        thin.x_rest, thin.part = self.x_rest[:samples], self.part[:samples]
        return thin

    @cached_property
    def weights(self) -> csr_array:
        """The weights (n, b) by which the forward map moves the points."""
        return forward_weights(self.model, self.x_rest)

    def _parts(self, x_rest: np.ndarray) -> np.ndarray:
        """The part (n,) of rest points (n, d)."""
        return self.part_of_facet[self._rest.closest(x_rest).facet]


def self_contacts(model: Model, pose: np.ndarray, *, apart: float = APART, steps: int = STEPS) -> SelfContacts:
    """Where a model meets itself in one pose; `SelfContactFinder` does it in many."""
    return SelfContactFinder(model, apart=apart, steps=steps)(pose)


def _inside(V: np.ndarray, F: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """So many points (n, d) inside a surface, of uniform density."""
    corners, found, count = V[F.ravel()], [], 0
    for _ in range(1000):
        x = uniform_samples(corners.min(axis=0), corners.max(axis=0), 4 * n, rng=rng)
        found.append(x[winding_number(V, F, x) > 0.5])
        count += len(found[-1])
        if count >= n:
            return np.concatenate(found)[:n]
    raise ValueError("the body has hardly any volume at rest: no contacts with itself can be found")


def near_along(P: np.ndarray, steps: int) -> np.ndarray:
    """Pairs (b, b) of bones at most so many bones from each other along the skeleton."""
    b = len(P)
    linked = np.eye(b, dtype=bool)
    child = np.flatnonzero(P >= 0)
    linked[child, P[child]] = linked[P[child], child] = True
    near = np.eye(b, dtype=bool)
    for _ in range(steps):
        near = near @ linked
    return near


def touching(V: np.ndarray, F: np.ndarray, part: np.ndarray, b: int, reach: float) -> np.ndarray:
    """Pairs (b, b) of bones whose parts of a skin come within a distance of each other.

    Examples
    --------
    >>> V, F = np.array([[0.0, 0], [1, 0], [1, 0.1], [0, 0.1]]), np.array([[0, 1], [2, 3]])
    >>> touching(V, F, np.array([0, 0, 1, 1]), 2, 0.2).tolist()
    [[False, True], [True, False]]
    """
    found = np.zeros((b, b), dtype=bool)
    middle = V[F].mean(axis=1)
    x, of = np.concatenate([V[np.unique(F)], middle]), np.concatenate([part[np.unique(F)], part[F[:, 0]]])
    for bone in np.unique(part[F]):
        own = F[(part[F] == bone).any(axis=1)]
        corners = V[own.ravel()]
        near = ((x >= corners.min(axis=0) - reach) & (x <= corners.max(axis=0) + reach)).all(axis=1) & (of != bone)
        near = np.flatnonzero(near)
        if len(near):
            distance, _, _ = closest_points(V, own, x[near])
            found[bone, of[near[distance <= reach]]] = True
    return found | found.T
