"""Depths of penetration as tensors, differentiable by points and poses, and losses of them. Needs torch."""

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor
from torch.autograd.function import once_differentiable

from nilbs.contacts.pairs import Skin, skin_places
from nilbs.contacts.penetration import penetration
from nilbs.engine.closest_search import ClosestPoints

if TYPE_CHECKING:
    from nilbs.models.model import Model


def penetration_depth(model: "Model", x: Tensor, pose: Tensor) -> Tensor:
    """How deep posed points are inside a body.

    Parameters
    ----------
    model : Model
    x : (n, d) tensor
        Posed points, in mesh units.
    pose : (b, d+1, d+1) tensor
        Bone transforms, rest to posed.

    Returns
    -------
    depth : (n,) tensor
        Distance to the posed skin; zero outside. In the higher precision of x and pose, with first derivatives by both:
        those of the distance from the closest place, which moves with the skin.

    Raises
    ------
    ValueError
        As for all queries of `Model`.
    """
    precision = torch.promote_types(x.dtype, pose.dtype)
    depth: Tensor = _Depth.apply(model, *(tensor.to("cpu", torch.float64) for tensor in (x, pose)))
    return depth.to(precision)


def penetration_loss(model: "Model", x: Tensor, pose: Tensor) -> Tensor:
    """Mean squared depth of posed points (n, d) inside a body; zero where none is inside."""
    return penetration_depth(model, x, pose).square().mean()


def contact_loss(
    a: "Model", pose_a: Tensor, b: "Model", pose_b: Tensor, *, skins: "tuple[MovingSkin, MovingSkin] | None" = None
) -> Tensor:
    """Mean squared depth of the places on each skin inside the other body.

    `skins` of a and b, made once, serve any number of calls; by default the vertices of both.
    """
    skin_a, skin_b = skins or (MovingSkin(a), MovingSkin(b))
    return penetration_loss(b, skin_a(pose_a), pose_b) + penetration_loss(a, skin_b(pose_b), pose_a)


class MovingSkin:
    """Places on a model's skin, differentiable by the pose (eq. 1).

    Parameters
    ----------
    model : Model
    skin : Skin, optional
        Which places; by default the vertices.
    """

    def __init__(self, model: "Model", skin: Skin | None = None) -> None:
        c = model.character
        skin = skin or skin_places(c.V, c.F)
        n, d = skin.barycentric.shape
        # Row i has sum_c bary_ic W_cb (v_c, 1) for each bone b: times the transposed transforms, the place.
        corner = c.F[skin.facet].ravel()
        weights = csr_array(c.W[corner] * skin.barycentric.reshape(-1, 1))
        home = np.concatenate([c.V, np.ones((len(c.V), 1))], axis=1)[corner]
        row = np.repeat(np.arange(n * d) // d, np.diff(weights.indptr))
        entry = np.repeat(np.arange(n * d), np.diff(weights.indptr))
        index = np.stack([np.repeat(row, d + 1), (weights.indices[:, None] * (d + 1) + np.arange(d + 1)).ravel()])
        value = (weights.data[:, None] * home[entry]).ravel()
        shape = (n, c.W.shape[1] * (d + 1))
        self._matrix = torch.sparse_coo_tensor(
            torch.from_numpy(index), torch.from_numpy(value), shape, check_invariants=True
        )
        self._matrix = self._matrix.coalesce()
        self._d = d

    def __call__(self, pose: Tensor) -> Tensor:
        """The places (n, d) in a pose (b, d+1, d+1), in the pose's precision."""
        columns = pose[:, : self._d].transpose(1, 2).reshape(-1, self._d)
        return torch.sparse.mm(self._matrix, columns.to("cpu", torch.float64)).to(pose.dtype)


class _Depth(torch.autograd.Function):
    """Depths (n,) of points (n, d) in a pose, in double precision."""

    @staticmethod
    def forward(ctx: Any, model: "Model", x: Tensor, pose: Tensor) -> Tensor:
        """Depths; what `backward` needs is kept."""
        found = penetration(model, x.detach().numpy(), pose.detach().numpy())
        ctx.model, ctx.found, ctx.bones = model, found, pose.shape
        ctx.save_for_backward(x)
        return torch.from_numpy(found.depth)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients by points and by the pose."""
        (x,), found = ctx.saved_tensors, ctx.found
        by_x, by_pose = np.zeros(x.shape), np.zeros(ctx.bones)
        inside = np.flatnonzero(found.facet >= 0)
        if len(inside):
            here = x.numpy()[inside]
            places = ClosestPoints(
                found.depth[inside], found.facet[inside], here + found.way_out[inside], found.barycentric[inside]
            )
            by_x[inside], by_pose = ctx.model.skin_gradients(here, places, gradients[0].numpy()[inside])
        return None, torch.from_numpy(by_x), torch.from_numpy(by_pose)
