"""Settings of a training, as they are stored in a model file, and the defaults that several functions share."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

NOISE = 0.006  # of L: standard deviation of points near the surface, in training and in scores

# Methods that a field can be trained by, and what their networks and batches are where nothing else is asked for.
METHODS: dict[str, dict[str, float]] = {
    "nilbs": {"learning_rate": 1e-2, "width": 96, "depth": 5, "poses_per_step": 64, "points_per_pose": 128},
    "nasa": {"learning_rate": 1e-2, "width": 40, "depth": 4, "poses_per_step": 16, "points_per_pose": 64},
    "nasa-rigid": {"learning_rate": 1e-2, "width": 40, "depth": 4, "poses_per_step": 16, "points_per_pose": 64},
    "snarf": {"learning_rate": 1e-2, "width": 64, "depth": 5, "poses_per_step": 4, "points_per_pose": 128},
    "mlp": {"learning_rate": 1e-2, "width": 256, "depth": 6, "poses_per_step": 16, "points_per_pose": 256},
    # What learns nothing needs no network, and no batch.
    "nearest": {},
    "rigid-parts": {},
    "mesh-lbs": {},
}
UNTRAINED = ("nearest", "rigid-parts", "mesh-lbs")
# What the method "nilbs" alone reads: settings of its rest grids, its weight network, its search and its own losses.
ONLY_NILBS = (
    "shell",
    "encoding",
    "ghost",
    "forward",
    "position_loss",
    "random_pose_std",
    "adaptive",
    "mapping",
    "cache_resolution",
    "weight_resolution",
    "cache_width",
)
# Where a field of the method "nilbs" takes rest images from.
MAPPINGS = {
    "search": "a root search on the forward weights, from the network's answer and from every part that lies there",
    "parts": "the root search from every part that lies there, without the network",
    "one-search": "the root search from the network's answer alone",
    "all-bones": "the root search from every bone's rigid inverse, as SNARF begins, without the network",
    "fixed-point": "eq. 5 iterated from the network's answer: x_rest <- [W(x_rest) B]^-1 x",
    "inverse": "the network's inverse map (eq. 6), with the ghost bone (eq. 8)",
    "reverse": "the blend of the bones' inverses, sum_b W_b B_b^-1 x, with the ghost bone",
}
# Rows that an evaluation can have beside the model's own.
ROWS = {
    "floor": "the true mesh's own distance on the same grid",
    "nearest": "inverse skinning with the weights of the nearest posed vertex",
    "rigid-parts": "every bone's rigid inverse, where that bone owns the place",
    **MAPPINGS,
}

# The most labelled points of a training, which bounds its memory for motions of any length.
MOST_LABELLED = 10_000_000
# The widest and deepest network, and the most nodes of a grid, that anyone can have meant.
WIDEST, MOST_NODES = 4096, {"cache_resolution": 2**30, "weight_resolution": 2**27}


@dataclass(frozen=True)
class Settings:
    """How a field is trained. Lengths are fractions of L, the longest edge of the rest mesh's bounding box.

    Attributes
    ----------
    method : str
        One of `METHODS`; all but "nilbs" are rivals.
    steps : int
        Training steps; 0 takes 1000 and 100 more for each bone, at most 4000.
    learning_rate : float
        Largest rate of the one-cycle schedule; 0 takes what `METHODS` says.
    width, depth : int
        Units of a hidden layer, and number of linear layers (of NASA's parts: of hidden layers); 0 takes what `METHODS`
        says.
    poses_per_step, points_per_pose : int
        Batch of each loss; 0 takes what `METHODS` says.
    samples_per_frame : int
        Labelled points of each training frame; fewer where all frames together would have more than `MOST_LABELLED`.
    noise : float
        Standard deviation of the points near the surface; see `occupancy_samples`.
    supervision : "volume" or "paper"
        Where the weight loss knows the weights: in the rest volume and a thin shell around it, posed by skinning in the
        motion's and in random poses; or, as in the paper, on the rest surface's vertices in the rest pose. "paper" also
        takes the paper's occupancy loss: uniform points, absolute difference.
    shell : float
        Standard deviation of that shell.
    encoding : "local" or "parameters"
        What the network is told of a pose: the point in every bone's local coordinates, which fits any rig, or the
        point and, after it, the pose parameters.
    ghost : bool
        Whether the network has a ghost bone (eq. 8).
    forward : "grid" or "network"
        What keeps the rest weights of the forward map (eq. 4): a grid, or a network that is trained with the other.
    occupancy_loss : float
        Factor of the occupancy loss.
    weight_loss : float
        Factor of the weight loss; of a rival, of its own further losses.
    position_loss : float
        Factor of the distance by which the inverse map misses the rest points whose weights are known; only with
        supervision in the volume.
    random_pose_std : float
        Half of the weight loss's poses turn every bone but the roots by normal angles whose standard deviation is
        drawn, for each pose, between zero and this; in radians. 0 takes the motion's poses only.
    adaptive : bool
        Whether half of the labelled points are drawn by the field's error; only of the method "nilbs" with supervision
        in the volume.
    mapping : str
        One of `MAPPINGS`: where the trained field takes rest images from. The training is the same.
    cache_resolution : int
        Cells of the rest cache along its longest edge, at the skin; where distance bends there are up to four times as
        many. 0 takes 512 in space and 2048 in the plane.
    weight_resolution : int
        Cells of the grid of rest weights along its longest edge; 0 takes 128 in space and 256 in the plane.
    cache_width : float
        Width of the step by which occupancy is read from distance.
    seed : int
        The same seed, on the same machine with the same threads, gives the same model.
    """

    method: str = "nilbs"
    steps: int = 0
    learning_rate: float = 0.0
    width: int = 0
    depth: int = 0
    poses_per_step: int = 0
    points_per_pose: int = 0
    samples_per_frame: int = 20_000
    noise: float = NOISE
    supervision: str = "volume"
    shell: float = 0.01
    encoding: str = "local"
    ghost: bool = True
    forward: str = "grid"
    occupancy_loss: float = 1.0
    weight_loss: float = 1.0
    position_loss: float = 20.0
    random_pose_std: float = 0.8
    adaptive: bool = True
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
            if kind in (int, float) and not 0 <= value < 1e9:
                raise ValueError(f"{field.name} must lie between 0 and 1e9, got {value!r}")
        for name, least in (("samples_per_frame", 1), ("cache_width", 1e-6)):
            if not getattr(self, name) >= least:
                raise ValueError(f"{name} must be at least {least:g}, got {getattr(self, name)!r}")
        if max(self.width, self.depth) > WIDEST:
            raise ValueError(f"width and depth must be at most {WIDEST}, got {self.width} and {self.depth}")
        if self.depth == 1:
            raise ValueError("depth must be at least 2, got 1")
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        if self.supervision == "paper" and self.method != "nilbs":
            raise ValueError(f"supervision 'paper' is of the method nilbs: {self.method} has losses of its own")

    def resolved(self, *, bones: int, d: int) -> "Settings":
        """Settings in which every zero that stands for "as fits the character" is replaced by its number.

        Raises
        ------
        ValueError
            If a grid of the rest pose would not fit into memory.
        """
        for name, most in MOST_NODES.items():
            if (cells := getattr(self, name)) ** d > most:
                raise ValueError(f"{name} must be at most {int(most ** (1 / d))} in {d} dimensions, got {cells}")
        sizes: dict[str, Any] = {name: getattr(self, name) or size for name, size in METHODS[self.method].items()}
        return replace(
            self,
            # More bones are more to tell apart, and take longer.
            steps=0 if self.method in UNTRAINED else self.steps or min(1000 + 100 * bones, 4000),
            cache_resolution=self.cache_resolution or {2: 2048, 3: 512}[d],
            weight_resolution=self.weight_resolution or {2: 256, 3: 128}[d],
            **sizes,
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


_CHOICES = {
    "method": tuple(METHODS),
    "supervision": ("volume", "paper"),
    "encoding": ("local", "parameters"),
    "forward": ("grid", "network"),
    "mapping": tuple(MAPPINGS),
}
