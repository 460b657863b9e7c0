"""
The selected mesh and armature of Blender as a model
====================================================

Brings back the surface of the model in the pose of the current frame, as a mesh of its own, and the places where the
body meets itself, as colours of the selected mesh. Nothing is trained: it takes seconds, a minute for large meshes.

In Blender's text editor: select a mesh and its armature, open this file, and run it. Without a window::

    blender hero.blend --background --python examples/blender/nilbs_model.py -- --what contacts --save coloured.blend

Blender's own Python needs no nilbs: the environment variable NILBS_PYTHON names one that has it, by default
``python3``.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

NEAR = 0.02  # of the size: how far from a contact, at rest, vertices are coloured


def compute(source: str, target: str) -> None:
    """Outside Blender: the surface, and the depth of contacts at the vertices, of the arrays in a file."""
    from scipy.spatial import cKDTree

    import nilbs
    from nilbs.contacts.self_contacts import SelfContactFinder

    with np.load(source, allow_pickle=False) as given:
        arrays = dict(given)
    V, B = arrays["V"], arrays["B"]
    skeleton = nilbs.Skeleton(arrays["C"], arrays["BE"], arrays["P"], tuple(arrays["names"].tolist()))
    character = nilbs.assemble(V, arrays["E"], skeleton, arrays["W"], report=print)
    rest = np.tile(np.eye(4), (1, len(skeleton.names), 1, 1))
    model = nilbs.fit(character, nilbs.Motion(rest, np.arange(1), "rest", skeleton=skeleton), steps=0)
    depth = np.zeros(len(V))
    if "contacts" in arrays["what"]:
        contacts = SelfContactFinder(model, samples=20_000)(B)
        tree = cKDTree(V)
        for places in (contacts.x_rest, contacts.other):
            for near, deep in zip(tree.query_ball_point(places, NEAR * character.L), contacts.depth, strict=True):
                depth[near] = np.maximum(depth[near], deep)
        if len(contacts.depth):
            pair = skeleton.names[contacts.part[0]], skeleton.names[contacts.other_part[0]]
            print(f"deepest contact: {pair[0]} and {pair[1]}, {contacts.depth[0]:.4g}")
    U, F = (
        model.extract(B, int(arrays["resolution"])) if "surface" in arrays["what"] else (V[:0], np.zeros((0, 3), int))
    )
    np.savez(target, U=U, F=F, depth=depth)


def gathered(thing: Any, rig: Any) -> dict[str, np.ndarray]:
    """The arrays of a mesh and an armature of Blender, in the world: what moves them is left out of the mesh."""
    thing.data.calc_loop_triangles()
    world = np.array(thing.matrix_world)
    V = np.array([vertex.co for vertex in thing.data.vertices]) @ world[:3, :3].T + world[:3, 3]
    bones = [bone for bone in rig.data.bones if bone.use_deform]
    if not bones:
        raise SystemExit(f"{rig.name}: no bone deforms; switch Deform on for the bones that move the mesh")
    number = {bone.name: k for k, bone in enumerate(bones)}
    frame = np.array(rig.matrix_world)
    ends = np.array([end for bone in bones for end in (bone.head_local, bone.tail_local)])
    W = np.zeros((len(V), len(bones)))
    of_group = {group.index: number[group.name] for group in thing.vertex_groups if group.name in number}
    for vertex in thing.data.vertices:
        for entry in vertex.groups:
            if entry.group in of_group:
                W[vertex.index, of_group[entry.group]] = entry.weight
    parents = []
    for bone in bones:
        above = bone.parent
        while above is not None and above.name not in number:
            above = above.parent
        parents.append(-1 if above is None else number[above.name])
    moves = [np.array(rig.pose.bones[bone.name].matrix @ bone.matrix_local.inverted()) for bone in bones]
    return {
        "V": V,
        "E": np.array([triangle.vertices[:] for triangle in thing.data.loop_triangles]),
        "W": W,
        "C": ends @ frame[:3, :3].T + frame[:3, 3],
        "BE": np.arange(2 * len(bones)).reshape(-1, 2),
        "P": np.array(parents),
        "names": np.array(list(number)),
        "B": frame @ np.array(moves) @ np.linalg.inv(frame),
    }


def bring_back(thing: Any, rig: Any, what: tuple[str, ...] = ("surface", "contacts"), resolution: int = 96) -> Any:
    """Inside Blender: the new object with the surface, or None; contacts become the mesh's colours `contacts`."""
    import bpy

    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "given.npz", Path(folder) / "found.npz"
        arrays: dict[str, Any] = {"what": np.array(what), "resolution": resolution, **gathered(thing, rig)}
        np.savez(source, **arrays)
        script = Path(__file__)
        if not script.is_file():  # in Blender's text editor
            script = Path(folder) / "nilbs_model.py"
            script.write_text(bpy.data.texts[Path(__file__).name].as_string(), encoding="utf-8")
        command: list[str | Path] = [os.environ.get("NILBS_PYTHON", "python3"), script, "compute", source, target]
        # Blender's own variables would lead the other Python to Blender's libraries.
        environment = {
            name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "LD_LIBRARY_PATH")
        }
        try:
            done = subprocess.run(command, capture_output=True, text=True, env=environment)
        except FileNotFoundError:
            raise SystemExit(f"there is no {command[0]}: set NILBS_PYTHON to a Python that has nilbs") from None
        if done.returncode:
            raise RuntimeError(f"{command[0]} failed: {(done.stderr.strip().splitlines() or ['no error message'])[-1]}")
        print(done.stdout, end="")
        with np.load(target) as found:
            U, F, depth = found["U"], found["F"], found["depth"]
    if "contacts" in what:
        old = thing.data.color_attributes.get("contacts")
        if old is not None:
            thing.data.color_attributes.remove(old)
        colours = thing.data.color_attributes.new("contacts", "FLOAT_COLOR", "POINT")
        share = (depth / (depth.max() or 1.0))[:, None]
        paint = (1 - share) * [0.8, 0.8, 0.8] + share * [0.8, 0.0, 0.0]
        colours.data.foreach_set("color", np.insert(paint, 3, 1, axis=1).astype(np.float32).ravel())
        thing.data.color_attributes.active_color = colours
    if "surface" not in what:
        return None
    mesh = bpy.data.meshes.new(f"{thing.name} surface")
    mesh.from_pydata(U.tolist(), [], F.tolist())
    made = bpy.data.objects.new(mesh.name, mesh)
    bpy.context.collection.objects.link(made)
    return made


def main() -> None:
    import bpy

    parser = argparse.ArgumentParser(description="The selected mesh and armature as a model of nilbs.")
    parser.add_argument("--what", nargs="+", choices=("surface", "contacts"), default=["surface", "contacts"])
    parser.add_argument("--resolution", type=int, default=96, help="cells along the longest edge (default 96)")
    parser.add_argument("--save", help="write the scene, .blend")
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    chosen = bpy.context.selected_objects or list(bpy.context.scene.objects)
    meshes, rigs = ([thing for thing in chosen if thing.type == kind] for kind in ("MESH", "ARMATURE"))
    if len(meshes) != 1 or len(rigs) != 1:
        raise SystemExit(f"select one mesh and one armature; there are {len(meshes)} and {len(rigs)}")
    bring_back(meshes[0], rigs[0], tuple(args.what), args.resolution)
    if args.save:
        bpy.ops.wm.save_as_mainfile(filepath=str(Path(args.save).resolve()))


if __name__ == "__main__":
    if sys.argv[1:2] == ["compute"]:
        compute(*sys.argv[2:4])
    else:
        main()
