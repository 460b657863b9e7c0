"""True posed surfaces against reconstructed ones, coloured by their distance."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from nilbs.figures.canvas import error_colours, plain, sheet, write_png
from nilbs.figures.surfaces import draw_body
from nilbs.figures.views import View
from nilbs.geometry.distance import closest_points
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.models.protocol import RESOLUTION

if TYPE_CHECKING:
    from nilbs.models.model import Model


def reconstruction_figure(
    model: "Model",
    path: str | Path,
    *,
    poses: Mapping[str, np.ndarray],
    surfaces: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    resolution: int = RESOLUTION,
) -> Path:
    """Draw the true surface of each pose (top) and the model's (bottom), coloured by the distance to the true one.

    The distance is that of the reconstructed vertices. The colours end at the 99th percentile over all poses.

    Parameters
    ----------
    model : Model
    path : path
        The PNG to write.
    poses : mapping of str to (b, d+1, d+1) float array
        Labels and poses, one column each.
    surfaces : mapping of str to (U, F), optional
        Reconstructed surfaces by label; missing ones are extracted on a grid of `resolution` cells.

    Raises
    ------
    ValueError
        If there is no pose.
    OSError
        If the file cannot be written.
    """
    if not poses:
        raise ValueError("poses is empty, expected at least one pose")
    character = model.character
    columns = []
    for label, B in poses.items():
        U_true = linear_blend_skinning(character.V, character.W, B)
        U, F = (surfaces or {}).get(label) or model.extract(B, resolution=resolution)
        error = 100 * closest_points(U_true, character.F, U)[0] / character.L
        columns.append((label, U_true, U, F, error))

    every = np.concatenate([error for *_, error in columns])
    top = float(np.percentile(every, 99)) if len(every) else 1.0
    colours = ScalarMappable(Normalize(0, max(top, 1e-6)), error_colours())
    figure, panels = sheet(2, len(columns), title=f"{character.name}: true and reconstructed surfaces", beside=1.0)
    view = View.front(character.V).turned()
    for column, (label, U_true, U, F, error) in enumerate(columns):
        lower, upper = view.window(U_true, U)
        draw_body(panels[0, column], view, U_true, character.F)
        draw_body(panels[1, column], view, U, F, values=error, colours=colours)
        plain(panels[0, column], title=label, lower=lower, upper=upper)
        mean = f"mean {error.mean():.3f}, largest {error.max():.2f} % of L" if len(error) else ""
        plain(panels[1, column], title=mean, lower=lower, upper=upper)
    panels[0, 0].set_ylabel("true (skinned mesh)", fontsize=9)
    panels[1, 0].set_ylabel("reconstructed", fontsize=9)
    bar = figure.colorbar(colours, ax=panels, fraction=0.025, shrink=0.8, extend="max")
    bar.set_label("distance to the true surface, % of L", fontsize=8)
    return write_png(figure, path)
