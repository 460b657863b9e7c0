"""Run by the Python of an environment with bpy: writes characters with Blender, and opens those that nilbs wrote.

`make FOLDER` writes NAME.glb and NAME.npz for every character: Blender's own evaluated vertices of all meshes, in the
world with +Y up, at rest (n, 3) and at every frame (t, n, 3), and the frames' times in seconds.
`open FILE OUT` imports FILE and writes the same for it, at the frames of its animation.
`volume FOLDER` writes volume.npz: values and place of the grid in a.vdb, as OpenVDB reads it.
"""

import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Quaternion, Vector


def evaluated() -> np.ndarray:
    """Vertices of all meshes as they stand, +Y up."""
    graph = bpy.context.evaluated_depsgraph_get()
    points = []
    for thing in sorted(bpy.context.scene.objects, key=lambda o: o.name):
        if thing.type == "MESH" and not thing.name.startswith("Icosphere"):  # the importer's picture of a bone
            moved = thing.evaluated_get(graph)
            points += [moved.matrix_world @ v.co for v in moved.data.vertices]
    x, y, z = np.array(points).T
    return np.stack([x, z, -y], axis=1)


def posed(frames) -> dict[str, np.ndarray]:
    """What Blender makes of the frames, and of rest at the first of them."""
    scene = bpy.context.scene
    armatures = [thing.data for thing in scene.objects if thing.type == "ARMATURE"]
    scene.frame_set(frames[0])
    for armature in armatures:
        armature.pose_position = "REST"
    bpy.context.view_layer.update()
    rest = evaluated()
    for armature in armatures:
        armature.pose_position = "POSE"
    found = []
    for frame in frames:
        scene.frame_set(frame)
        found.append(evaluated())
    scene.frame_set(frames[0])
    return {"rest": rest, "posed": np.array(found), "times": np.array(frames) / scene.render.fps}


def tube(name: str, sides: int, rings: int, length: float, rng: np.random.Generator) -> bpy.types.Object:
    """A closed bumpy tube along z, no two of its vertices alike."""
    points = []
    for ring in range(rings):
        for side in range(sides):
            angle, radius = 2 * math.pi * side / sides, 0.3 + 0.05 * rng.random()
            points.append((radius * math.cos(angle), radius * math.sin(angle), length * ring / (rings - 1)))
    faces = [[*range(sides)][::-1], [(rings - 1) * sides + k for k in range(sides)]]
    for ring in range(rings - 1):
        for side in range(sides):
            a, b = ring * sides + side, ring * sides + (side + 1) % sides
            faces.append([a, b, b + sides, a + sides])
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    return thing


def armature(name: str, bones: dict[str, tuple]) -> bpy.types.Object:
    """Bones by name: parent, head, tail, roll, whether they are joined to the parent's tail."""
    data = bpy.data.armatures.new(name)
    thing = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    bpy.ops.object.mode_set(mode="EDIT")
    for bone, (parent, head, tail, roll, joined) in bones.items():
        edit = data.edit_bones.new(bone)
        edit.head, edit.tail, edit.roll = head, tail, roll
        edit.parent = data.edit_bones[parent] if parent else None
        edit.use_connect = joined
    bpy.ops.object.mode_set(mode="OBJECT")
    return thing


def bind(mesh: bpy.types.Object, rig: bpy.types.Object, most: int, width: float) -> None:
    """Smooth weights of the nearest bones, so many at most, for vertices in the armature's space."""
    place = rig.matrix_world.inverted() @ mesh.matrix_world
    bones = list(rig.data.bones)
    for bone in bones:
        mesh.vertex_groups.new(name=bone.name)
    for vertex in mesh.data.vertices:
        at = place @ vertex.co
        distance = []
        for bone in bones:
            along = bone.tail_local - bone.head_local
            s = max(0.0, min(1.0, (at - bone.head_local).dot(along) / along.length_squared))
            distance.append((at - bone.head_local - s * along).length)
        order = np.argsort(distance)[:most]
        weight = np.exp(-((np.array(distance)[order] / width) ** 2))
        weight[weight < 1e-3 * weight.max()] = 0  # Blender does not export those below 0.0001
        for k, w in zip(order.tolist(), (weight / weight.sum()).tolist(), strict=True):
            mesh.vertex_groups[bones[k].name].add([vertex.index], w, "REPLACE")
    mesh.modifiers.new("Armature", "ARMATURE").object = rig


BRANCHING = {
    "hip": (None, (0, 0, 0), (0, 0, 1), 0.3, False),
    "spine": ("hip", (0, 0, 1), (0, 0.1, 2), -0.7, True),
    "head": ("spine", (0, 0.1, 2), (0, 0, 3), 1.9, True),
    "arm.L": ("spine", (0.3, 0, 1.8), (1.0, 0.2, 1.9), 0.5, False),
    "hand.L": ("arm.L", (1.0, 0.2, 1.9), (1.4, 0.1, 1.7), 2.5, True),
    "arm.R": ("spine", (-0.3, 0, 1.8), (-1.0, 0.2, 1.9), -1.1, False),
    "tail": ("hip", (0, 0.3, 0.2), (0, 1.0, 0.1), 0.0, False),
}


def key(bone, frame: int, **values) -> None:
    for name, value in values.items():
        setattr(bone, name, value)
        bone.keyframe_insert(name, frame=frame)


def turn(rng: np.random.Generator, angle: float) -> Quaternion:
    return Quaternion(Vector(rng.normal(size=3)).normalized(), angle * (2 * rng.random() - 1))


def dancer(rng: np.random.Generator) -> dict:
    """Branching bones with rolls, six influences a vertex, rotations and translations."""
    rig, mesh = armature("rig", BRANCHING), tube("body", 14, 16, 3.0, rng)
    mesh.parent = rig
    bind(mesh, rig, 6, 0.8)
    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
        for frame in (1, 9, 20):
            key(bone, frame, rotation_quaternion=turn(rng, 1.2))
    for frame in (1, 14, 20):
        key(rig.pose.bones["hip"], frame, location=rng.normal(size=3).tolist())
        key(rig.pose.bones["tail"], frame, location=(0.3 * rng.normal(size=3)).tolist())
    return {"frames": range(1, 21), "export_all_influences": True}


def stretcher(rng: np.random.Generator) -> dict:
    """Bones that also scale along their own axes, unevenly, exported as the keys stand."""
    rig, mesh = armature("rig", BRANCHING), tube("body", 12, 18, 3.0, rng)
    mesh.parent = rig
    bind(mesh, rig, 4, 0.6)
    for bone in rig.pose.bones:
        bone.rotation_mode = "XYZ"
        for frame in (0, 12, 30):
            angles = rng.normal(size=3) * 0.5
            key(bone, frame, rotation_euler=Euler(angles.tolist()), scale=(0.6 + 0.8 * rng.random(3)).tolist())
    return {"frames": range(0, 31)}


def rider(rng: np.random.Generator) -> dict:
    """Objects below objects with transforms, that move too; a mesh on a bone; frames from 10 on."""
    above = bpy.data.objects.new("cart", None)
    bpy.context.collection.objects.link(above)
    above.location, above.rotation_euler, above.scale = (3, -2, 1), (0.3, 0.5, -1), (1.5, 1.5, 1.5)
    rig, mesh = armature("rig", BRANCHING), tube("body", 10, 14, 6.0, rng)
    rig.parent = above
    rig.location, rig.rotation_euler, rig.scale = (0.5, 1, -0.5), (0.2, -0.4, 0.9), (0.7, 0.7, 0.7)
    mesh.parent = rig
    mesh.location, mesh.rotation_euler, mesh.scale = (0.1, 0.2, 0), (0.1, 0, 2), (1.2, 0.9, 0.5)
    bpy.context.view_layer.update()
    bind(mesh, rig, 4, 0.6)
    hat = tube("hat", 7, 3, 0.5, rng)
    hat.parent, hat.parent_type, hat.parent_bone = rig, "BONE", "head"
    hat.location, hat.rotation_euler = (0.1, 0.2, 0.3), (1, 2, 3)
    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
        for frame in (10, 17, 25):
            key(bone, frame, rotation_quaternion=turn(rng, 1.0))
    for frame in (10, 25):
        key(above, frame, location=rng.normal(size=3).tolist())
        key(rig, frame, rotation_euler=rng.normal(size=3).tolist())
    return {"frames": range(10, 26), "export_animation_mode": "SCENE", "export_anim_scene_split_object": False}


def make(folder: Path) -> None:
    """Write all characters."""
    for number, character in enumerate((dancer, stretcher, rider)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        scene.render.fps = 24
        options = character(np.random.default_rng(number))
        frames = options.pop("frames")
        scene.frame_start, scene.frame_end = frames[0], frames[-1]
        truth = posed(frames)
        bpy.ops.export_scene.gltf(
            filepath=str(folder / f"{character.__name__}.glb"),
            export_format="GLB",
            export_frame_range=True,
            export_optimize_animation_size=False,
            **options,
        )
        np.savez(folder / f"{character.__name__}.npz", **truth)


def open_(file: Path, out: Path) -> None:
    """Import a file and write what Blender makes of its animation."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 24
    bpy.ops.import_scene.gltf(filepath=str(file))
    actions = list(bpy.data.actions)
    last = round(max(action.frame_range[1] for action in actions))
    first = round(min(action.frame_range[0] for action in actions))
    np.savez(out, **posed(range(first, last + 1)))


def volume(folder: Path) -> None:
    """Read a.vdb with Blender's OpenVDB and write what it holds to volume.npz."""
    sys.path.append(str(Path(bpy.utils.resource_path("LOCAL")) / "python/lib/python3.11/site-packages"))
    import openvdb

    (grid,) = openvdb.readAll(str(folder / "a.vdb"))[0]
    values = np.zeros((130, 9, 17), dtype=np.float32)
    grid.copyToArray(values)
    first, spacing = grid.transform.indexToWorld((0, 0, 0)), grid.transform.voxelSize()
    np.savez(folder / "volume.npz", values=values, first=first, spacing=spacing, frame=grid["frame"])


if __name__ == "__main__":
    command, *paths = sys.argv[1:]
    {"make": make, "open": open_, "volume": volume}[command](*map(Path, paths))
