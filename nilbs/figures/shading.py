"""Pictures of shaded skin from the normals of its pixels."""

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb

from nilbs.figures.canvas import BODY
from nilbs.figures.surfaces import AMBIENT, LIGHT
from nilbs.figures.views import View
from nilbs.io.atomic import replacing


def write_shaded(normal: np.ndarray, view: View, path: str | Path) -> None:
    """Write a picture, .png, of skin with these unit normals (h, w, 3); white where they are nan."""
    from PIL import Image

    light = np.clip((normal @ view.axes.T) @ (LIGHT / np.linalg.norm(LIGHT)), 0, None)
    colour = np.array(to_rgb(BODY)) * (AMBIENT + (1 - AMBIENT) * light)[..., None]
    picture = np.where(np.isnan(colour), 1.0, colour)
    with replacing(path) as file:
        Image.fromarray(np.round(255 * picture).astype(np.uint8)).save(file, format="PNG")
