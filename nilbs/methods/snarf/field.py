"""The field of SNARF: occupancy at every canonical point that learned forward skinning sends to the query."""

from math import pi
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from nilbs.engine.answer import Answer
from nilbs.fields.cramer import cramer
from nilbs.fields.encoding import ParameterEncoding
from nilbs.fields.field import Field
from nilbs.fields.forward import affine
from nilbs.methods.snarf.broyden import broyden
from nilbs.methods.snarf.conditioned_network import ConditionedNetwork

# Lengths are in units of the body's longest edge.
CONVERGED = 1e-5  # a root's residual is smaller
DIVERGED = 1.0  # a search with a larger residual is given up
SAME = 1e-3  # roots this near to each other are one
WEIGHT_SHARPNESS = 20.0  # of the softmax of the weights
BLEND = 5.0  # of the softmax over the roots while training
RADIUS = 0.5  # of the sphere that the occupancy network begins as
LIMIT = 60.0  # logits are held between this and its negative, so that no occupancy is 0 or 1 to the last digit
OUTSIDE = -16.0  # logit of points without a root
WEIGHT_FACTOR = 10.0  # of the loss of weights at joints, in terms of that of occupancy on bones
STARTS = 1 << 14  # searches at a time


class SnarfField(Field):
    """Occupancy by differentiable forward skinning [1]_; `Snarf` lists what differs from the paper.

    One network has the skinning weights of rest points, the same for all poses, and another the occupancy of rest
    points, which the pose may change. Forward skinning sends a rest point to x = sum_b w_b(x_rest) B_b x_rest. The rest
    points that it sends to a query are its roots, found by Broyden's method from every bone's rigid inverse B_b^-1 x,
    with the map's derivative there as first Jacobian; the query is inside if any of its roots is. Roots have
    derivatives by the implicit function theorem, so that occupancy alone trains the weights.

    While training, the maximum over the roots is a mean of their occupancies weighted by a softmax of them, so that all
    of them learn. The occupancy network starts as a ball; 8 numbers that sum up the pose parameters enter at its
    middle, because a pose changes little of the rest shape and that must hold in unseen poses too.

    Parameters
    ----------
    P : (b,) int tensor
    centers : (b, d) tensor
        First joint of every bone at rest.
    width, depth, weight_width, weight_depth : int
        Units of a hidden layer and number of linear layers, of the occupancy and of the weight network.
    iterations : int
        The most steps of a search.

    References
    ----------
    .. [1] Chen et al., SNARF: Differentiable Forward Skinning for Animating Non-Rigid Neural Implicit Shapes, 2021,
       arXiv:2104.03953.
    """

    has_canonical_points = True

    def __init__(
        self,
        P: Tensor,
        centers: Tensor,
        *,
        width: int = 64,
        depth: int = 5,
        weight_width: int = 64,
        weight_depth: int = 4,
        iterations: int = 10,
    ) -> None:
        super().__init__()
        b, d = centers.shape
        self.encoding = ParameterEncoding(P, d)
        self.occupancy = ConditionedNetwork(d, 1, width, depth, shared=self.encoding.size - d)
        self.occupancy.start_round(RADIUS)
        self.weight = ConditionedNetwork(d, b, weight_width, weight_depth)
        self.iterations = iterations

    def logit(self, x: Tensor, B: Tensor) -> Tensor:
        """Logit (p, n) of occupancy, of the blend of the roots, differentiable by parameters, points and poses."""
        p, n = x.shape[:2]
        pose = torch.arange(p, device=x.device).repeat_interleave(n)
        found = self.candidates(x.flatten(0, 1), B, pose)
        inside = torch.sigmoid(found.logit)
        share = torch.where(found.exists, torch.exp(BLEND * inside), 0.0)
        share = share / share.sum(dim=-1, keepdim=True).clamp_min(1.0)  # exp of an occupancy is at least 1
        any_root = found.exists.any(dim=-1)
        # Inside and outside each have their own sum, so that neither is lost where the other is nearly one.
        solid = torch.where(any_root, (share * inside).sum(dim=-1), 0.5)
        empty = torch.where(any_root, (share * torch.sigmoid(-found.logit)).sum(dim=-1), 0.5)
        return torch.where(any_root, solid.log() - empty.log(), OUTSIDE).unflatten(0, (p, n))

    def posed(self, B: Tensor) -> "PosedSnarf":
        """The field in a pose, (b, d+1, d+1) rest to posed."""
        return PosedSnarf(self, B)

    def weights(self, x_rest: Tensor) -> Tensor:
        """Skinning weights (..., b) of rest points (..., d)."""
        return torch.softmax(WEIGHT_SHARPNESS * self.weight(x_rest), dim=-1)

    def rest_logit(self, x_rest: Tensor, B: Tensor, pose: Tensor) -> Tensor:
        """Logit (m,) of occupancy at rest points (m, d), each in the pose, of (p, b, d+1, d+1), that `pose` (m,) names.

        It lies between -60 and 60.
        """
        parameters = self.encoding(B)[1][:, x_rest.shape[-1] :] / pi
        return self.occupancy(x_rest, parameters, pose)[:, 0].clamp(-LIMIT, LIMIT)

    def skinned(self, x_rest: Tensor, B: Tensor, pose: Tensor) -> Tensor:
        """Images (m, d) of rest points under forward skinning; arguments as of `rest_logit`."""
        d = x_rest.shape[-1]
        return affine(_blended(self.weights(x_rest), _rows(B), pose).unflatten(-1, (d, d + 1)), x_rest)

    def derivative(self, x_rest: Tensor, B: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Images of rest points, and their derivatives (m, d, d) by rest coordinates; arguments as of `rest_logit`."""
        d = x_rest.shape[-1]
        values, slopes = self.weight.derivative(x_rest)
        W = torch.softmax(WEIGHT_SHARPNESS * values, dim=-1)
        dW = WEIGHT_SHARPNESS * W[:, None] * (slopes - slopes @ W[:, :, None])
        rows = _rows(B)
        blend = _blended(W, rows, pose).unflatten(-1, (d, d + 1))
        turning = _blended(dW, rows, pose).unflatten(-1, (d, d + 1))
        change = (turning[..., :d] @ x_rest[:, None, :, None])[..., 0] + turning[..., d]
        return affine(blend, x_rest), blend[..., :d] + change.mT

    def candidates(self, x: Tensor, B: Tensor, pose: Tensor) -> "Candidates":
        """All rest points that forward skinning sends to posed points; arguments as of `rest_logit`."""
        b = B.shape[1]
        size = max(STARTS // b, 1)
        chunks = [
            self._search(*part, B.detach()) for part in zip(x.detach().split(size), pose.split(size), strict=True)
        ]
        if not chunks:
            nothing = x.new_zeros((0, b))
            return Candidates(x.new_zeros((0, b, x.shape[-1])), nothing, nothing.bool(), 0)
        x_rest, exists = torch.cat([root for root, _, _ in chunks]), torch.cat([new for _, new, _ in chunks])
        point = exists.nonzero()[:, 0]
        root = x_rest[exists]
        if torch.is_grad_enabled():
            root = self._implicit(x[point], root, B, pose[point])
            x_rest = x_rest.masked_scatter(exists[..., None], root)
        logit = x.new_full(exists.shape, -LIMIT).masked_scatter(exists, self.rest_logit(root, B, pose[point]))
        return Candidates(x_rest, logit, exists, sum(evaluations for _, _, evaluations in chunks))

    @torch.no_grad()
    def _search(self, x: Tensor, pose: Tensor, B: Tensor) -> tuple[Tensor, Tensor, int]:
        """Roots (m, b, d) of points (m, d), one from each bone, which of them are new (m, b), and evaluations."""
        d = x.shape[-1]
        inverse = torch.linalg.inv(B)[pose, :, :d]
        start = affine(inverse, x[:, None])
        target, flat_pose = x.repeat_interleave(B.shape[1], dim=0), pose.repeat_interleave(B.shape[1])
        x_start, jacobian = self.derivative(start.flatten(0, 1), B, flat_pose)
        unit = torch.eye(d).to(x)
        columns = jacobian.unbind(-1)
        inverse_jacobian = torch.stack([cramer(columns, e.expand_as(target), dim=-1) for e in unit], dim=-1)
        found = broyden(
            lambda x_rest, which: self.skinned(x_rest, B, flat_pose[which]),
            target,
            start.flatten(0, 1),
            inverse_jacobian,
            iterations=self.iterations,
            x_start=x_start,
            convergence=CONVERGED,
            divergence=DIVERGED,
        )
        root, converged = found.x_rest.view_as(start), found.converged.view(start.shape[:2])
        # Of roots that lie together the first is kept.
        apart = (root[:, :, None] - root[:, None]).square().sum(dim=-1) > SAME**2
        repeated = (~apart & converged[:, None]).tril(-1).any(dim=-1)
        return root, converged & ~repeated, found.evaluations + len(target)

    def _implicit(self, x: Tensor, root: Tensor, B: Tensor, pose: Tensor) -> Tensor:
        """The same roots, with first derivatives by the implicit function theorem: J^-1 (d x - d forward)."""
        with torch.no_grad():
            columns = self.derivative(root, B, pose)[1].unbind(-1)
        return root + cramer(columns, x - self.skinned(root, B, pose), dim=-1)


class Candidates(NamedTuple):
    """Roots of posed points, at most one from each bone.

    `x_rest` (m, b, d), the `logit` (m, b) of their occupancy, and where there `exists` (m, b) a root that no bone
    before has found; `evaluations` counts the points at which the weight network was evaluated.
    """

    x_rest: Tensor
    logit: Tensor
    exists: Tensor
    evaluations: int


class PosedSnarf:
    """A `SnarfField` in one pose; it counts the points queried and the evaluations of the weight network for them."""

    def __init__(self, field: SnarfField, B: Tensor) -> None:
        self.field, self.B = field, B
        self.queries = self.evaluations = 0

    def __call__(self, x: Tensor) -> Answer:
        """The answer at posed points (n, d): the largest logit over the roots, and that root; nan if there is none."""
        found = self.field.candidates(x, self.B[None], torch.zeros(len(x), dtype=torch.int64, device=x.device))
        self.queries += len(x)
        self.evaluations += found.evaluations
        logit, best = torch.where(found.exists, found.logit, -torch.inf).max(dim=-1)
        x_rest = found.x_rest[torch.arange(len(x), device=x.device), best]
        exists = found.exists.any(dim=-1)
        nowhere = torch.full_like(x_rest, torch.nan)
        return Answer(
            -torch.where(exists, logit, OUTSIDE),
            torch.full_like(logit, torch.nan),
            torch.where(exists[:, None], x_rest, nowhere),
        )


class SnarfBoneTerm:
    """The two losses that start the paper's training: bones are inside, and joints belong to two bones.

    Occupancy is one at random points of the bones at rest, `points` of each; at a bone's first joint the weights of the
    bone and of its parent are one half each, and a root's is one. C, BE and P are the skeleton in the field's frame;
    `poses`, if given, are poses in which bones must be inside. The weight loss, a mean square, has ten times the factor
    of the cross-entropy of occupancy.
    """

    def __init__(
        self,
        field: SnarfField,
        C: np.ndarray,
        BE: np.ndarray,
        P: np.ndarray,
        *,
        poses: Tensor | None = None,
        factor: float = 1.0,
        points: int = 5,
    ) -> None:
        like = next(field.parameters())
        b, d = len(BE), C.shape[1]
        self.field, self.factor, self.points = field, factor, points
        self.start, self.end = (torch.as_tensor(C[BE[:, i]]).to(like) for i in (0, 1))
        self.poses = (torch.eye(d + 1).expand(1, b, -1, -1) if poses is None else poses).to(like)
        own = np.eye(b)
        self.W = torch.as_tensor(np.where(P[:, None] < 0, own, 0.5 * (own + own[P]))).to(like)

    def __call__(self, rng: np.random.Generator) -> Tensor:
        """Sum of the two losses, at points and in poses that are drawn anew."""
        along = torch.as_tensor(rng.uniform(size=(self.points, len(self.start), 1))).to(self.start)
        x_rest = torch.lerp(self.start, self.end, along).flatten(0, 1)
        pose = torch.as_tensor(rng.integers(0, len(self.poses), len(x_rest)), device=x_rest.device)
        used, pose = torch.unique(pose, return_inverse=True)
        logit = self.field.rest_logit(x_rest, self.poses[used], pose)
        outside = nn.functional.softplus(-logit).mean()
        missed = (self.field.weights(self.start) - self.W).square().mean()
        return self.factor * (outside + WEIGHT_FACTOR * missed)


def _rows(B: Tensor) -> Tensor:
    """The upper rows (p, b, d (d+1)) of transforms, one after the other."""
    return B[:, :, :-1].flatten(2)


def _blended(W: Tensor, rows: Tensor, pose: Tensor) -> Tensor:
    """Transforms (m, ..., d (d+1)) blended by weights (m, ..., b)."""
    if len(rows) == 1:
        return W @ rows[0]
    if W.ndim == 2:
        return (W[:, None] @ rows[pose])[:, 0]
    return W @ rows[pose]
