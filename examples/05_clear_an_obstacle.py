"""
Pose a character so that it clears an obstacle
==============================================

The obstacle is a ball around the tip of a bone. The distance of a field is differentiable by the pose, so gradient
descent on the joint angles moves the body until no point of the ball is inside.

Run it as it is, or on your files::

    python examples/05_clear_an_obstacle.py
    python examples/05_clear_an_obstacle.py --mesh arm.obj --rig arm.tgf

Expect, within a minute: the share of the ball inside the body falls to zero, also by the posed mesh, and a picture,
``out/05_clear_an_obstacle.png``.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

import nilbs
from nilbs.fields.kinematics import forward_kinematics
from nilbs.figures.canvas import plain, sheet, write_png
from nilbs.figures.surfaces import draw_body
from nilbs.figures.views import View
from nilbs.geometry import occupancy

HERE = Path(__file__).parent
MARGIN = 0.01  # of L, between body and obstacle


def main() -> None:
    parser = argparse.ArgumentParser(description="Pose a character so that it clears an obstacle.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument("--bone", help="bone with the obstacle around its tip; by default the farthest from the middle")
    parser.add_argument("--radius", type=float, default=0.06, help="of the obstacle, as a share of the body's size")
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--steps", type=int, default=300, help="of the training")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    # 1. A character and its field. The root search depends little on the network, so the training is short.
    character = nilbs.load_character(args.mesh, args.rig, progress=True)
    motion = nilbs.random_motion(character, frames=args.frames, seed=args.seed)
    model = nilbs.fit(character, motion, steps=args.steps, seed=args.seed, progress=True)

    # 2. An obstacle: points in a ball around the tip of a bone.
    rng = np.random.default_rng(args.seed)
    V, L, d = character.V, character.L, character.d
    tips = character.skeleton.C[character.skeleton.BE[:, 1]]
    if args.bone is None:
        bone = int(np.linalg.norm(tips - V.mean(axis=0), axis=1).argmax())
    elif args.bone in character.skeleton.names:
        bone = character.skeleton.names.index(args.bone)
    else:
        parser.error(f"there is no bone {args.bone!r}; the bones are {', '.join(character.skeleton.names)}")
    ball = rng.normal(size=(2000, d))
    ball *= args.radius * L * rng.uniform(0, 1, (len(ball), 1)) ** (1 / d) / np.linalg.norm(ball, axis=1, keepdims=True)
    ball += tips[bone]

    # 3. Gradient descent on the depth of the ball in the body, with a small penalty on every angle.
    x, C = torch.as_tensor(ball, dtype=torch.float32), torch.as_tensor(character.skeleton.C, dtype=torch.float32)
    theta = torch.zeros((len(character.skeleton.BE), 1 if d == 2 else 3), requires_grad=True)
    optimizer = torch.optim.Adam([theta], lr=0.03)
    for step in range(201):
        B = forward_kinematics(C, character.skeleton.BE, character.skeleton.P, theta)
        depth = (MARGIN - model.answer(x, B).distance / L).clamp_min(0)
        if step % 20 == 0:
            print(f"step {step:3}: deepest point {max(0.0, float(depth.detach().max()) - MARGIN):.4f} L inside")
        if step == 200 or not depth.any():
            break
        optimizer.zero_grad()
        (100 * depth.mean() + 1e-3 * (theta**2).sum()).backward()
        optimizer.step()

    # 4. Check with the posed mesh.
    before, after = (
        V,
        character.skin(
            forward_kinematics(C, character.skeleton.BE, character.skeleton.P, theta).detach().double().numpy()
        ),
    )
    shares = [occupancy(U, character.F, ball).mean() for U in (before, after)]
    print(f"share of the obstacle inside the body: {shares[0]:.3f} before, {shares[1]:.3f} after {step} steps")
    view = View.front(V)
    lower, upper = view.window(before, after, ball)
    figure, panels = sheet(
        1, 2, title=f"{character.name} clears an obstacle at the tip of {character.skeleton.names[bone]}"
    )
    for panel, U, title in zip(panels[0], (before, after), ("before", f"after {step} steps"), strict=True):
        draw_body(panel, view, U, character.F)
        panel.scatter(*view.project(ball).T, s=1, color="#0072b2", zorder=5)
        plain(panel, title=title, lower=lower, upper=upper)
    print(write_png(figure, args.out / "05_clear_an_obstacle.png"))


if __name__ == "__main__":
    main()
