"""Posed bodies on paper: filled outlines in 2D, shaded triangles in 3D, and the bones over either."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from nilbs.figures.canvas import AXES, BODY, INK
from nilbs.figures.views import View
from nilbs.geometry.facets import is_watertight

LIGHT = np.array([-0.35, 0.45, 0.82])  # right, up, toward the viewer
AMBIENT = 0.45


def draw_body(
    panel: Axes,
    view: View,
    U: np.ndarray,
    F: np.ndarray,
    *,
    values: np.ndarray | None = None,
    colours: ScalarMappable | None = None,
    colour: str = BODY,
) -> None:
    """Draw a posed surface; `colours` maps `values` (n,) of the vertices, without values the body has one `colour`.

    In space, triangles are drawn in the order of their centres' depth, so large triangles of close sheets may be in the
    wrong order; back faces of a closed surface are left out. In the plane, inside is a winding number other than 0.
    """
    if not len(F):
        panel.text(0.5, 0.5, "empty surface", transform=panel.transAxes, ha="center", va="center", fontsize=9)
        return
    coloured = values is not None and colours is not None
    paint = None
    if values is not None and colours is not None:
        paint = colours.to_rgba(values[F].mean(axis=1))[:, :3]
    if U.shape[1] == 2:
        fill = "#eeeeee" if coloured else colour
        panel.add_patch(PathPatch(_outline(U, F), facecolor=fill, edgecolor="none" if coloured else INK, linewidth=0.7))
        if paint is not None:
            panel.add_collection(LineCollection(list(U[F]), colors=paint, linewidths=2.2, capstyle="round"))
        return
    corners = U[F]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ view.axes.T
    seen = np.flatnonzero(normals[:, 2] > 0) if is_watertight(F) else np.flatnonzero(normals[:, 2])
    order = seen[np.argsort(corners[seen].mean(axis=1) @ view.axes[2])]
    normals = normals[order] * np.sign(normals[order, 2:]) / np.linalg.norm(normals[order], axis=1, keepdims=True)
    light = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, None)
    shade = AMBIENT + (1 - AMBIENT) * light
    if paint is not None:
        shaded = paint[order] * (0.5 + 0.5 * shade[:, None])  # weaker, so that shading is not read as a value
    else:
        shaded = np.array(to_rgb(colour)) * shade[:, None]
    # A hairline in the triangle's own colour closes the seams that antialiasing leaves.
    panel.add_collection(
        PolyCollection(list(view.project(corners[order])), facecolors=shaded, edgecolors=shaded, linewidths=0.25)
    )


def draw_bones(
    panel: Axes, view: View, C: np.ndarray, BE: np.ndarray, *, B: np.ndarray | None = None, colour: str = INK
) -> None:
    """Draw bones as lines with dots at both ends, posed if B is given."""
    ends = C[BE]
    if B is not None:
        d = C.shape[1]
        ends = np.einsum("bij,bkj->bki", B[:, :d, :d], ends) + B[:, None, :d, d]
    flat = view.project(ends)
    panel.add_collection(LineCollection(list(flat), colors=colour, linewidths=1.0, zorder=5))
    panel.plot(*flat.reshape(-1, 2).T, ".", color=colour, markersize=2.5, zorder=5)


def draw_frames(panel: Axes, view: View, C: np.ndarray, BE: np.ndarray, *, length: float) -> None:
    """Draw every bone's rest frame: the world's axes at its first joint, as arrows of one length."""
    d = C.shape[1]
    for axis, colour in zip(np.eye(d), AXES, strict=False):
        start = view.project(C[BE[:, 0]])
        along = np.broadcast_to(view.project(length * axis), start.shape)
        panel.quiver(
            *start.T,
            *along.T,
            color=colour,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.009,
            headwidth=3.5,
            zorder=6,
        )


def _outline(U: np.ndarray, F: np.ndarray) -> Outline:
    """The edges F joined end to end into closed curves."""
    following: dict[int, list[int]] = {}
    for first, second in F.tolist():
        following.setdefault(first, []).append(second)
    vertices, codes = [], []
    while following:
        start = at = next(iter(following))
        loop = []
        while at in following:
            loop.append(at)
            after = following[at].pop()
            if not following[at]:
                del following[at]
            at = after
            if at == start:
                break
        vertices += [*loop, start]
        codes += [Outline.MOVETO, *[Outline.LINETO] * (len(loop) - 1), Outline.CLOSEPOLY]
    return Outline(U[vertices], codes)
