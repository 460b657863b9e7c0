"""The paper's inverse map: posed point -> weights -> inverse of the blended transform -> canonical point -> cache."""

import torch
from torch import Tensor, nn

from nilbs.engine.answer import Answer
from nilbs.fields.cache import RestCache
from nilbs.fields.cramer import cramer
from nilbs.fields.field import Field, PosedField
from nilbs.fields.network import WeightNetwork


class InverseField(Field):
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

    has_distance = True
    has_canonical_points = True

    def __init__(self, network: WeightNetwork, cache: RestCache, *, root: int) -> None:
        super().__init__()
        self.network, self.cache, self.root = network, cache, root

    def weights(self, x: Tensor, B: Tensor) -> Tensor:
        """Skinning weights (p, n, b+1), the ghost bone's last, of points (p, n, d) in poses (p, b, d+1, d+1)."""
        return torch.softmax(self.network(x, B), dim=-1)

    def canonical_points(self, x: Tensor, B: Tensor) -> Tensor:
        """Canonical points (p, n, d) of points (p, n, d) in poses (p, b, d+1, d+1)."""
        return inverse_map(x, self.weights(x, B), B, root=self.root)

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit (p, n) of occupancy, by eq. 8."""
        weight_logits = self.network(x, B)
        x_rest = inverse_map(x, torch.softmax(weight_logits, dim=-1), B, root=self.root)
        return ghost_logit(-self.cache.distance(x_rest) / self.cache.width, weight_logits)

    def posed(self, B: Tensor, *, ghost: bool = True, reverse: bool = False) -> PosedField:
        """The field in a pose (b, d+1, d+1), with or without the ghost bone, by `inverse_map` or `reverse_map`.

        The distance is the cached one, but positive wherever the ghost bone makes the point one outside.
        """
        poses, to_rest = B[None], reverse_map if reverse else inverse_map

        def answer(x: Tensor) -> Answer:
            weight_logits = self.network(x[None], poses)
            x_rest = to_rest(x[None], torch.softmax(weight_logits, dim=-1), poses, root=self.root)
            distance = self.cache.distance(x_rest)
            if not ghost:
                return Answer(distance[0], distance[0], x_rest[0], self.cache.width)
            level = -self.cache.width * ghost_logit(-distance / self.cache.width, weight_logits)
            distance = torch.where((level > 0) & (distance < 0), level, distance)
            return Answer(level[0], distance[0], x_rest[0], self.cache.width)

        return answer


def ghost_logit(inside: Tensor, weight_logits: Tensor) -> Tensor:
    """Logit of (1 - g) sigmoid(z), eq. 8, smooth where occupancy itself has saturated.

    Parameters
    ----------
    inside : (...) tensor
        The logit z at the canonical point.
    weight_logits : (..., b+1) tensor
        Whose softmax holds g, the ghost bone's weight, last.
    """
    # With p = (1 - g) s(z): logit p = log(1 - g) + log s(z) - log(1 - p), and 1 - p = s(-z) + g s(z).
    log_solid = nn.functional.logsigmoid(torch.logsumexp(weight_logits[..., :-1], dim=-1) - weight_logits[..., -1])
    log_ghost = torch.log_softmax(weight_logits, dim=-1)[..., -1]
    log_outside = torch.logaddexp(nn.functional.logsigmoid(-inside), log_ghost + nn.functional.logsigmoid(inside))
    return log_solid + nn.functional.logsigmoid(inside) - log_outside


def inverse_map(x: Tensor, W: Tensor, B: Tensor, *, root: int) -> Tensor:
    """Canonical point of posed points: the inverse of the blended transform, applied to the point (eq. 6).

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
