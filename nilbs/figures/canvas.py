"""The sheet of every figure: size, fonts, colours, and writing it."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure

from nilbs.io.atomic import replacing

# Okabe and Ito's palette, which works for any colour vision.
BODY = "#c9a27a"
INK = "#333333"
AXES = ("#d55e00", "#009e73", "#0072b2")
FALSE_INSIDE = "#d55e00"
FALSE_OUTSIDE = "#0072b2"
RIGHT_INSIDE = "#9a9a9a"
OUTSIDE = "#ffffff"

WEIGHTS = "viridis"
DPI = 150


def error_colours() -> Colormap:
    """Colours for distances: lightness falls steadily, and zero is visible on white."""
    from matplotlib import colormaps

    return LinearSegmentedColormap.from_list("error", colormaps["YlOrRd"](np.linspace(0.2, 1.0, 64)))


def evenly_spaced(length: int, n: int) -> list[int]:
    """At most n of `length` frames, evenly spaced from the first.

    The last frame is left out, because in a motion that repeats it is the first pose again.

    Examples
    --------
    >>> evenly_spaced(100, 3), evenly_spaced(2, 3)
    ([0, 33, 66], [0, 1])
    """
    n = min(n, length)
    return [k * length // n for k in range(n)]


def sheet(
    rows: int, columns: int, *, title: str, width: float = 2.6, height: float = 2.75, beside: float = 0.3
) -> tuple[Figure, np.ndarray]:
    """An empty figure and its panels (rows, columns), each `width` by `height` inches.

    `beside` inches on the right are for a colour bar.

    Examples
    --------
    >>> figure, panels = sheet(2, 3, title="Six panels")
    >>> panels.shape
    (2, 3)
    """
    figure = Figure(figsize=(columns * width + beside, rows * height + 0.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12)
    return figure, figure.subplots(rows, columns, squeeze=False)


def plain(panel: Axes, *, title: str = "", lower: np.ndarray | None = None, upper: np.ndarray | None = None) -> None:
    """Remove a panel's ticks, make its units square, and set its window from `lower` and `upper`."""
    panel.set_aspect("equal")
    panel.set_xticks([])
    panel.set_yticks([])
    for spine in panel.spines.values():
        spine.set_color("#bbbbbb")
    if title:
        panel.set_title(title, fontsize=9, color=INK)
    if lower is not None and upper is not None:
        panel.set_xlim(lower[0], upper[0])
        panel.set_ylim(lower[1], upper[1])


def write_png(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, completely or not at all, and return its path."""
    with replacing(path, "wb") as file:
        figure.savefig(file, format="png")
    return Path(path)
