"""The training curve."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nilbs.figures.canvas import AXES, sheet, write_png

if TYPE_CHECKING:
    from nilbs.models.model import Model


def training_figure(model: "Model", path: str | Path) -> Path:
    """Draw the training loss over the steps, with its running median."""
    history = np.asarray(model.history, dtype=float)
    figure, panels = sheet(1, 1, title=f"{model.character.name}: training loss", width=5.5, height=3.2)
    panel = panels[0, 0]
    panel.plot(np.arange(1, len(history) + 1), history, color="#bbbbbb", linewidth=0.6, label="each step")
    window = max(1, len(history) // 50)
    if window > 1:
        at, median = running_median(history, window)
        panel.plot(at, median, color=AXES[2], linewidth=1.6, label=f"median of {window} steps")
    if (history > 0).all():
        panel.set_yscale("log")
    panel.set_xlabel("step", fontsize=9)
    panel.set_ylabel("loss", fontsize=9)
    panel.grid(color="#e5e5e5", linewidth=0.6)
    panel.legend(fontsize=8, frameon=False)
    return write_png(figure, path)


def running_median(values: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles and medians of consecutive windows of values (n,); the first value is at 1.

    Examples
    --------
    >>> running_median(np.array([5.0, 1.0, 3.0, 2.0]), 3)
    (array([2., 3.]), array([3., 2.]))
    """
    windows = np.lib.stride_tricks.sliding_window_view(values, window)
    return np.arange(len(windows)) + (window + 1) / 2, np.median(windows, axis=1)
