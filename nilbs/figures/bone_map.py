"""Figure of two skeletons side by side: which bones of a character follow which bones of a motion."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from nilbs.figures.canvas import INK, plain, sheet, write_png
from nilbs.figures.surfaces import draw_bones
from nilbs.figures.views import View
from nilbs.geometry.skeleton import Skeleton

ALONE = "#bbbbbb"


def bone_map_figure(
    source: Skeleton, target: Skeleton, bone_map: Mapping[str, str | None], path: str | Path, *, title: str
) -> Path:
    """Draw the skeleton of a motion beside that of a character; bones that follow each other have one colour.

    Parameters
    ----------
    source, target : Skeleton
        In poses that correspond to each other, in the same axes.
    bone_map : mapping of str to str or None
        For bones of the target, by name, the bones of the source that they follow.
    path : path
        The picture, .png.
    title : str

    Returns
    -------
    path : Path
    """
    led = list(dict.fromkeys(name for name in bone_map.values() if name is not None))
    shade = colormaps["turbo"](np.linspace(0.05, 0.95, max(len(led), 1)))
    colours = {name: tuple(colour) for name, colour in zip(led, shade, strict=False)}
    figure, panels = sheet(1, 2, title=title, width=5.0, height=5.5)
    view = View.front(target.C)
    followed = [colours.get(bone_map.get(name) or "", ALONE) for name in target.names]
    _draw(panels[0, 0], view, source, [colours.get(name, ALONE) for name in source.names], "motion")
    _draw(panels[0, 1], view, target, followed, "character at rest")
    return write_png(figure, path)


def _draw(panel: Axes, view: View, skeleton: Skeleton, colours: list, title: str) -> None:
    """One skeleton, with the names of bones that have a partner."""
    ends = skeleton.C[skeleton.BE]
    child = np.flatnonzero(skeleton.P >= 0)
    links = np.column_stack([skeleton.BE[skeleton.P[child], 0], skeleton.BE[child, 0]])
    draw_bones(panel, view, skeleton.C, links, colour=ALONE)
    for bone, colour in enumerate(colours):
        draw_bones(panel, view, skeleton.C, skeleton.BE[bone : bone + 1], colour=colour)
        if colour != ALONE:
            panel.annotate(
                skeleton.names[bone], tuple(view.project(ends[bone].mean(axis=0))), fontsize=5, color=INK, zorder=6
            )
    lower, upper = view.window(ends.reshape(-1, skeleton.d))
    plain(panel, title=title, lower=lower, upper=upper)
