"""Run by the Python of an environment with bpy: makes a scene of arrays, and runs the example's script on it.

`SCRIPT FOLDER` reads FOLDER/given.npz, and writes found.npz: the posed vertices by Blender, the arrays that the script
gathers, its surface and its colours.
"""

import runpy
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Matrix


def scene(given: dict[str, np.ndarray]) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A mesh and an armature, both moved in the world, with two legs turned inwards."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    place = Matrix.Translation((0.3, -0.2, 0.5)) @ Euler((0.3, -0.2, 0.4)).to_matrix().to_4x4()
    data = bpy.data.armatures.new("rig")
    rig = bpy.data.objects.new("rig", data)
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, (first, second), parent in zip(given["names"].tolist(), given["BE"], given["P"], strict=True):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = given["C"][first].tolist(), given["C"][second].tolist()
        bone.parent = data.edit_bones[int(parent)] if parent >= 0 else None
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.matrix_world = place
    mesh = bpy.data.meshes.new("body")
    mesh.from_pydata(given["V"].tolist(), [], given["E"].tolist())
    body = bpy.data.objects.new("body", mesh)
    bpy.context.collection.objects.link(body)
    body.matrix_world = place
    for bone, name in enumerate(given["names"].tolist()):
        group = body.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(given["W"][:, bone] > 0).tolist():
            group.add([vertex], float(given["W"][vertex, bone]), "REPLACE")
    body.modifiers.new("rig", "ARMATURE").object = rig
    for name, angle in zip(given["turned"].tolist(), given["angles"].tolist(), strict=True):
        bone = rig.pose.bones[name]
        bone.rotation_mode = "XYZ"
        # About the world's z of the rest pose, in the bone's own axes.
        axis = bone.bone.matrix_local.to_3x3().inverted() @ Matrix.Identity(3).col[2]
        bone.rotation_euler = Matrix.Rotation(angle, 3, axis).to_euler()
    bpy.context.view_layer.update()
    return body, rig


if __name__ == "__main__":
    script, folder = sys.argv[1], Path(sys.argv[2])
    with np.load(folder / "given.npz") as file:
        body, rig = scene(dict(file))
    moved = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    posed = np.array([moved.matrix_world @ vertex.co for vertex in moved.data.vertices])
    example = runpy.run_path(script)
    made = example["bring_back"](body, rig, resolution=48)
    colours = np.zeros(4 * len(posed), dtype=np.float32)
    body.data.color_attributes["contacts"].data.foreach_get("color", colours)
    surface = np.array([vertex.co for vertex in made.data.vertices])
    gathered = example["gathered"](body, rig)
    np.savez(folder / "found.npz", posed=posed, colours=colours.reshape(-1, 4), surface=surface, **gathered)
