"""The default field: a root search on the forward map, from every part of the body or from the network's answer."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from nilbs.engine.answer import Answer
from nilbs.fields.cramer import cramer
from nilbs.fields.field import Field, PosedField
from nilbs.fields.fixed_point import fixed_point
from nilbs.fields.forward import ForwardField
from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.inverse_map import InverseField
from nilbs.fields.newton import ROOT, ForwardMap, Roots, implicit, newton
from nilbs.fields.overlap import Overlap

# Steps of one search; of the fixed point, which gains the same share in every step and no more.
ITERATIONS, CONTRACTIONS = 6, 20
# In units of the body's longest edge: a start this close to a root finds it again, except in folds.
SAME = 0.02
# In cells of the grid of weights: nodes no farther from the surface than this are starts.
BEYOND = 2.0
# In cells of the grid of weights: how far beside a root in a fold others are searched, on either side.
ASIDE = (1.5, 3.0)


_newton = partial(newton, iterations=ITERATIONS)


@dataclass(frozen=True)
class Search:
    """How roots are searched: where from, and by which iteration."""

    network: bool = False  # from the network's answer
    parts: bool = False  # from every part of the body that lies there
    bones: bool = False  # from every bone's rigid inverse
    iterate: Callable[[Tensor, Tensor, ForwardMap, Tensor], Roots] = _newton


SEARCHES = {
    "search": Search(parts=True),
    "one-search": Search(network=True),
    "all-bones": Search(bones=True),
    "fixed-point": Search(network=True, iterate=partial(fixed_point, iterations=CONTRACTIONS)),
}


class SearchField(Field):
    """Occupancy of a posed character by root search.

    Forward skinning has one weight field for all poses; only its inverse depends on the pose. A posed point is inside
    if forward skinning maps a point of the body there. The network's inverse map (eq. 6) gives a start close to such a
    point, a few steps of Newton's method find it, and the residual, the distance between its forward map and the query,
    decides whether it is a root. Where the body overlaps itself there are several roots, and one inside is enough: the
    search starts again from every part of the body that lies there. Where the body folds, roots lie close together: one
    at which space is turned inside out counts as minus one, and all together usually as one, so that there are two
    others. They are searched on either side of it, along the direction of the fold.

    Parameters
    ----------
    inverse : InverseField
        The network and the rest cache.
    forward_field : ForwardField
        The rest weights.
    forward_network : ForwardNetwork, optional
        If given, the search uses its weights, and those on the grid only give the parts.
    """

    has_distance = True
    has_canonical_points = True
    body: Tensor  # nodes of the forward field in the body and just outside, the deepest first

    def __init__(
        self, inverse: InverseField, forward_field: ForwardField, forward_network: ForwardNetwork | None = None
    ) -> None:
        super().__init__()
        self.inverse, self.forward_field, self.forward_network = inverse, forward_field, forward_network
        places = forward_field.nodes()
        distance = inverse.cache.distance(places.to(inverse.cache.values))
        near = torch.nonzero(distance < BEYOND * forward_field.spacing)[:, 0]
        # The deepest first: a search from them ends inside if any does. Files need not hold what the grids imply.
        self.register_buffer("body", near[torch.argsort(distance[near], stable=True)], persistent=False)

    @property
    def skinning(self) -> ForwardMap:
        """The forward map that searches use."""
        return self.forward_field if self.forward_network is None else self.forward_network

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit (p, n) of occupancy by the inverse map, which is what learns."""
        return self.inverse.logit(x, B)

    def posed(self, B: Tensor, mapping: str = "search", *, ghost: bool = True) -> PosedField:
        """The field in a pose (b, d+1, d+1), by one of its mappings.

        The ghost bone takes part in "inverse" and "reverse" only; in a search the residual decides.
        """
        if mapping in SEARCHES:
            return PosedSearch(self, B, SEARCHES[mapping])
        return self.inverse.posed(B, ghost=ghost, reverse={"inverse": False, "reverse": True}[mapping])


class PosedSearch:
    """A `SearchField` in one pose.

    Attributes
    ----------
    queries, evaluations : int
        Points queried so far, and evaluations of weights for them: look-ups of the forward field, and one of the
        network for each point if the search starts from its answer.
    """

    def __init__(self, field: SearchField, B: Tensor, how: Search) -> None:
        self.field, self.B, self.how = field, B, how
        self.blends = field.skinning.blends(B)
        if how.parts:
            with torch.no_grad():
                grid, body = field.forward_field, field.body
                blends = self.blends if field.forward_network is None else grid.blends(B)
                self.overlap = Overlap(grid.nodes()[body], blends[body], grid.spacing)
        self.queries = self.evaluations = 0

    def __call__(self, x: Tensor) -> Answer:
        """The answer at posed points (n, d)."""
        self.queries += len(x)
        cache = self.field.inverse.cache
        traced = torch.is_grad_enabled() and (x.requires_grad or self.B.requires_grad)
        with torch.set_grad_enabled(traced):
            first = self._first(x)
        with torch.no_grad():
            found = self._search(x, first.detach())
            for start in self._starts(x):
                worth = ~start.isnan().any(dim=-1)
                if self.how.parts:
                    elsewhere = (start - found.x_rest).norm(dim=-1) > SAME
                    worth &= (found.distance >= 0) & (~found.solved | found.inverted | elsewhere)
                going = torch.nonzero(worth)[:, 0]
                self._improve(found, x, going, start[going])
            if self.how.parts:
                folded = torch.nonzero((found.distance >= 0) & found.solved & found.inverted)[:, 0]
                for start in self._beside(found.x_rest[folded]):
                    worth = found.distance[folded] >= 0
                    self._improve(found, x, folded[worth], start[worth])
        root, solved = found.x_rest, found.solved
        if traced:
            root = implicit(x, root, self.field.skinning, self.blends)
        x_rest = torch.where(solved[:, None], root, first)
        # At roots only its derivatives are missing.
        distance = found.distance
        if traced:
            distance = cache.distance(x_rest)
        else:
            distance[~solved] = cache.distance(x_rest[~solved])
        # A point without a canonical point is outside, about as far as the smallest residual.
        distance = torch.where(solved, distance, torch.maximum(distance, found.residual))
        return Answer(distance, distance, x_rest, cache.width)

    def _first(self, x: Tensor) -> Tensor:
        """Starts (n, d) of the first search."""
        if self.how.network:
            self.evaluations += len(x)
            return self.field.inverse.canonical_points(x[None], self.B[None])[0]
        return self._rigid(x, 0) if self.how.bones else x  # the root bone's inverse; the parts follow

    def _starts(self, x: Tensor) -> Iterator[Tensor]:
        """Starts (n, d) of further searches; nan where none is worth it."""
        if self.how.parts:
            yield from self.overlap(x).unbind(1)
        if self.how.bones:
            yield from (self._rigid(x, bone) for bone in range(1, len(self.B)))

    def _rigid(self, x: Tensor, bone: int) -> Tensor:
        """Points mapped by a bone's inverse."""
        d = x.shape[-1]
        inverse = torch.linalg.inv(self.B[bone])
        return x @ inverse[:d, :d].mT + inverse[:d, d]

    def _beside(self, root: Tensor) -> list[Tensor]:
        """Places beside roots (n, d) in folds, on the line on which others lie.

        A fold moves points along one direction, by how much their weights change: what is left of the map without the
        turn of its blend has that direction for the one that it turns around.
        """
        d = root.shape[-1]
        self.evaluations += 2 * len(root)
        skinning = self.field.skinning
        turn, jacobian = skinning.blend(root, self.blends)[..., :d], skinning.pose(root, self.blends).jacobian
        without = [cramer(turn.unbind(-1), column, dim=-1) for column in jacobian.unbind(-1)]
        value, vector = torch.linalg.eig(torch.stack(without, dim=-1))
        turned = torch.where(value.imag.abs() > 1e-6 * value.abs(), torch.inf, value.real).argmin(dim=-1)
        direction = vector.real[torch.arange(len(root), device=root.device), :, turned]
        direction = direction / direction.norm(dim=-1, keepdim=True)
        cells = (side * aside for aside in ASIDE for side in (1, -1))
        return [root + cell * self.field.forward_field.spacing * direction for cell in cells]

    def _improve(self, found: "Found", x: Tensor, going: Tensor, start: Tensor) -> None:
        """Search again for some of the points, and keep what is better: farther inside, or nearer to a root."""
        new = self._search(x[going], start)
        better = new.distance < found.distance[going]
        better |= ~found.solved[going] & (new.residual < found.residual[going])
        for kept, tensor in zip(found, new, strict=True):
            kept[going[better]] = tensor[better]

    def _search(self, x: Tensor, start: Tensor) -> "Found":
        """One search for each point."""
        roots = self.how.iterate(x, start, self.field.skinning, self.blends)
        self.evaluations += roots.evaluations
        distance = self.field.inverse.cache.distance(roots.x_rest)
        distance = torch.where(roots.residual < ROOT, distance, torch.inf)
        return Found(roots.x_rest, distance, roots.residual, roots.inverted)


class Found(NamedTuple):
    """Ends of searches (n, d), distances there (infinite if no root), residuals, and where the map is inverted."""

    x_rest: Tensor
    distance: Tensor
    residual: Tensor
    inverted: Tensor

    @property
    def solved(self) -> Tensor:
        """Whether a root was found."""
        return torch.isfinite(self.distance)
