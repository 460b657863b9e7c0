"""Neural inverse linear blend skinning: occupancy and distance of posed characters, for any rigged mesh.

The names here join reading files, fitting and scoring; every stage on arrays is in `nilbs.geometry`. Importing this
module loads neither torch nor any mesh library.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nilbs.character import Character as Character
    from nilbs.character import assemble as assemble
    from nilbs.evaluation import evaluate as evaluate
    from nilbs.fitting import fit as fit
    from nilbs.geometry.skeleton import Skeleton as Skeleton
    from nilbs.loading import load_character as load_character
    from nilbs.model import Model as Model
    from nilbs.model_file import load_model as load_model
    from nilbs.motion import Motion as Motion
    from nilbs.motion import random_motion as random_motion
    from nilbs.motion import read_motion as read_motion
    from nilbs.saving import save_character as save_character
    from nilbs.settings import Settings as Settings
    from nilbs.weighting import solve_weights as solve_weights

_HOMES = {
    "Character": "character",
    "assemble": "character",
    "Skeleton": "geometry.skeleton",
    "load_character": "loading",
    "evaluate": "evaluation",
    "Model": "model",
    "solve_weights": "weighting",
    "fit": "fitting",
    "load_model": "model_file",
    "Settings": "settings",
    "Motion": "motion",
    "random_motion": "motion",
    "read_motion": "motion",
    "save_character": "saving",
}
__all__ = sorted(_HOMES)
__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'nilbs' has no attribute {name!r}")
    return getattr(import_module(f"nilbs.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
