"""How much of a study is done: all that was meant, or everything once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nilbs.characters import FRAMES
from nilbs.models.protocol import POINTS, POSE_SETS, RESOLUTION

SWEEP_SETS = ("unseen", "far")
# What is trained: the settings that make a method of the name.
TRAINED: Mapping[str, Mapping[str, Any]] = {
    "nilbs": {},
    "paper": {"method": "paper"},
    "nasa": {"method": "nasa"},
    "nasa-rigid": {"method": "nasa-rigid"},
    "snarf": {"method": "snarf"},
    "mlp": {"method": "mlp"},
}
# Methods that search from every bone at every point, and those that evaluate every bone without a search.
SEARCH_ALL_BONES = ("snarf", "all-bones")
EVALUATE_ALL_BONES = (*SEARCH_ALL_BONES, "nasa", "nasa-rigid", "rigid-parts")
ABLATIONS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "no ghost bone": {"ghost": False},
    "no distances from bones": {"encoding": "local"},
    "pose parameters instead of local coordinates": {"encoding": "parameters"},
    "forward weights in a network": {"forward_map": "network"},
    "the occupancy loss too": {"occupancy_loss": 1.0},
    "no weight loss": {"weight_loss": 0.0},
    "no position loss": {"position_loss": 0.0},
    "the occupancy loss alone": {"occupancy_loss": 1.0, "weight_loss": 0.0, "position_loss": 0.0},
    "no random poses": {"random_pose_std": 0.0},
    "the occupancy loss too, no adaptive sampling": {"occupancy_loss": 1.0, "adaptive": False},
    "the paper's supervision": {"method": "paper", "mapping": "search"},
    "the paper's supervision, cache of a wider step": {"method": "paper", "mapping": "search", "cache_width": 0.01},
    "rest weights on 64 cells": {"weight_resolution": 64},
    "rest weights on 96 cells": {"weight_resolution": 96},
    "rest distance on 256 cells": {"cache_resolution": 256},
    "rest distance on 128 cells": {"cache_resolution": 128},
}


@dataclass(frozen=True)
class Scale:
    """How much is done.

    Attributes
    ----------
    characters : mapping of str to int
        Characters of the part `methods`, with their numbers of seeds.
    sweep : str, optional
        The character of the sweeps; None where it is missing.
    minutes : mapping of str to float
        Training time by character in the part `methods`; empty if `settings` has the steps.
    sweep_minutes : float, optional
        Training time in sweeps; None if `settings` has the steps.
    settings : mapping
        Settings of every training.
    made_of : mapping of str to str
        Digests of the characters' files: results that were made of others do not count.
    points, resolution : int
        Of scores.
    poses, sweep_poses : tuple of str
        Pose sets of the part `methods`, and of sweeps.
    training_frames : int
        Frames of every training but those of the part `frames`.
    frames, amplitudes, times, noises : tuple
        Numbers of training poses, standard deviations in rad, training minutes, factors of the surface noise.
    ablations : tuple of str
        Of `ABLATIONS`.
    twist : mapping
        Arguments of `benchmarks.study.twist.twist_table`; of them
        `benchmarks.study.failures.failure_figures` takes all but the degrees.
    """

    characters: Mapping[str, int]
    sweep: str | None
    minutes: Mapping[str, float]
    sweep_minutes: float | None
    settings: Mapping[str, Any] = field(default_factory=dict)
    made_of: Mapping[str, str] = field(default_factory=dict)
    points: int = POINTS
    resolution: int = RESOLUTION
    poses: tuple[str, ...] = POSE_SETS
    sweep_poses: tuple[str, ...] = SWEEP_SETS
    training_frames: int = FRAMES
    frames: tuple[int, ...] = (1, 3, 10, 30, 100)
    amplitudes: tuple[float, ...] = (0.1, 0.4, 0.8, 1.2)
    times: tuple[float, ...] = (0.25, 0.5, 1, 2, 5)
    noises: tuple[int, ...] = (1, 2, 3, 4)
    ablations: tuple[str, ...] = tuple(ABLATIONS)
    twist: Mapping[str, Any] = field(default_factory=dict)


def full_scale(names: Sequence[str], *, minutes: float, seeds: int, made_of: Mapping[str, str] | None = None) -> Scale:
    """The study as it is meant.

    Parameters
    ----------
    names : sequence of str
        Characters that are there.
    minutes : float
        Training time of the elephant and of MakeHuman's body; two fifths of it in sweeps, a fifth of it elsewhere.
    seeds : int
        Of the gingerbread men and the elephant; one for the others and in sweeps.
    made_of : mapping of str to str, optional
        Digests of the characters' files.
    """
    several = ("gingerbread-2d", "gingerbread-3d", "elephant")
    return Scale(
        characters={name: seeds if name in several else 1 for name in names},
        sweep="elephant" if "elephant" in names else None,
        minutes={name: minutes * (1.0 if name in ("elephant", "makehuman") else 0.2) for name in names},
        sweep_minutes=0.4 * minutes,
        made_of=dict(made_of or {}),
        twist={"minutes": 0.4 * minutes, "resolution": RESOLUTION},
    )


def quick_scale() -> Scale:
    """Everything once, so small that it takes seconds; its numbers mean nothing."""
    return Scale(
        characters={"gingerbread-2d": 1, "gingerbread-3d": 1},
        sweep="gingerbread-2d",
        minutes={},
        sweep_minutes=None,
        settings={
            "steps": 5,
            "width": 16,
            "depth": 3,
            "poses_per_step": 4,
            "points_per_pose": 64,
            "samples_per_frame": 400,
            "cache_resolution": 32,
            "weight_resolution": 32,
        },
        points=100,
        resolution=8,
        poses=("seen", "unseen"),
        sweep_poses=("unseen",),
        training_frames=2,
        frames=(1, 2),
        amplitudes=(0.4,),
        times=(0.002,),
        noises=(1, 3),
        ablations=("default", "no ghost bone"),
        twist={"resolution": 16, "degrees": (0, 150)},
    )
