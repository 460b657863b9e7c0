"""The paper's first figure: occupancy and bones, at rest and in training frames."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from nilbs.figures.canvas import AXES, evenly_spaced, plain, sheet, write_png
from nilbs.figures.surfaces import draw_body, draw_bones, draw_frames
from nilbs.figures.views import Section, View
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy

if TYPE_CHECKING:
    from nilbs.models.model import Model


def notation_figure(model: "Model", path: str | Path) -> Path:
    """Draw the character at rest and in three evenly spaced training frames, and the true occupancy below."""
    character, motion = model.character, model.motion
    rest = np.broadcast_to(np.eye(character.d + 1), motion[0].shape)
    shown = evenly_spaced(len(motion), 3)
    poses = [("rest", rest), *[(f"training frame {motion.frames[k]}", motion[k]) for k in shown]]
    posed = [linear_blend_skinning(character.V, character.W, B) for _, B in poses]

    figure, panels = sheet(2, len(poses), title=f"{character.name}: rest pose and training frames", height=2.95)
    front = View.front(character.V)
    view = front.turned()
    lower, upper = view.window(*posed)
    for column, ((label, B), U) in enumerate(zip(poses, posed, strict=True)):
        top, bottom = panels[:, column]
        draw_body(top, view, U, character.F)
        draw_bones(top, view, character.skeleton.C, character.skeleton.BE, B=B)
        if column == 0:
            draw_frames(top, view, character.skeleton.C, character.skeleton.BE, length=0.08 * character.L)
        plain(top, title=label, lower=lower, upper=upper)

        section = Section.through(front, U)
        inside = section.image(occupancy(U, character.F, section.points()))
        colours = np.array([[1.0, 1.0, 1.0], [0.2, 0.2, 0.2]])
        bottom.imshow(colours[inside.astype(int)], origin="lower", extent=section.extent, interpolation="nearest")
        plain(bottom, title="occupancy" + (", section" if character.d == 3 else ""))
    names = ("x", "y", "z")[: character.d]
    keys = [Line2D([], [], color=colour, label=f"{name} axis") for name, colour in zip(names, AXES, strict=False)]
    figure.legend(
        handles=keys, loc="outside lower left", ncols=4, fontsize=8, frameon=False, title="bone frames at rest"
    )
    return write_png(figure, path)
