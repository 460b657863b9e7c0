"""Depths of contacts over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nilbs.figures.canvas import AXES, sheet, write_png

if TYPE_CHECKING:
    from nilbs.contacts.timeline import Timeline


def timeline_figure(timelines: "Sequence[Timeline]", L: float, path: str | Path, *, title: str) -> Path:
    """Draw the depth of the deepest contact in each frame, as a share of the body's longest edge."""
    figure, panels = sheet(1, 1, title=title, width=7.5, height=3.0)
    panel = panels[0, 0]
    for k, timeline in enumerate(timelines):
        seconds = np.array([f.seconds for f in timeline.frames])
        depth = 100 * np.array([f.depth for f in timeline.frames]) / L
        colour = AXES[k % len(AXES)]
        panel.plot(seconds, depth, color=colour, linewidth=1.4, label=f"with {timeline.name}")
        panel.fill_between(seconds, depth, color=colour, alpha=0.15, linewidth=0)
        for f in timeline.worst[:1]:
            panel.plot([f.seconds], [100 * f.depth / L], marker="o", markersize=4, color=colour)
            label = f"frame {f.frame}: {' and '.join(f.bones or ())}"
            right = f.seconds > (seconds[0] + seconds[-1]) / 2
            panel.annotate(
                label, (f.seconds, 100 * f.depth / L), xytext=(-6 if right else 6, 4), textcoords="offset points",
                fontsize=8, ha="right" if right else "left",
            )  # fmt: skip
    panel.set_ylim(bottom=0)
    panel.margins(y=0.2)
    panel.set_xlabel("seconds", fontsize=9)
    panel.set_ylabel("deepest contact, % of L", fontsize=9)
    panel.grid(color="#e5e5e5", linewidth=0.6)
    panel.legend(fontsize=8, frameon=False)
    return write_png(figure, path)
