"""The paper's weight loss, and its extension to the rest volume in any pose."""

import numpy as np
import torch
from torch import Tensor

from nilbs.fields.forward_network import ForwardNetwork
from nilbs.fields.inverse_map import InverseField, inverse_map
from nilbs.fields.samples import RestSamples


class WeightTerm:
    """Cross-entropy between a network's weights and given ones at posed rest points.

    A posed point has the weights of the rest point it came from, in any pose; if `random_poses` are given, half of the
    poses are random. The paper's own loss is the special case of the rest pose and the rest vertices.

    Parameters
    ----------
    field : InverseField
        What is trained.
    poses : (t, b, d+1, d+1) tensor, optional
        The motion's frames; None supervises rest points in the rest pose.
    rest : RestSamples
        Rest points with given weights.
    random_poses : (k, b, d+1, d+1) tensor, optional
    factor, position_loss : float
        Factors of the cross-entropy, and of the mean distance (sum of absolute coordinates) by which the inverse map
        misses the rest points: a wrong weight matters as much as its bones lie apart, which the cross-entropy ignores.
    """

    def __init__(
        self,
        field: InverseField,
        poses: Tensor | None,
        rest: RestSamples,
        *,
        random_poses: Tensor | None,
        poses_per_step: int,
        points_per_pose: int,
        factor: float,
        position_loss: float = 0.0,
    ) -> None:
        like = next(field.parameters())
        self.field, self.poses, self.random_poses = field, poses, random_poses
        self.factor, self.position_loss = factor, position_loss
        self.poses_per_step, self.points_per_pose = poses_per_step, points_per_pose
        self.x_rest = torch.as_tensor(rest.x_rest).to(like)
        self.W = torch.as_tensor(rest.W).to(like)

    def __call__(self, rng: np.random.Generator) -> Tensor:
        """Loss on a batch that the generator draws."""
        B = self.draw_poses(rng)
        point = indices(rng, len(self.x_rest), (self.poses_per_step, self.points_per_pose), self.W.device)
        x_rest, W = self.x_rest[point], self.W[point]
        d = x_rest.shape[-1]
        blend = (W @ B[:, :, :d].reshape(len(B), B.shape[1], -1)).unflatten(-1, (d, d + 1))
        x = (blend[..., :d] @ x_rest[..., None])[..., 0] + blend[..., d]
        logits = self.field.network(x, B)
        loss = self.factor * cross_entropy(logits, W)
        if self.position_loss:
            found = inverse_map(x, torch.softmax(logits, dim=-1), B, root=self.field.root)
            # A collapsed blend sends the point far away; errors beyond the size of the body count alike.
            loss = loss + self.position_loss * (found - x_rest).abs().sum(dim=-1).clamp_max(1.0).mean()
        return loss

    def draw_poses(self, rng: np.random.Generator) -> Tensor:
        """Poses of a batch, (poses_per_step, b, d+1, d+1)."""
        b, d = self.W.shape[1], self.x_rest.shape[1]
        if self.poses is None:
            return torch.eye(d + 1).to(self.W).expand(self.poses_per_step, b, d + 1, d + 1)
        if self.random_poses is None:
            return self.poses[indices(rng, len(self.poses), (self.poses_per_step,), self.W.device)]
        half, device = self.poses_per_step // 2, self.W.device
        drawn = indices(rng, len(self.random_poses), (half,), device)
        frames = indices(rng, len(self.poses), (self.poses_per_step - half,), device)
        return torch.cat([self.random_poses[drawn], self.poses[frames]])


class ForwardWeightTerm:
    """Cross-entropy between a forward network's weights and given ones at `points` rest points a step."""

    def __init__(self, network: ForwardNetwork, rest: RestSamples, *, points: int) -> None:
        like = next(network.parameters())
        self.network, self.points = network, points
        self.x_rest = torch.as_tensor(rest.x_rest).to(like)
        self.W = torch.as_tensor(rest.W).to(like)

    def __call__(self, rng: np.random.Generator) -> Tensor:
        """Loss on a batch that the generator draws."""
        point = indices(rng, len(self.x_rest), (self.points,), self.W.device)
        return cross_entropy(self.network.logits(self.x_rest[point]), self.W[point])


def cross_entropy(logits: Tensor, W: Tensor) -> Tensor:
    """Mean cross-entropy of weights (..., b) and the softmax of logits (..., b or b+1)."""
    return -(W * torch.log_softmax(logits, dim=-1)[..., : W.shape[-1]]).sum(dim=-1).mean()


def indices(rng: np.random.Generator, n: int, shape: tuple[int, ...], device: torch.device) -> Tensor:
    """Indices below n, drawn by the generator."""
    return torch.as_tensor(rng.integers(0, n, shape), device=device)
