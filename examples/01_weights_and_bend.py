"""
Skinning weights, and one bone bent
===================================

This example solves for the weights of a rigged mesh and bends one bone. It needs no training and never loads torch.

Run it as it is, or on your files::

    python examples/01_weights_and_bend.py
    python examples/01_weights_and_bend.py --mesh arm.obj --rig arm.tgf --bone bone2 --degrees 60

Expect, after a few seconds (some twenty for a mesh of 10,000 vertices): weights between 0 and 1 whose rows sum to one
within 1e-9, and a picture, ``out/01_weights_and_bend.png``. On the left, the bone's weight falls off smoothly around
its joint. On the right, the body follows the bent bone.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

import nilbs
from nilbs.figures.canvas import plain, sheet, write_png
from nilbs.figures.surfaces import draw_body, draw_bones
from nilbs.figures.views import View
from nilbs.geometry import forward_kinematics, linear_blend_skinning

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description="Solve for skinning weights and bend one bone.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument(
        "--bone", help="name of the bone to bend, such as bone2; by default the one with the largest weights"
    )
    parser.add_argument("--degrees", type=float, default=30.0)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()

    # 1. Read the files and solve for the weights.
    character = nilbs.load_character(args.mesh, args.rig, progress=True)
    W = character.W
    print(f"{character.name}: {len(character.V)} vertices, {len(character.skeleton.names)} bones, d = {character.d}")
    print(f"weights: {W.min():.3f} to {W.max():.3f}, row sums within {np.abs(W.sum(axis=1) - 1).max():.1e} of one")

    # 2. Bend one bone about the line of sight. Local rotations are relative to the parent bone.
    joints = np.flatnonzero(character.skeleton.P >= 0)
    if args.bone is None:
        movable = joints if len(joints) else np.arange(len(character.skeleton.P))
        bone = int(movable[np.argmax(W[:, movable].sum(axis=0))])
    elif args.bone in character.skeleton.names:
        bone = character.skeleton.names.index(args.bone)
    else:
        parser.error(f"there is no bone {args.bone!r}; the bones are {', '.join(character.skeleton.names)}")
    view = View.front(character.V)
    angle = np.radians(args.degrees)
    theta = np.zeros((len(character.skeleton.P), 1 if character.d == 2 else 3))
    theta[bone] = angle if character.d == 2 else angle * view.axes[2]
    B = forward_kinematics(character.skeleton.C, character.skeleton.BE, character.skeleton.P, theta)
    U = linear_blend_skinning(character.V, W, B)

    # 3. Draw the bone's weight at rest, and the bent body.
    args.out.mkdir(parents=True, exist_ok=True)
    title = f"{character.name}: {character.skeleton.names[bone]} bent by {args.degrees:g} degrees"
    figure, panels = sheet(1, 2, title=title, width=3.6, height=3.6, beside=1.0)
    view = view.turned()
    lower, upper = view.window(character.V, U)
    colours = ScalarMappable(Normalize(0, 1), "viridis")
    poses = ((character.V, np.broadcast_to(np.eye(character.d + 1), B.shape), "rest"), (U, B, "bent"))
    for panel, (vertices, pose, name) in zip(panels[0], poses, strict=True):
        draw_body(panel, view, vertices, character.F, values=W[:, bone], colours=colours)
        if character.d == 2:  # in the plane, show the inside too
            X = linear_blend_skinning(character.V_volume, character.W_volume, pose)
            weight = character.W_volume[:, bone]
            panel.tripcolor(*X.T, character.T, weight, vmin=0, vmax=1, cmap="viridis", shading="gouraud")
        draw_bones(panel, view, character.skeleton.C, character.skeleton.BE, B=pose, colour="#d55e00")
        plain(panel, title=name, lower=lower, upper=upper)
    figure.colorbar(colours, ax=panels, fraction=0.03, label=f"weight of {character.skeleton.names[bone]}")
    print(write_png(figure, args.out / "01_weights_and_bend.png"))


if __name__ == "__main__":
    main()
