"""The default field: the network says where to begin, and a root search on the forward field says where to end."""

import torch
from torch import Tensor, nn

from nilbs.fields.answer import Answer
from nilbs.fields.forward import ForwardField
from nilbs.fields.newton import ROOT, implicit, newton
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.overlap import Overlap

# Steps of one search.
ITERATIONS = 6
# In units of the body's longest edge: a start this near to a root that is known finds it again.
SAME = 0.02
# In cells of the grid of weights: nodes no farther from the skin are places to begin from.
BEYOND = 2.0


class SearchField(nn.Module):
    """Occupancy of a posed character by root search.

    Forward skinning has one weight field for all poses; its inverse is what depends on the pose. Whether a posed point
    is inside is whether forward skinning sends a point of the body there. The network's inverse map (eq. 6) tells about
    where such a point is, a few steps of Newton's method find it, and what then is left between its image and the
    query (the residual) tells whether it is one. Where the body overlaps itself there are several, and one inside is
    enough: the search begins again from every part of the body that lies there.

    Parameters
    ----------
    inverse : NilbsField
        The network and the rest cache.
    forward_field : ForwardField
        The rest weights.
    """

    body: Tensor  # nodes of the forward field in the body and just beyond its skin

    def __init__(self, inverse: NilbsField, forward_field: ForwardField) -> None:
        super().__init__()
        self.inverse, self.forward_field = inverse, forward_field
        places = forward_field.nodes()
        near = inverse.cache.distance(places.to(inverse.cache.values)) < BEYOND * forward_field.spacing
        # What the grids tell is not kept in a file a second time.
        self.register_buffer("body", torch.nonzero(near)[:, 0], persistent=False)

    def posed(self, B: Tensor) -> "PosedSearch":
        """The field in a pose, (b, d+1, d+1) rest to posed."""
        return PosedSearch(self, B)


class PosedSearch:
    """A `SearchField` in one pose, to be asked any number of times.

    Attributes
    ----------
    queries, evaluations : int
        Points asked so far, and look-ups of the forward field for them.
    """

    def __init__(self, field: SearchField, B: Tensor) -> None:
        self.field, self.B = field, B
        self.blends = field.forward_field.blends(B)
        with torch.no_grad():
            places = field.forward_field.nodes()[field.body]
            self.overlap = Overlap(places, self.blends[field.body], field.forward_field.spacing)
        self.queries = self.evaluations = 0

    def __call__(self, x: Tensor) -> Answer:
        """Answers at posed points (n, d)."""
        self.queries += len(x)
        field, inverse = self.field, self.field.inverse
        with torch.no_grad():
            first = inverse(x[None], self.B[None])
            root, distance, residual = self._search(x, first.x_rest[0])
            for start in self.overlap(x).unbind(1):
                worth = (distance >= 0) & ~start.isnan().any(dim=-1)
                worth &= torch.isinf(distance) | ((start - root).norm(dim=-1) > SAME)
                going = torch.nonzero(worth)[:, 0]
                found = self._search(x[going], start[going])
                better = found[1] < distance[going]
                better |= torch.isinf(distance[going]) & (found[2] < residual[going])
                for kept, new in zip((root, distance, residual), found, strict=True):
                    kept[going[better]] = new[better]
            solved = torch.isfinite(distance)
        x_rest = torch.where(solved[:, None], root, first.x_rest[0])
        if torch.is_grad_enabled() and (x.requires_grad or self.B.requires_grad):
            traced = inverse(x[None], self.B[None]).x_rest[0]
            x_rest = torch.where(solved[:, None], implicit(x, root, field.forward_field, self.blends), traced)
        distance = inverse.cache.distance(x_rest)
        # A point without a rest image is outside, about as far as the nearest image lies from it.
        distance = torch.where(solved, distance, torch.maximum(distance, residual))
        return Answer(-distance / inverse.cache.width, distance, x_rest)

    def _search(self, x: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Where a search ended, the distance there (infinite if that is no root), and the residual."""
        field = self.field
        root, residual, evaluations = newton(x, start, field.forward_field, self.blends, iterations=ITERATIONS)
        self.evaluations += evaluations
        distance = field.inverse.cache.distance(root)
        return root, torch.where(residual < ROOT, distance, torch.inf), residual
