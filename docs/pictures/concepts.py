"""The pictures of docs/concepts.md.

    make demo
    python docs/pictures/concepts.py out/demo/gingerbread.nilbs

Expect five files in docs/images, after some ten seconds: rest-and-pose.png, forward-map.png, canonical-points.png,
ghost-bone.png and root-search.png.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.patches import ConnectionPatch, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke

import nilbs
from nilbs.figures import ghost_figure
from nilbs.figures.canvas import INK, plain, sheet, write_png
from nilbs.figures.surfaces import draw_body, draw_bones, draw_frames
from nilbs.figures.views import Section, View
from nilbs.geometry import forward_kinematics, linear_blend_skinning, occupancy, volume_interpolation

IMAGES = Path(__file__).parents[1] / "images"
ROOT, QUERY = "#0072b2", "#d55e00"
VIEW = View(np.eye(2))
WAVE = {3: -22.0, 4: -20.0, 6: 8.0, 8: -18.0, 9: -20.0, 10: -15.0, 11: -18.0}  # local rotations by bone, in degrees
FOLDED = {8: 62.0, 9: 40.0, 10: 10.0}  # an arm over the body


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the pictures of the page on concepts.")
    parser.add_argument("model", type=Path, help="a model of the flat gingerbread man, by `make demo`")
    parser.add_argument("--out", type=Path, default=IMAGES)
    args = parser.parse_args()
    model = nilbs.load_model(args.model)
    args.out.mkdir(parents=True, exist_ok=True)
    for draw in (rest_and_pose, forward_map, canonical_points, root_search):
        print(draw(model, args.out / f"{draw.__name__.replace('_', '-')}.png"))
    print(ghost_figure(model, args.out / "ghost-bone.png"))


def posed(model: nilbs.Model, degrees: dict[int, float]) -> np.ndarray:
    """A pose (b, 3, 3) from local rotations."""
    s = model.character.skeleton
    theta = np.zeros((len(s.P), 1))
    theta[list(degrees), 0] = np.radians(list(degrees.values()))
    return forward_kinematics(s.C, s.BE, s.P, theta)


def skinned(model: nilbs.Model, x_rest: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The forward map of rest points (n, 2) in the body (eq. 4)."""
    c = model.character
    return linear_blend_skinning(x_rest, volume_interpolation(c.V_volume, c.T, c.W_volume, x_rest), B)


def rest_and_pose(model: nilbs.Model, path: Path) -> Path:
    """Bones at rest and posed, and a point that follows."""
    c, B = model.character, posed(model, WAVE)
    U = c.skin(B)
    figure, panels = sheet(1, 2, title="", width=3.4, height=3.2)
    rest, pose = panels[0]
    lower, upper = VIEW.window(c.V, U)
    draw_body(rest, VIEW, c.V, c.F)
    draw_bones(rest, VIEW, c.skeleton.C, c.skeleton.BE)
    draw_frames(rest, VIEW, c.skeleton.C, c.skeleton.BE, length=0.07 * c.L)
    draw_body(pose, VIEW, U, c.F)
    draw_bones(pose, VIEW, c.skeleton.C, c.skeleton.BE, B=B)
    x_rest = np.array([[-0.3, 0.1]])
    x = skinned(model, x_rest, B)
    for panel, point, label in ((rest, x_rest, "x_rest"), (pose, x, "x")):
        _mark(panel, point, label, ROOT)
    figure.add_artist(
        ConnectionPatch(
            x_rest[0], x[0], "data", "data", axesA=rest, axesB=pose, arrowstyle="-|>", color=ROOT, shrinkA=6, shrinkB=6,
            connectionstyle="arc3,rad=-0.25",
        )
    )  # fmt: skip
    plain(rest, title="rest, with the bones' frames", lower=lower, upper=upper)
    plain(pose, title="posed", lower=lower, upper=upper)
    return write_png(figure, path)


def _mark(panel: Axes, point: np.ndarray, label: str, colour: str) -> None:
    """A dot with a label beside it, which is readable on anything."""
    panel.plot(*point.T, "o", color=colour, markersize=7, markeredgecolor="white", zorder=8)
    text = panel.annotate(label, point[0], (0, -17), textcoords="offset points", ha="center", color=colour, zorder=9)
    text.set_path_effects([withStroke(linewidth=3, foreground="white")])


def forward_map(model: nilbs.Model, path: Path) -> Path:
    """A grid of lines in the body, at rest and posed."""
    c, B = model.character, posed(model, WAVE)
    figure, panels = sheet(1, 2, title="", width=3.4, height=3.2)
    lines = _grid_lines(c.V, c.F, step=0.04 * c.L)
    lower, upper = VIEW.window(c.V, c.skin(B))
    for panel, pose, title in ((panels[0, 0], None, "rest"), (panels[0, 1], B, "posed by the forward map")):
        U = c.V if pose is None else c.skin(pose)
        draw_body(panel, VIEW, U, c.F)
        for axis, colour in enumerate((ROOT, INK)):
            drawn = [line if pose is None else skinned(model, line, pose) for line in lines[axis]]
            panel.add_collection(LineCollection(drawn, colors=colour, linewidths=0.7))
        plain(panel, title=title, lower=lower, upper=upper)
    return write_png(figure, path)


def _grid_lines(V: np.ndarray, F: np.ndarray, step: float) -> list[list[np.ndarray]]:
    """Pieces inside an outline of lines along x and along y."""
    lower, upper = V.min(axis=0), V.max(axis=0)
    lines: list[list[np.ndarray]] = [[], []]
    for axis in (0, 1):
        along = np.arange(lower[axis], upper[axis], step / 12)
        for across in np.arange(lower[1 - axis] + step / 2, upper[1 - axis], step):
            x = np.full((len(along), 2), across)
            x[:, axis] = along
            inside = occupancy(V, F, x) > 0
            breaks = np.flatnonzero(np.diff(inside.astype(int))) + 1
            pieces = zip(np.split(x, breaks), np.split(inside, breaks), strict=True)
            lines[axis] += [piece for piece, within in pieces if within[0] and len(piece) > 1]
    return lines


def canonical_points(model: nilbs.Model, path: Path) -> Path:
    """The body coloured by rest position, and posed points by their canonical points."""
    c, B = model.character, posed(model, WAVE)
    figure, panels = sheet(1, 2, title="", width=3.4, height=3.2)
    lower, upper = VIEW.window(c.V, c.skin(B))
    identity = np.broadcast_to(np.eye(3), B.shape)
    for panel, pose, title in ((panels[0, 0], identity, "rest"), (panels[0, 1], B, "posed, by canonical point")):
        U = c.skin(pose)
        section = Section(VIEW, (lower + upper) / 2, float((upper - lower)[0]), pixels=480)
        colours = model.values(lambda x_rest: _position_colours(x_rest, c.V), section.points(), pose, outside=1.0)
        panel.imshow(section.image(colours), origin="lower", extent=section.extent)
        panel.add_collection(LineCollection(list(U[c.F]), colors=INK, linewidths=0.8))
        plain(panel, title=title, lower=lower, upper=upper)
    return write_png(figure, path)


def _position_colours(x: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Colours (n, 3) by position, with a checker pattern."""
    s = (x - V.min(axis=0)) / np.ptp(V, axis=0)
    checker = 0.06 * (np.floor(s * 14).sum(axis=1) % 2)
    red, blue = 0.25 + 0.65 * s[:, 0], 0.25 + 0.65 * s[:, 1]
    return np.clip(np.column_stack([red, 0.75 - 0.35 * s.mean(axis=1), blue]) + checker[:, None], 0, 1)


def root_search(model: nilbs.Model, path: Path) -> Path:
    """The residual over rest space for a query in an overlap, and the searches that find its two roots."""
    c, B = model.character, posed(model, FOLDED)
    U = c.skin(B)
    s = c.skeleton
    query = linear_blend_skinning(s.C[s.BE[9, 1]][None], np.eye(len(s.P))[[9]], B)
    figure, panels = sheet(1, 2, title="", width=3.4, height=3.2, beside=0.9)
    left, right = panels[0]
    draw_body(left, VIEW, U, c.F)
    _mark(left, query, "x", QUERY)
    lower, upper = VIEW.window(c.V, U)
    plain(left, title="a query x in an overlap", lower=lower, upper=upper)

    section = Section(VIEW, (lower + upper) / 2, float((upper - lower)[0]), pixels=400)
    x_rest = section.points()
    residual = np.full(len(x_rest), np.nan)
    inside = occupancy(c.V, c.F, x_rest) > 0
    residual[inside] = np.linalg.norm(skinned(model, x_rest[inside], B) - query, axis=1) / c.L
    shown = right.imshow(
        section.image(residual), origin="lower", extent=section.extent, cmap="viridis", norm=LogNorm(3e-3, 1)
    )
    right.add_patch(PathPatch(_closed(c.V, c.F), facecolor="none", edgecolor=INK, linewidth=0.8))
    for bone in (1, 9, 10):
        steps = _newton(model, query, s.C[s.BE[bone]].mean(axis=0)[None], B)
        right.plot(
            *steps.T, "o-", color="white", markersize=2.5, linewidth=1.0, markeredgecolor=INK, markeredgewidth=0.4
        )
        right.plot(*steps[-1], "*", color=QUERY, markersize=10, markeredgecolor="white", zorder=8)
    plain(right, title="residual at rest, and searches from three starts", lower=lower, upper=upper)
    figure.colorbar(shown, ax=panels, fraction=0.03, label="residual, in L")
    return write_png(figure, path)


def _newton(model: nilbs.Model, x: np.ndarray, start: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Places (steps, 2) that Newton's method visits, with differences for derivatives; the slow twin of the search."""
    here, visited, h = start, [start[0]], 1e-4 * model.character.L
    for _ in range(8):
        value = skinned(model, here, B)
        jacobian = np.column_stack([(skinned(model, here + h * e, B) - value)[0] / h for e in np.eye(2)])
        step = np.linalg.solve(jacobian, (x - value)[0])
        here = here + step * min(1.0, 0.1 * model.character.L / max(np.linalg.norm(step), 1e-12))
        visited.append(here[0])
    return np.array(visited)


def _closed(V: np.ndarray, F: np.ndarray) -> Outline:
    """An outline as one path."""
    following = dict(F.tolist())
    loop = [next(iter(following))]
    while (after := following[loop[-1]]) != loop[0]:
        loop.append(after)
    return Outline(V[[*loop, loop[0]]], closed=True)


if __name__ == "__main__":
    main()
