"""The paper's third figure: the effect of the ghost bone on occupancy."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from nilbs.figures.canvas import (
    FALSE_INSIDE,
    FALSE_OUTSIDE,
    INK,
    OUTSIDE,
    RIGHT_INSIDE,
    evenly_spaced,
    plain,
    sheet,
    write_png,
)
from nilbs.figures.views import Section, View
from nilbs.geometry.metrics import intersection_over_union
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy

if TYPE_CHECKING:
    from nilbs.models.model import Model


def ghost_figure(model: "Model", path: str | Path, *, pose: np.ndarray | None = None, label: str = "posed") -> Path:
    """Draw true occupancy, the inverse map's without and with the ghost bone, and the root search's.

    Without a `pose`, it is the one of ten training frames in which the ghost bone changes most. The intersection over
    union is that of the pixels, in a square 1.5 times as large as the body; it is not a score of the protocol.
    """
    character, motion = model.character, model.motion
    front = View.front(character.V)
    note = ""
    if pose is None:
        candidates = evenly_spaced(len(motion), 10)
        changed = [_changed(model, front, motion[k]) for k in candidates]
        frame = candidates[int(np.argmax(changed))]
        pose, label = motion[frame], f"training frame {motion.frames[frame]}"
        note = f" (the frame of {len(candidates)} in which the ghost bone changes most)"
        if not max(changed):
            note = f" (the ghost bone changes none of {len(candidates)} frames)"

    U = linear_blend_skinning(character.V, character.W, pose)
    section = Section.through(front, U, scale=1.5, pixels=240)
    x = section.points()
    true = occupancy(U, character.F, x)
    predictions = {
        "truth": true,
        "without the ghost bone": model.occupancy(x, pose, mapping="inverse", ghost=False) > 0.5,
        "with the ghost bone": model.occupancy(x, pose, mapping="inverse") > 0.5,
        "by root search": model.occupancy(x, pose, mapping="search") > 0.5,
    }
    figure, panels = sheet(2, 2, title=f"{character.name}: {label}{note}", width=3.2, height=3.2)
    palette = np.array([[to_rgb(OUTSIDE), to_rgb(FALSE_INSIDE)], [to_rgb(FALSE_OUTSIDE), to_rgb(RIGHT_INSIDE)]])
    outline = section.cut(U, character.F)
    for panel, (name, inside) in zip(panels.ravel(), predictions.items(), strict=True):
        colours = section.image(palette[true.astype(int), inside.astype(int)])
        panel.imshow(colours, origin="lower", extent=section.extent, interpolation="nearest")
        panel.add_collection(LineCollection(list(outline), colors=INK, linewidths=0.7))
        score = "" if name == "truth" else f"\nIoU of the pixels {intersection_over_union(inside, true):.4f}"
        plain(panel, title=name + score)
    keys = [
        Patch(facecolor=RIGHT_INSIDE, label="correctly inside"),
        Patch(facecolor=FALSE_INSIDE, label="wrongly inside"),
        Patch(facecolor=FALSE_OUTSIDE, label="wrongly outside"),
    ]
    if character.d == 3:
        panels[0, 0].set_xlabel("planar section through the body", fontsize=8)
    figure.legend(handles=keys, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return write_png(figure, path)


def _changed(model: "Model", front: View, pose: np.ndarray) -> float:
    """The share of a coarse section's pixels that the ghost bone changes."""
    U = linear_blend_skinning(model.character.V, model.character.W, pose)
    x = Section.through(front, U, scale=1.5, pixels=48).points()
    with_ghost, without = (model.occupancy(x, pose, mapping="inverse", ghost=ghost) > 0.5 for ghost in (True, False))
    return float(np.mean(with_ghost != without))
