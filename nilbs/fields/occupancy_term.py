"""The paper's occupancy loss: a field against the truth at labelled points of the motion's frames."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from nilbs.fields.adaptive import AdaptiveSampler
from nilbs.fields.samples import OccupancySamples

# Points whose errors are evaluated together; bounds the memory of methods that visit every bone.
CHUNK = 4096
# A refresh evaluates every fourth point, so that it costs little beside the steps between two.
STRIDE = 4


class OccupancyTerm:
    """Occupancy loss of any field on the labelled points of a step.

    Parameters
    ----------
    logit : function of points (p, n, d) and poses (p, b, d+1, d+1)
        Logits (p, n) of occupancy: what is trained.
    poses : (t, b, d+1, d+1) tensor
        The motion's frames, in the field's precision and on its device.
    labelled : OccupancySamples
        Points of those frames.
    adaptive : bool
        Whether half of the points are drawn in proportion to the field's error on them at the last refresh.
    absolute : bool
        Whether occupancies are compared by their absolute difference, as in the paper, instead of cross-entropy.
    """

    def __init__(
        self,
        logit: Callable[[Tensor, Tensor], Tensor],
        poses: Tensor,
        labelled: OccupancySamples,
        *,
        poses_per_step: int,
        points_per_pose: int,
        factor: float = 1.0,
        adaptive: bool = False,
        absolute: bool = False,
    ) -> None:
        self.logit, self.poses = logit, poses
        self.x = torch.as_tensor(labelled.x).to(poses)
        self.inside = torch.as_tensor(labelled.inside).to(poses)
        self.sampler = AdaptiveSampler(*labelled.inside.shape)
        self.poses_per_step, self.points_per_pose = poses_per_step, points_per_pose
        self.factor, self.absolute = factor, absolute
        self.adaptive = adaptive and factor > 0

    def refresh(self, turn: int) -> None:
        """Evaluate the field's error on every `STRIDE`-th point, from another one each turn.

        Turn 0 forgets all errors instead, because those of an untrained field mean nothing.
        """
        if turn == 0:
            self.sampler.forget()
        elif self.adaptive:
            self.sampler.refresh(self._error, slice(turn % STRIDE, None, STRIDE))

    def __call__(self, rng: np.random.Generator) -> Tensor:
        """Loss on a batch that the generator draws."""
        frames, points = self.sampler.draw(self.poses_per_step, self.points_per_pose, rng)
        frame = torch.as_tensor(frames, device=self.poses.device)
        point = torch.as_tensor(points, device=self.poses.device)
        logit = self.logit(self.x[frame[:, None], point], self.poses[frame])
        inside = self.inside[frame[:, None], point]
        if self.absolute:
            return self.factor * (torch.sigmoid(logit) - inside).abs().mean()
        return self.factor * nn.functional.binary_cross_entropy_with_logits(logit, inside)

    def _error(self, frame: int, seen: slice) -> Tensor:
        """Squared error of occupancy at labelled points of a frame."""
        parts = self.x[frame, seen].split(CHUNK)
        logit = torch.cat([self.logit(x[None], self.poses[frame : frame + 1])[0] for x in parts])
        return (torch.sigmoid(logit) - self.inside[frame, seen]) ** 2
