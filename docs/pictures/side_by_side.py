"""The README's picture: a posed 3D character as it is, by nilbs, and by the weights of the nearest vertex.

    nilbs train examples/assets/cookie.obj examples/assets/gingerbread.tgf --steps 600 -o out/cookie.nilbs
    python docs/pictures/side_by_side.py out/cookie.nilbs

Expect docs/images/side-by-side.png after about a minute. The training never saw the pose. Surfaces are extracted on a
grid of 192 cells. Places farther than 0.3 % of L from the true surface are blue.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from render import render

import nilbs
from nilbs.figures.canvas import DPI, FALSE_OUTSIDE, write_png
from nilbs.figures.views import View
from nilbs.geometry.distance import closest_points
from nilbs.geometry.kinematics import forward_kinematics

IMAGES = Path(__file__).parents[1] / "images"
DOUGH, LABEL = "#d9a66c", "#808080"
WRONG = (0.001, 0.003)  # of L: where the colour begins to turn, and where it has turned
# A dance, one hand on the hip: local rotations of the gingerbread man's bones, in degrees.
DANCE = {
    "bone1": (0, -12, 4),
    "bone2": (0, 0, -12),
    "bone3": (0, 0, -40),
    "bone4": (0, -18, -60),
    "bone5": (0, -10, -25),
    "bone6": (0, 0, -32),
    "bone7": (0, 0, -12),
    "bone8": (0, 15, -22),
    "bone9": (0, 0, -30),
    "bone10": (0, 0, -10),
    "bone11": (-25, 0, -22),
    "bone12": (40, 0, 40),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw a posed character beside two reconstructions.")
    parser.add_argument("model", type=Path, help="a model of examples/assets/cookie.obj, by `nilbs train`")
    parser.add_argument("--resolution", type=int, default=192)
    parser.add_argument("--pixels", type=int, default=520)
    parser.add_argument("--out", type=Path, default=IMAGES / "side-by-side.png")
    args = parser.parse_args()

    model = nilbs.load_model(args.model)
    character, skeleton = model.character, model.character.skeleton
    nearest = nilbs.fit(character, model.motion, method="nearest")
    theta = np.zeros((len(skeleton.P), 3))
    for name, angles in DANCE.items():
        theta[skeleton.names.index(name)] = np.radians(angles)
    pose = forward_kinematics(skeleton.C, skeleton.BE, skeleton.P, theta)
    U, F = character.skin(pose), character.F
    surfaces = {
        "true": (U, F),
        "nilbs": model.extract(pose, resolution=args.resolution),
        "nearest vertex": nearest.extract(pose, resolution=args.resolution),
    }
    view = View.front(character.V).turned(azimuth=20, elevation=10)
    window = view.window(*(vertices for vertices, _ in surfaces.values()), margin=0.01)
    images = {}
    for name, (vertices, facets) in surfaces.items():
        off = closest_points(U, F, vertices)[0] / character.L
        share = np.clip((off - WRONG[0]) / (WRONG[1] - WRONG[0]), 0, 1)[:, None]
        colours = (1 - share) * to_rgb(DOUGH) + share * to_rgb(FALSE_OUTSIDE)
        images[name] = render(vertices, facets, colours, view=view, window=window, pixels=args.pixels)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    print(write_png(_in_a_row(images), args.out))


def _in_a_row(images: dict[str, np.ndarray]) -> Figure:
    """The pictures beside each other, on a transparent ground, each above its name."""
    covered = np.flatnonzero(sum(image[..., 3].sum(axis=0) for image in images.values()))
    cut = slice(max(covered[0] - 40, 0), covered[-1] + 41)
    images = {name: image[:, cut] for name, image in images.items()}
    rows, columns = next(iter(images.values())).shape[:2]
    figure = Figure(figsize=(len(images) * columns / DPI, rows / DPI + 0.35), dpi=DPI)
    FigureCanvasAgg(figure)
    figure.patch.set_alpha(0)
    foot = 0.35 / figure.get_figheight()
    for k, (name, image) in enumerate(images.items()):
        panel = figure.add_axes((k / len(images), foot, 1 / len(images), 1 - foot))
        panel.imshow(image)
        panel.set_axis_off()
        figure.text((k + 0.5) / len(images), foot / 2, name, ha="center", va="center", fontsize=12, color=LABEL)
    return figure


if __name__ == "__main__":
    main()
