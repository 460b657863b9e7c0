"""Pictures of a trained model as PNG files: one function per figure, and one that writes them all."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nilbs.figures.canvas import evenly_spaced
from nilbs.figures.ghost import ghost_figure
from nilbs.figures.notation import notation_figure
from nilbs.figures.reconstruction import reconstruction_figure
from nilbs.figures.training import training_figure
from nilbs.figures.weights import weights_figure
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    from nilbs.models.model import Model

__all__ = [
    "figure_files",
    "ghost_figure",
    "notation_figure",
    "reconstruction_figure",
    "training_figure",
    "weights_figure",
    "write_figures",
]


def figure_files(model: "Model") -> list[str]:
    """Names of the files that `write_figures` writes; weights and ghost bone need a trained weight network."""
    network = "inverse" in model.method.mappings and bool(model.parameters)
    trained = len(model.history) > 0
    shown = {"notation": True, "weights": network, "ghost": network, "training": trained, "reconstruction": True}
    return [f"{name}.png" for name, there in shown.items() if there]


def write_figures(
    model: "Model",
    folder: str | Path,
    *,
    resolution: int = RESOLUTION,
) -> list[Path]:
    """Write the PNG files of `figure_files` and return their paths.

    Parameters
    ----------
    model : Model
    folder : path
        It is made if it is missing.
    resolution : int, optional
        Cells of the grid on which surfaces are extracted, in three evenly spaced training frames.

    Raises
    ------
    OSError
        If the folder cannot be made or a file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    motion = model.motion
    poses = {f"training frame {motion.frames[k]}": motion[k] for k in evenly_spaced(len(motion), 3)}
    drawn: Mapping[str, Callable[..., Path]] = {
        "notation.png": notation_figure,
        "weights.png": weights_figure,
        "ghost.png": ghost_figure,
        "training.png": training_figure,
        "reconstruction.png": partial(reconstruction_figure, poses=poses, resolution=resolution),
    }
    return [drawn[name](model, folder / name) for name in figure_files(model)]
