"""The NiLBS method: posed point -> weights -> inverse of the blended transform -> rest point -> cached value."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from nilbs.fields.answer import Answer
from nilbs.fields.cache import RestCache
from nilbs.fields.cramer import cramer
from nilbs.fields.field import Field
from nilbs.fields.network import WeightNetwork


class FieldValues(NamedTuple):
    """What the field knows of posed points: all (p, n) but the weights (p, n, b+1) and rest points (p, n, d)."""

    logits: Tensor
    x_rest: Tensor
    distance: Tensor

    @property
    def weights(self) -> Tensor:
        """Skinning weights and, last, the ghost bone's."""
        return torch.softmax(self.logits, dim=-1)

    @property
    def log_solid(self) -> Tensor:
        """Logarithm of 1 - ghost, the factor of eq. 8."""
        bones, ghost = self.logits[..., :-1], self.logits[..., -1]
        rest = torch.logsumexp(bones, dim=-1)
        return nn.functional.logsigmoid(rest - ghost)


class NilbsField(Field):
    """Occupancy of a posed character by the paper's inverse map (eq. 6) and ghost bone (eq. 8).

    Parameters
    ----------
    network : WeightNetwork
        W(x | theta).
    cache : RestCache
        The rest shape.
    root : int
        Bone whose transform the ghost bone copies.
    """

    def __init__(self, network: WeightNetwork, cache: RestCache, *, root: int) -> None:
        super().__init__()
        self.network, self.cache, self.root = network, cache, root

    def forward(self, x: Tensor, B: Tensor, *, reverse: bool = False) -> FieldValues:
        """Weights, rest image and cached distance of posed points.

        Parameters
        ----------
        x : (p, n, d) tensor
            Posed points, n for each pose.
        B : (p, b, d+1, d+1) tensor
            Poses, rest to posed.
        reverse : bool
            Whether the rest image is that of `reverse_map`, not of `inverse_map`.
        """
        logits = self.network(x, B)
        mapped = (reverse_map if reverse else inverse_map)(x, torch.softmax(logits, dim=-1), B, root=self.root)
        return FieldValues(logits, mapped, self.cache.distance(mapped))

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit (p, n) of occupancy, by eq. 8."""
        return self.logit_of(self(x, B))

    def logit_of(self, values: FieldValues, *, ghost: bool = True) -> Tensor:
        """Logit (p, n) of occupancy: positive inside, and smooth where occupancy itself has saturated."""
        inside = -values.distance / self.cache.width
        if not ghost:
            return inside
        # With p = (1 - g) s(z): logit p = log(1 - g) + log s(z) - log(1 - p), and 1 - p = s(-z) + g s(z).
        log_solid = values.log_solid
        log_ghost = torch.log_softmax(values.logits, dim=-1)[..., -1]
        log_outside = torch.logaddexp(nn.functional.logsigmoid(-inside), log_ghost + nn.functional.logsigmoid(inside))
        return log_solid + nn.functional.logsigmoid(inside) - log_outside

    def answer(self, x: Tensor, B: Tensor, *, ghost: bool = True, reverse: bool = False) -> Answer:
        """Answers at points (n, d) of one pose (b, d+1, d+1).

        The distance is the cached one, but positive wherever the ghost bone makes the point one outside.
        """
        values = FieldValues(*(tensor[0] for tensor in self(x[None], B[None], reverse=reverse)))
        logit = self.logit_of(values, ghost=ghost)
        level = -self.cache.width * logit
        distance = torch.where((level > 0) & (values.distance < 0), level, values.distance)
        return Answer(logit, distance, values.x_rest)


def inverse_map(x: Tensor, W: Tensor, B: Tensor, *, root: int) -> Tensor:
    """Rest image of posed points: the inverse of the blended transform, applied to the point (eq. 6).

    Parameters
    ----------
    x : (p, n, d) tensor
        Posed points.
    W : (p, n, b+1) tensor
        Weights, the ghost bone's last; rows sum to one.
    B : (p, b, d+1, d+1) tensor
        Poses, rest to posed.
    root : int
        Bone whose transform the ghost bone copies.

    Returns
    -------
    x_rest : (p, n, d) tensor
        Where the blend is all but singular its determinant is held at 1e-4, which sends the point far away.
    """
    d = x.shape[-1]
    B = torch.cat([B, B[:, root : root + 1]], dim=1)[:, :, :d]
    # One product for all points: rows are the entries of the blend, column by column, so that each lies together.
    blend = B.transpose(2, 3).reshape(len(B), B.shape[1], -1).mT @ W.mT
    columns = blend.reshape(len(B), d + 1, d, -1)
    return cramer(columns[:, :d].unbind(1), x.mT - columns[:, d], dim=1)


def reverse_map(x: Tensor, W: Tensor, B: Tensor, *, root: int) -> Tensor:
    """The blend of the bones' inverses, applied to the point: sum_b W_b B_b^-1 x, which is no inverse of skinning.

    The paper's source keeps it as a comment after eq. 6. It never meets a singular blend, but where bones turn apart it
    shrinks what skinning has shrunk already.

    Parameters
    ----------
    x, W, B, root
        As for `inverse_map`.

    Returns
    -------
    x_rest : (p, n, d) tensor
    """
    d = x.shape[-1]
    B_inverse = torch.linalg.inv(torch.cat([B, B[:, root : root + 1]], dim=1))[:, :, :d]
    blend = (W @ B_inverse.reshape(len(B), B_inverse.shape[1], -1)).unflatten(-1, (d, d + 1))
    return (blend[..., :d] @ x[..., None])[..., 0] + blend[..., d]
