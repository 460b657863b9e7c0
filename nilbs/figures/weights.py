"""The paper's second figure: channels of the weight network, at rest and in a pose."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize

from nilbs.figures.canvas import WEIGHTS, plain, sheet, write_png
from nilbs.figures.surfaces import draw_bones
from nilbs.figures.views import Section, View
from nilbs.geometry.skinning import linear_blend_skinning

if TYPE_CHECKING:
    from nilbs.models.model import Model


# Number of bones drawn, those with the largest weights; the ghost bone is drawn too.
COLUMNS = 4


def weights_figure(model: "Model", path: str | Path) -> Path:
    """Draw channels of the network's weights: top at rest, bottom in the middle frame of the training motion."""
    character, motion = model.character, model.motion
    middle = len(motion) // 2
    pose, label = motion[middle], f"training frame {motion.frames[middle]}"
    bones = np.sort(np.argsort(-character.W.sum(axis=0), kind="stable")[:COLUMNS])
    channels = [*bones.tolist(), len(character.skeleton.names)]

    figure, panels = sheet(2, len(channels), title=f"{character.name}: channels of the weight network", beside=1.0)
    front = View.front(character.V)
    for row, (name, B) in enumerate((("rest", np.broadcast_to(np.eye(character.d + 1), pose.shape)), (label, pose))):
        U = linear_blend_skinning(character.V, character.W, B)
        section = Section.through(front, U, pixels=240)
        W = section.image(model.weights(section.points(), B))
        surface = section.cut(U, character.F)
        for panel, channel in zip(panels[row], channels, strict=True):
            panel.imshow(W[..., channel], origin="lower", extent=section.extent, cmap=WEIGHTS, vmin=0, vmax=1)
            panel.add_collection(LineCollection(list(surface), colors="white", linewidths=0.8))
            if channel < len(character.skeleton.names):
                draw_bones(
                    panel,
                    front,
                    character.skeleton.C,
                    character.skeleton.BE[[channel]],
                    B=B[[channel]],
                    colour="#d55e00",
                )
            title = character.skeleton.names[channel] if channel < len(character.skeleton.names) else "ghost bone"
            plain(panel, title=title if row == 0 else "")
        panels[row, 0].set_ylabel(name, fontsize=9)
    where = " on a planar section" if character.d == 3 else ""
    bar = figure.colorbar(ScalarMappable(Normalize(0, 1), WEIGHTS), ax=panels, fraction=0.025, shrink=0.8)
    bar.set_label(f"weight{where}; the surface in white, the bone in orange", fontsize=8)
    return write_png(figure, path)
