"""
A moving body pushes particles out of its way
=============================================

Each particle inside the body moves along the gradient of the distance until it is outside.

Run it as it is, or on your files::

    python examples/06_push_particles_out.py
    python examples/06_push_particles_out.py --mesh arm.obj --rig arm.tgf

Expect, within a minute: after every frame no particle is inside by the field, and hardly one in a thousand by the posed
mesh; and a picture, ``out/06_push_particles_out.png``.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

import nilbs
from nilbs.figures.canvas import evenly_spaced, plain, sheet, write_png
from nilbs.figures.surfaces import draw_body
from nilbs.figures.views import View
from nilbs.geometry import occupancy

HERE = Path(__file__).parent
MARGIN = 0.004  # of L, between particles and surface
ROUNDS = 40  # the most pushes in a frame


def pushed_out(model: nilbs.Model, x: torch.Tensor, B: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Particles (n, d) after the body in pose B has pushed out those inside."""
    L = model.character.L
    for done in range(ROUNDS):
        x = x.detach().requires_grad_()
        distance = model.answer(x, B).distance.to(x.device)
        near = distance < 0.5 * MARGIN * L
        if not near.any():
            break
        (slope,) = torch.autograd.grad(distance.sum(), x)
        # The distance is that at rest; divided by its slope it is the posed one, after stretching.
        step = (MARGIN * L - distance)[:, None] * slope / (slope**2).sum(dim=-1, keepdim=True).clamp_min(0.1)
        # Two limbs that overlap push into each other: longer and longer steps of random length lead out.
        step = step * torch.as_tensor(1 + 0.2 * done * rng.uniform(size=(len(x), 1)))
        x = torch.where(near[:, None], x + step, x)
    return x.detach()


def main() -> None:
    parser = argparse.ArgumentParser(description="Let a moving body push particles out of its way.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--particles", type=int, default=6000)
    parser.add_argument("--steps", type=int, default=300, help="of the training")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    # 1. A character, a motion and a field.
    character = nilbs.load_character(args.mesh, args.rig, progress=True)
    motion = nilbs.random_motion(character, frames=args.frames, seed=args.seed)
    model = nilbs.fit(character, motion, steps=args.steps, seed=args.seed, progress=True)

    # 2. Particles everywhere, and the body moving through them.
    rng = np.random.default_rng(args.seed)
    poses = [character.skin(motion[k]) for k in range(len(motion))]
    lower, upper = (np.array([bound(U, axis=0) for U in poses]) for bound in (np.min, np.max))
    x = torch.as_tensor(rng.uniform(lower.min(axis=0), upper.max(axis=0), (args.particles, character.d)))
    shown, inside = {}, []
    for k, U in enumerate(poses):
        x = pushed_out(model, x, torch.as_tensor(motion[k]), rng)
        inside.append(float(occupancy(U, character.F, x.numpy()).mean()))
        if k in evenly_spaced(len(motion), 4):
            shown[k] = (U, x.numpy().copy())
    print(f"{args.particles} particles, {len(motion)} frames: at most {100 * max(inside):.2f} % inside the posed mesh")

    # 3. Some of the frames.
    view = View.front(character.V)
    window = view.window(*poses)
    figure, panels = sheet(1, len(shown), title=f"{character.name} pushes particles out of its way")
    for panel, (k, (U, points)) in zip(panels[0], shown.items(), strict=True):
        panel.scatter(*view.project(points).T, s=0.6, color="#0072b2", linewidths=0)
        draw_body(panel, view, U, character.F)
        plain(panel, title=f"frame {k}", lower=window[0], upper=window[1])
    print(write_png(figure, args.out / "06_push_particles_out.png"))


if __name__ == "__main__":
    main()
