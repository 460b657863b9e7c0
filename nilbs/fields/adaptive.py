"""Labelled points of a training step: more of those where the field is wrong."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor


class AdaptiveSampler:
    """Draws of (frame, point) pairs, half of them uniform and half in proportion to the field's last error.

    Most points around a character are easily outside; the few that a smooth weight network maps into the body by
    mistake are rare, and a uniform draw hardly ever takes them.
    """

    def __init__(self, frames: int, points: int) -> None:
        self.frames, self.points = frames, points
        self.forget()

    def forget(self) -> None:
        """Draw all points uniformly, as before the first refresh."""
        self.mass = np.ones((self.frames, self.points))
        self._accumulate()

    def refresh(self, error: Callable[[int, slice], Tensor], seen: slice = slice(None)) -> None:
        """Draw by the errors of points `seen` of each frame from now on; the others are drawn uniformly only.

        `error` returns the non-negative errors of these points of a frame.
        """
        with torch.no_grad():
            found = np.stack([error(frame, seen).cpu().numpy() for frame in range(self.frames)]).astype(np.float64)
        total = found.sum()
        self.mass = np.full((self.frames, self.points), 0.5 if total > 0 else 1.0)
        if total > 0:
            self.mass[:, seen] += 0.5 * self.mass.size * found / total
        self._accumulate()

    def draw(self, poses: int, points: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Frames (poses,), each as likely as its points weigh together, and points (poses, points) in them."""
        frame_ends = self._sums[self.points - 1 :: self.points]
        frame = np.searchsorted(frame_ends, rng.uniform(0, frame_ends[-1], poses), side="right")
        frame = np.minimum(frame, self.frames - 1)
        start = np.where(frame > 0, frame_ends[frame - 1], 0.0)
        target = start[:, None] + rng.uniform(0, 1, (poses, points)) * (frame_ends[frame] - start)[:, None]
        flat = np.searchsorted(self._sums, target.ravel(), side="right").reshape(poses, points)
        return frame, np.clip(flat - frame[:, None] * self.points, 0, self.points - 1)

    def _accumulate(self) -> None:
        self._sums = np.cumsum(self.mass.ravel())
