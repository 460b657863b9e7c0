"""Settings of a training, as they are stored in a model file, and the defaults that several functions share."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

FRAMES = 100  # of random motion, and of other motion that a training takes
AMPLITUDE = 0.4  # rad, rms, of random motion
NOISE = 0.006  # of L: standard deviation of points near the surface, in training and in scores
POINTS = 100_000  # a frame, of scores
RESOLUTION = 128  # cells along the longest edge of the grid that surfaces are extracted on


@dataclass(frozen=True)
class Settings:
    """How a field is trained. Lengths are fractions of L, the longest edge of the rest mesh's bounding box.

    Attributes
    ----------
    steps : int
        Training steps; 0 takes 2000 and 250 more for each bone, at most 10000.
    learning_rate : float
        Largest rate of the one-cycle schedule.
    width, depth : int
        Units of a hidden layer, and number of linear layers.
    poses_per_step, points_per_pose : int
        Batch of each loss.
    samples_per_frame : int
        Labelled points of each training frame.
    noise : float
        Standard deviation of the points near the surface; see `occupancy_samples`.
    supervision : "volume" or "paper"
        Where the weight loss knows the weights: in the rest volume and a thin shell around it, posed by skinning in the
        motion's and in random poses; or, as in the paper, on the rest surface's vertices in the rest pose. "paper" also
        takes the paper's occupancy loss: uniform points, squared difference.
    shell : float
        Standard deviation of that shell.
    weight_loss : float
        Factor of the weight loss.
    position_loss : float
        Factor of the distance by which the inverse map misses the rest points whose weights are known; only with
        supervision in the volume.
    random_pose_std : float
        Random poses turn every bone but the roots by normal angles whose standard deviation is drawn, for each pose,
        between zero and this; in radians.
    mapping : "search" or "inverse"
        Where the trained field takes rest images from: a root search that begins at the network's answer, or the
        network's inverse map alone, as in the paper. The training is the same.
    cache_resolution : int
        Cells of the rest cache along its longest edge; 0 takes 256 in space and 512 in the plane. Training
        reads every other node.
    weight_resolution : int
        Cells of the grid of rest weights along its longest edge; 0 takes 128 in space and 256 in the plane.
    cache_width : float
        Width of the step by which occupancy is read from distance.
    seed : int
        The same seed, on the same machine with the same threads, gives the same model.
    """

    steps: int = 0
    learning_rate: float = 1e-2
    width: int = 96
    depth: int = 5
    poses_per_step: int = 64
    points_per_pose: int = 128
    samples_per_frame: int = 20_000
    noise: float = NOISE
    supervision: str = "volume"
    shell: float = 0.01
    weight_loss: float = 1.0
    position_loss: float = 20.0
    random_pose_std: float = 0.8
    mapping: str = "search"
    cache_resolution: int = 0
    weight_resolution: int = 0
    cache_width: float = 0.003
    seed: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value: Any = getattr(self, field.name)
            kind: type = type(field.default)
            allowed: tuple[type, ...] = (int, float) if kind is float else (kind,)
            if type(value) not in allowed:
                raise ValueError(f"{field.name} must be of type {kind.__name__}, got {value!r}")
            if kind is not str and not 0 <= value < 1e9:
                raise ValueError(f"{field.name} must lie between 0 and 1e9, got {value!r}")
        for name in ("width", "poses_per_step", "points_per_pose", "samples_per_frame", "cache_width"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)!r}")
        if self.depth < 2:
            raise ValueError(f"depth must be at least 2, got {self.depth}")
        for name, choices in (("supervision", ("volume", "paper")), ("mapping", ("search", "inverse"))):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")

    def resolved(self, *, bones: int, d: int) -> "Settings":
        """Settings in which every zero that stands for "as fits the character" is replaced by its number."""
        return replace(
            self,
            # More bones are more to tell apart, and take longer.
            steps=self.steps or min(2000 + 250 * bones, 10_000),
            cache_resolution=self.cache_resolution or {2: 512, 3: 256}[d],
            weight_resolution=self.weight_resolution or {2: 256, 3: 128}[d],
        )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> "Settings":
        """Settings from what a model file holds.

        Raises
        ------
        ValueError
            If a name is unknown or missing, or a value has the wrong type.
        """
        known = {field.name for field in fields(cls)}
        if set(values) != known:
            raise ValueError(f"settings are {sorted(values)}, expected {sorted(known)}")
        return cls(**values)
