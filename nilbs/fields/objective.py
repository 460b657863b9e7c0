"""What NiLBS networks are trained for: the two losses of the paper's section "Training"."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from nilbs.fields.adaptive import AdaptiveSampler
from nilbs.fields.nilbs import NilbsField, inverse_map
from nilbs.fields.samples import OccupancySamples, RestSamples
from nilbs.geometry.kinematics import forward_kinematics, random_rotations

# Steps between two looks at the whole pool of labelled points.
REFRESH = 500


@dataclass(frozen=True)
class RandomPoses:
    """Poses drawn while training: each bone but the roots turned about a random axis.

    Attributes
    ----------
    C, BE, P : arrays
        The skeleton, in the field's frame.
    std : float
        Largest standard deviation of the angle, in radians; each pose draws its own between zero and this.
    """

    C: np.ndarray
    BE: np.ndarray
    P: np.ndarray
    std: float

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """N poses, an (n, b, d+1, d+1) array."""
        theta = random_rotations(self.P, self.C.shape[1], n, std=1.0, rng=rng)
        theta *= rng.uniform(0, self.std, (n, 1, 1))
        return forward_kinematics(self.C, self.BE, self.P, theta)


class NilbsObjective:
    """Loss of a NiLBS field at a training step.

    The occupancy loss compares the field with the truth at labelled points of the motion's frames, half of them drawn
    in proportion to the field's error on them. That error is looked up anew every `REFRESH` steps, so a training may be
    continued only at a multiple of those. The weight loss is
    the cross-entropy between the network's weights and known ones at rest points that skinning has posed, where the
    posed point's weights are those of the rest point it came from; posing costs nothing, so half of the poses are drawn
    at random. The paper's own weight loss is the special case of the rest pose and the rest vertices.

    Parameters
    ----------
    field : NilbsField
        What is trained.
    poses : (t, b, d+1, d+1) float array
        The motion's frames.
    labelled : OccupancySamples
        Points of those frames.
    rest : RestSamples
        Rest points with known weights.
    random_poses : RandomPoses, optional
        Where poses for the weight loss come from. None poses nothing: rest points are supervised in the rest pose.
    poses_per_step, points_per_pose : int
        Size of a step's batch, for each of the two losses.
    weight_loss : float
        Factor of the weight loss.
    position_loss : float
        Factor of the mean distance (sum of absolute coordinates) by which the inverse map misses the rest points. A
        wrong weight matters as much as the bones that it mixes lie apart; the cross-entropy alone does not know.
    adaptive : bool
        Whether labelled points are drawn by error and compared by cross-entropy. If not, they are drawn uniformly and
        compared by squared difference, the paper's norm.
    seed : int
        A step's batch depends on this and on the step alone.
    """

    def __init__(
        self,
        field: NilbsField,
        poses: np.ndarray,
        labelled: OccupancySamples,
        rest: RestSamples,
        *,
        random_poses: RandomPoses | None,
        poses_per_step: int,
        points_per_pose: int,
        weight_loss: float,
        position_loss: float = 0.0,
        adaptive: bool = True,
        seed: int,
    ) -> None:
        like = next(field.parameters())
        self.field, self.random_poses, self.weight_loss, self.position_loss = (
            field,
            random_poses,
            weight_loss,
            position_loss,
        )
        self.adaptive, self.seed = adaptive, seed
        self.poses_per_step, self.points_per_pose = poses_per_step, points_per_pose
        self.poses = torch.as_tensor(poses, dtype=like.dtype, device=like.device)
        self.x = torch.as_tensor(labelled.x, dtype=like.dtype, device=like.device)
        self.inside = torch.as_tensor(labelled.inside, device=like.device)
        self.sampler = AdaptiveSampler(*labelled.inside.shape)
        self.x_rest = torch.as_tensor(rest.x_rest, dtype=like.dtype, device=like.device)
        self.W = torch.as_tensor(rest.W, dtype=like.dtype, device=like.device)

    def __call__(self, step: int) -> Tensor:
        """Sum of the losses on the batch of a step."""
        if self.adaptive and step % REFRESH == 0:
            self.sampler.refresh(self._error)
        rng = np.random.default_rng([self.seed, step])
        return self._occupancy_loss(rng) + self._weight_loss(rng)

    def _occupancy_loss(self, rng: np.random.Generator) -> Tensor:
        frames, points = self.sampler.draw(self.poses_per_step, self.points_per_pose, rng)
        frame = torch.as_tensor(frames, device=self.poses.device)
        point = torch.as_tensor(points, device=self.poses.device)
        logit = self.field.logit(self.field(self.x[frame[:, None], point], self.poses[frame]))
        inside = self.inside[frame[:, None], point].to(logit.dtype)
        if not self.adaptive:
            return ((torch.sigmoid(logit) - inside) ** 2).mean()
        return nn.functional.binary_cross_entropy_with_logits(logit, inside)

    def _error(self, frame: int) -> Tensor:
        """Squared error of occupancy at all labelled points of a frame."""
        logit = self.field.logit(self.field(self.x[frame : frame + 1], self.poses[frame : frame + 1]))[0]
        return (torch.sigmoid(logit) - self.inside[frame].to(logit.dtype)) ** 2

    def _weight_loss(self, rng: np.random.Generator) -> Tensor:
        B = self._weight_poses(rng)
        point = self._indices(rng, len(self.x_rest), (self.poses_per_step, self.points_per_pose))
        x_rest, W = self.x_rest[point], self.W[point]
        d = x_rest.shape[-1]
        blend = (W @ B[:, :, :d].reshape(len(B), B.shape[1], -1)).unflatten(-1, (d, d + 1))
        x = (blend[..., :d] @ x_rest[..., None])[..., 0] + blend[..., d]
        logits = self.field.network(x, B)
        cross_entropy = -(W * torch.log_softmax(logits, dim=-1)[..., :-1]).sum(dim=-1).mean()
        if not self.position_loss:
            return self.weight_loss * cross_entropy
        image = inverse_map(x, torch.softmax(logits, dim=-1), B, root=self.field.root)
        # A collapsed blend sends its image far away; beyond the size of the body further is no worse.
        missed = (image - x_rest).abs().sum(dim=-1).clamp_max(1.0).mean()
        return self.weight_loss * cross_entropy + self.position_loss * missed

    def _weight_poses(self, rng: np.random.Generator) -> Tensor:
        if self.random_poses is None:
            rest = torch.eye(self.poses.shape[-1], dtype=self.poses.dtype, device=self.poses.device)
            return rest.expand(self.poses_per_step, *self.poses.shape[1:])
        drawn = self.random_poses.draw(self.poses_per_step // 2, rng)
        frames = self._indices(rng, len(self.poses), (self.poses_per_step - len(drawn),))
        return torch.cat([torch.as_tensor(drawn).to(self.poses), self.poses[frames]])

    def _indices(self, rng: np.random.Generator, n: int, shape: tuple[int, ...]) -> Tensor:
        return torch.as_tensor(rng.integers(0, n, shape), device=self.poses.device)
