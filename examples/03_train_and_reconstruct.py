"""
Train a field, and extract a posed surface
==========================================

Run it as it is, or on your files::

    python examples/03_train_and_reconstruct.py
    python examples/03_train_and_reconstruct.py --mesh arm.obj --rig arm.tgf --steps 4000

Expect, within a minute:

* The loss falls by more than half.
* ``out/03_model.nilbs`` is the model; ``nilbs evaluate`` scores it.
* ``out/03_posed.obj`` is the body in a pose between two training frames.
* Two pictures show the training, and true and reconstructed surfaces.

So few steps are enough for the root search, which depends little on the network. ``nilbs evaluate --rows inverse``
scores the network alone.
"""

import argparse
from pathlib import Path

import nilbs
from nilbs.figures import reconstruction_figure, training_figure
from nilbs.io.mesh import write_mesh

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description="Train a field and extract a posed surface.")
    parser.add_argument("--mesh", type=Path, default=HERE / "assets" / "gingerbread.obj")
    parser.add_argument("--rig", type=Path, default=HERE / "assets" / "gingerbread.tgf")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--resolution", type=int, default=128, help="cells along the edge of the grid")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    # 1. A character, and a smooth random motion that turns every joint by 0.4 radians (rms).
    character = nilbs.load_character(args.mesh, args.rig, progress=True)
    motion = nilbs.random_motion(character, frames=args.frames, seed=args.seed)

    # 2. Train. The model is one self-contained file.
    model = nilbs.fit(character, motion, steps=args.steps, seed=args.seed, progress=True)
    model.save(args.out / "03_model.nilbs")
    print(f"loss {model.history[0]:.4f} at the first step, {model.history[-1]:.4f} at the last")
    print(training_figure(model, args.out / "03_training.png"))

    # 3. Extract the surface in a new pose, half-way between two training frames.
    k = len(motion) // 2
    between = motion.at(frame=k - 0.5)
    U, F = model.extract(between, resolution=args.resolution)
    write_mesh(args.out / "03_posed.obj", U, F)
    print(args.out / "03_posed.obj", f"{len(U)} vertices")

    # 4. Compare it with the skinned mesh.
    label = f"between frames {k - 1} and {k}"
    poses = {"frame 0": motion[0], label: between}
    path = args.out / "03_reconstruction.png"
    print(reconstruction_figure(model, path, poses=poses, surfaces={label: (U, F)}, resolution=args.resolution))


if __name__ == "__main__":
    main()
