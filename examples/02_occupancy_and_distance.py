"""
Occupancy and distance of a posed body
======================================

This example computes, without a network, which points are inside a posed body, how far they are from its surface, and a
surface at a given distance.

Run it as it is, or on your files::

    python examples/02_occupancy_and_distance.py
    python examples/02_occupancy_and_distance.py --mesh arm.obj --rig arm.tgf --frame 30

Expect, after some ten seconds:

* The body's area (in space: volume), estimated from points, agrees with the exact one to about one per cent.
* Distance is negative where the exact winding number is above one half.
* ``out/02_occupancy_and_distance.png`` shows both on a section.
* ``out/02_offset.obj`` is the surface at a distance of 2 % of L from the body.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection

import nilbs
from nilbs.figures.canvas import INK, plain, sheet, write_png
from nilbs.figures.views import Section, View
from nilbs.geometry import (
    Grid,
    enclosed_volume,
    isosurface,
    linear_blend_skinning,
    occupancy,
    signed_distance,
    winding_number,
)
from nilbs.geometry.sampling import uniform_samples
from nilbs.io.mesh import write_mesh

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description="Occupancy and signed distance of a posed body.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument("--frame", type=int, default=25, help="frame of a generated motion of 100")
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--resolution", type=int, default=64, help="cells along the longest edge of the grid")
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    # 1. A pose of the character: its mesh, skinned.
    character = nilbs.load_character(args.mesh, args.rig, progress=True)
    motion = nilbs.random_motion(character, seed=0)
    if not 0 <= args.frame < len(motion):
        parser.error(f"there is no frame {args.frame}: the motion has {len(motion)}, counted from 0")
    pose = motion[args.frame]
    U, F = linear_blend_skinning(character.V, character.W, pose), character.F

    # 2. Occupancy of points. An overlap of the body with itself is inside, and counts once.
    grid = Grid.cube(U, 1)
    x = uniform_samples(grid.lower, grid.upper, args.points, rng=np.random.default_rng(0))
    inside = occupancy(U, F, x)
    share = inside.mean() * float(np.prod(grid.upper - grid.lower))
    kind, enclosed = "area" if character.d == 2 else "volume", enclosed_volume(U, F)  # counts an overlap twice
    print(f"{kind} from {len(x)} points {share:.5f}, enclosed {enclosed:.5f}")

    # 3. Signed distance, in mesh units. Compare its sign with the exact winding number, a slow sum over all facets.
    distance = signed_distance(U, F, x)
    some = slice(None, None, 20)
    exact = np.abs(winding_number(U, F, x[some], exact=True)) > 0.5
    agree = ((distance[some] < 0) == exact).sum()
    print(f"distance {distance.min():.4f} to {distance.max():.4f}, correct sign at {agree} of {len(exact)} points")

    # 4. The surface at one distance. L is the longest edge of the rest mesh's box.
    grid = Grid.box(U, args.resolution, pad=0.1)
    values = np.empty(grid.size)
    for part, nodes in grid.chunks(100_000):
        values[part] = signed_distance(U, F, nodes)
    U_offset, F_offset = isosurface(values.reshape(grid.shape), grid, level=0.02 * character.L)
    write_mesh(args.out / "02_offset.obj", U_offset, F_offset)
    print(args.out / "02_offset.obj", f"{len(U_offset)} vertices")

    # 5. Both on a section through the body.
    section = Section.through(View.front(character.V), U)
    x = section.points()
    figure, panels = sheet(
        1, 2, title=f"{character.name}: occupancy and signed distance", width=3.6, height=3.6, beside=1.0
    )
    image = section.image(occupancy(U, F, x))
    panels[0, 0].imshow(image, origin="lower", extent=section.extent, cmap="Greys", vmin=0, vmax=1.2)
    values = section.image(signed_distance(U, F, x)) / character.L * 100
    limit = 20
    shown = panels[0, 1].imshow(values, origin="lower", extent=section.extent, cmap="PuOr", vmin=-limit, vmax=limit)
    panels[0, 1].contour(values, levels=np.arange(-20, 21, 4), extent=section.extent, colors="white", linewidths=0.5)
    for panel, name in zip(panels[0], ("occupancy", "signed distance, lines every 4 % of L"), strict=True):
        panel.add_collection(LineCollection(list(section.cut(U, F)), colors=INK, linewidths=0.9))
        plain(panel, title=name)
    figure.colorbar(shown, ax=panels, fraction=0.03, extend="both", label="% of L, negative inside")
    print(write_png(figure, args.out / "02_occupancy_and_distance.png"))


if __name__ == "__main__":
    main()
