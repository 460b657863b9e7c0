"""Depths of penetration as tensors, differentiable by points and poses, and losses of them. Needs torch."""

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor
from torch.autograd.function import once_differentiable

from nilbs.contacts.pairs import Skin, skin_places
from nilbs.contacts.penetration import Penetration, penetration
from nilbs.contacts.self_contacts import SelfContactFinder
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
    depth: Tensor = _Depth.apply(model, *(tensor.to("cpu", torch.float64) for tensor in (x, pose)), False)
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


def self_contact_loss(model: "Model", pose: Tensor, *, finder: SelfContactFinder | None = None) -> Tensor:
    """Mean squared depth of where a body meets itself, over points of its volume; zero where it does not.

    Parameters
    ----------
    model : Model
    pose : (b, d+1, d+1) tensor
        Bone transforms, rest to posed.
    finder : SelfContactFinder, optional
        Of the model. Made once, it serves any number of calls; by default one is made, which takes a second.

    Returns
    -------
    loss : () tensor
        In the pose's precision, with first derivatives by the pose: of each point in contact those of its distance to
        the closest place on the skin, both of which move with the pose. Which points are in contact is constant.

    Raises
    ------
    ValueError
        If the model has no compiled search, or as for all queries.
    """
    finder = finder or SelfContactFinder(model)
    found = finder(pose.detach().to("cpu", torch.float64).numpy())
    c, exact = model.character, pose.to("cpu", torch.float64)
    points = _moving_matrix(finder.weights[found.sample], found.x_rest)
    depth: Tensor = _Depth.apply(model, _moved(points, exact, c.d), exact, True)
    return (depth.square().sum() / len(finder.x_rest)).to(pose.dtype)


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
        corner = c.F[skin.facet].ravel()
        # Row i of the product has sum_c bary_ic W_cb (v_c, 1) for each bone b.
        corners = csr_array((skin.barycentric.ravel(), (np.arange(n * d) // d, np.arange(n * d))), shape=(n, n * d))
        self._matrix, self._d = _moving_matrix(csr_array(c.W[corner]), c.V[corner], corners), d

    def __call__(self, pose: Tensor) -> Tensor:
        """The places (n, d) in a pose (b, d+1, d+1), in the pose's precision."""
        return _moved(self._matrix, pose.to("cpu", torch.float64), self._d).to(pose.dtype)


def _moving_matrix(W: csr_array, home: np.ndarray, blend: csr_array | None = None) -> Tensor:
    """Sparse rows W_ib (x_i, 1) of rest points (n, d), or sums of them: times the transposed transforms, the places."""
    n, d = home.shape
    W, place = W.tocoo(), np.concatenate([home, np.ones((n, 1))], axis=1)
    row, column = np.repeat(W.row, d + 1), (W.col[:, None] * (d + 1) + np.arange(d + 1)).ravel()
    rows = csr_array(((W.data[:, None] * place[W.row]).ravel(), (row, column)), shape=(n, W.shape[1] * (d + 1)))
    rows = (rows if blend is None else blend @ rows).tocoo()
    index = torch.from_numpy(np.stack([rows.row, rows.col]).astype(np.int64))
    return torch.sparse_coo_tensor(index, torch.from_numpy(rows.data), rows.shape, check_invariants=True).coalesce()


def _moved(matrix: Tensor, pose: Tensor, d: int) -> Tensor:
    """The places (n, d) of the rows of `_moving_matrix` in a pose (b, d+1, d+1)."""
    return torch.sparse.mm(matrix, pose[:, :d].transpose(1, 2).reshape(-1, d))


class _Depth(torch.autograd.Function):
    """Depths (n,) of points (n, d) in a pose, in double precision."""

    @staticmethod
    def forward(ctx: Any, model: "Model", x: Tensor, pose: Tensor, inside: bool) -> Tensor:
        """Depths; what `backward` needs is kept. Points that are `inside` are not tested."""
        points, transforms = x.detach().numpy(), pose.detach().numpy()
        if inside:
            places = model.closest_points(points, transforms)
            found = Penetration(places.distance, places.point - points, places.facet, places.barycentric)
        else:
            found = penetration(model, points, transforms)
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
        return None, torch.from_numpy(by_x), torch.from_numpy(by_pose), None
