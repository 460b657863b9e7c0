"""Characters as glTF 2.0 files, which Blender and other viewers open: mesh, skin, weights and animations."""

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from nilbs.geometry.curves import LINEAR, PARTS, SPLINE, Curve, Curves
from nilbs.geometry.plane import in_space
from nilbs.geometry.quaternions import compose, unit_quaternions
from nilbs.geometry.rotations import transform_points
from nilbs.geometry.skeleton import Skeleton
from nilbs.geometry.validation import arrays, check_indices
from nilbs.io.atomic import replacing
from nilbs.io.bundle import Bundle, Clip, Influences
from nilbs.io.errors import check_suffix
from nilbs.io.gltf_curves import written_curves
from nilbs.io.joints import written_ends

_TYPES = {np.dtype("f4"): 5126, np.dtype("u4"): 5125, np.dtype("u2"): 5123, np.dtype("u1"): 5121}
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_CORNERS, _INDICES = 34962, 34963  # what a buffer view is for
_FAR = 8.0  # times its size: a character farther off is written at the origin, below a node that moves it


def write_gltf(path: str | os.PathLike, parts: Bundle) -> tuple[str, ...]:
    """Write a mesh, its skeleton, weights and motions as glTF 2.0 [1]_; return notes on what did not fit.

    Clips must be of this skeleton. Weights that are not positive are left out, rows are scaled to sum to one, a flat
    character gets z = 0; groups and notes are not written. A `.gltf` file holds its buffer as base64.

    Positions and motions are in single precision: where the character is far from the origin, all of it hangs on a node
    that carries the distance, in double precision. Clips with curves of the same nodes keep nodes, keys and
    interpolation; see `nilbs.io.gltf_curves.written_curves` for all others. Where a bone ends is written as a node
    without mesh called "<bone>_end", unless a reader finds the same end among the bone's children. A node moves by
    translation, rotation and scale: every rigid motion and every stretch along a bone's own axes, if these stay the
    same. Of anything else the closest is written, and the notes report how far off.

    References
    ----------
    .. [1] Khronos Group, glTF 2.0 specification, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
    """
    suffix = check_suffix(path, ".glb", ".gltf")
    mesh, skeleton, influences = parts.mesh, parts.skeleton, parts.influences
    if mesh is None and skeleton is None:
        raise ValueError("there is neither a mesh nor a skeleton to write")
    if skeleton is None and (influences is not None or parts.clips):
        raise ValueError("weights and clips need a skeleton")
    if mesh is None and influences is not None:
        raise ValueError("weights need a mesh")
    points = [] if skeleton is None else [in_space(skeleton.C)]
    if mesh is not None:
        V, E = arrays(V=(mesh.V, "n d"), E=(mesh.E, "m k", int))
        if not len(E) or E.shape[1] != 3:
            raise ValueError(f"a mesh of triangles is needed, E must be (m, 3) with m > 0, got {E.shape}")
        check_indices("E", E, len(V), "vertices")
        points.append(in_space(V))
    offset, size = _place(np.concatenate(points))
    output = _Output()
    notes: list[str] = []
    above = output.node(name="armature" if skeleton is not None else "place", translation=offset.tolist(), children=[])
    scene = [above]
    if mesh is not None:
        node: dict[str, Any] = {"name": Path(path).stem}
        attributes = _attributes(output, points[-1] - offset, E)
        if skeleton is not None and influences is not None:
            attributes |= _weights(output, influences, len(V), skeleton, notes)
            node["skin"] = 0
        corners = E.astype("u2" if len(V) < 65535 else "u4").reshape(-1, 1)
        indices = output.accessor(corners, target=_INDICES)
        output.root["meshes"] = [{"name": node["name"], "primitives": [{"attributes": attributes, "indices": indices}]}]
        number = output.node(**node, mesh=0)
        # What is skinned does not move with its node, and belongs at the top; else it goes where the joints are.
        (scene if "skin" in node else output.root["nodes"][above]["children"]).append(number)
    if skeleton is not None:
        _write_skeleton(output, above, skeleton, offset, size, parts.clips, notes)
    output.root["scenes"] = [{"nodes": scene}]
    with replacing(path) as file:
        file.write(output.glb() if suffix == ".glb" else output.text())
    return tuple(notes)


class _Output:
    """The JSON and the buffer of a file as they grow."""

    def __init__(self) -> None:
        self.root: dict[str, Any] = {"asset": {"version": "2.0", "generator": "nilbs"}, "scene": 0, "scenes": []}
        self.root |= {"nodes": [], "bufferViews": [], "accessors": []}
        self._blocks: list[bytes] = []
        self._size = 0

    def node(self, **entry: Any) -> int:
        """Add a node; its number."""
        self.root["nodes"].append(entry)
        return len(self.root["nodes"]) - 1

    def accessor(self, values: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """Add an array (count, width); the number of its accessor."""
        data = values.astype(values.dtype.newbyteorder("<")).tobytes()
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        self.root["bufferViews"].append(view | ({} if target is None else {"target": target}))
        self._blocks.append(data + bytes(-len(data) % 4))
        self._size += len(self._blocks[-1])
        entry: dict[str, Any] = {"bufferView": len(self.root["bufferViews"]) - 1, "componentType": _TYPES[values.dtype]}
        entry |= {"count": len(values), "type": _KINDS[values.shape[1]]}
        if bounds:
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.root["accessors"].append(entry)
        return len(self.root["accessors"]) - 1

    def glb(self) -> bytes:
        """The file with its buffer as a chunk."""
        self.root["buffers"] = [{"byteLength": self._size}]
        text = self._json()
        text += b" " * (-len(text) % 4)
        chunks = len(text).to_bytes(4, "little") + b"JSON" + text
        chunks += self._size.to_bytes(4, "little") + b"BIN\0" + b"".join(self._blocks)
        return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks

    def text(self) -> bytes:
        """The file with its buffer as base64."""
        data = base64.b64encode(b"".join(self._blocks)).decode("ascii")
        uri = f"data:application/octet-stream;base64,{data}"
        self.root["buffers"] = [{"byteLength": self._size, "uri": uri}]
        return self._json()

    def _json(self) -> bytes:
        # An empty list of children is not allowed.
        for node in self.root["nodes"]:
            if node.get("children") == []:
                del node["children"]
        return json.dumps(self.root, separators=(",", ":"), allow_nan=False).encode("ascii")


def _place(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Where the character is written from, and its size."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max()) or float(np.abs(high).max()) or 1.0
    far = np.abs(points).max() > _FAR * size
    return (0.5 * (low + high) if far else np.zeros(3)), size


def _attributes(output: _Output, V: np.ndarray, E: np.ndarray) -> dict[str, int]:
    """Positions and smooth normals."""
    facing = np.cross(V[E[:, 1]] - V[E[:, 0]], V[E[:, 2]] - V[E[:, 0]])
    N = np.stack([np.bincount(E.ravel(), np.repeat(facing[:, c], 3), len(V)) for c in range(3)], axis=1)
    N = N / np.abs(N).max(initial=1e-300)
    length = np.linalg.norm(N, axis=1, keepdims=True)
    N = np.where(length > 1e-30, N / np.where(length > 1e-30, length, 1.0), [0.0, 0.0, 1.0])
    return {
        "POSITION": output.accessor(V.astype(np.float32), target=_CORNERS, bounds=True),
        "NORMAL": output.accessor(N.astype(np.float32), target=_CORNERS),
    }


def _weights(output: _Output, influences: Influences, n: int, skeleton: Skeleton, notes: list[str]) -> dict[str, int]:
    """Joints and weights in sets of four, as many as the vertex with most of them needs, the largest first."""
    b = len(skeleton.names)
    vertex, bone, weight = arrays(
        vertex=(influences.vertex, "i", int), bone=(influences.bone, "i", int), weight=(influences.weight, "i")
    )
    check_indices("influences.vertex", vertex, n, "vertices")
    check_indices("influences.bone", bone, b, "bones")
    pairs, where = np.unique(vertex * b + bone, return_inverse=True)
    weight = np.bincount(where, weight, len(pairs))
    keep = weight > 0
    if not keep.all() and (weight < 0).any():
        notes.append(f"{(weight < 0).sum()} negative weights are left out")
    vertex, bone, weight = pairs[keep] // b, pairs[keep] % b, weight[keep]
    bare = np.flatnonzero(np.bincount(vertex, minlength=n) == 0)
    if len(bare):
        root = int(np.argmin(skeleton.P))
        notes.append(f"{len(bare)} vertices have no weight and are given to {skeleton.names[root]!r}")
        vertex, bone = np.append(vertex, bare), np.append(bone, np.full(len(bare), root))
        weight = np.append(weight, np.ones(len(bare)))
    order = np.lexsort((-weight, vertex))
    vertex, bone, weight = vertex[order], bone[order], weight[order]
    count = np.bincount(vertex, minlength=n)
    slot = np.arange(len(vertex)) - np.repeat(np.cumsum(count) - count, count)
    sets = -(-int(count.max()) // 4)
    J = np.zeros((n, 4 * sets), dtype=np.uint8 if b <= 256 else np.uint16)
    W = np.zeros((n, 4 * sets), dtype=np.float32)
    J[vertex, slot] = bone
    W[vertex, slot] = weight / np.bincount(vertex, weight, n)[vertex]
    attributes = {}
    for s in range(sets):
        attributes[f"JOINTS_{s}"] = output.accessor(J[:, 4 * s : 4 * s + 4], target=_CORNERS)
        attributes[f"WEIGHTS_{s}"] = output.accessor(W[:, 4 * s : 4 * s + 4], target=_CORNERS)
    return attributes


def _write_skeleton(
    output: _Output,
    above: int,
    skeleton: Skeleton,
    offset: np.ndarray,
    size: float,
    clips: tuple[Clip, ...],
    notes: list[str],
) -> None:
    """Joints, their skin and animations, below a node that stands at the offset."""
    full = [clip for clip in clips if len(clip.times)]
    notes += [f"clip {clip.name!r} has no frame and is left out" for clip in clips if not len(clip.times)]
    tree, motions = written_curves(skeleton, full, offset, size, notes)
    first, nodes = len(output.root["nodes"]), output.root["nodes"]
    names = dict(zip(tree.bones.tolist(), skeleton.names, strict=True))
    for node in range(len(tree.P)):
        output.node(**({"name": names[node]} if node in names else {}), **_place_of(tree, node), children=[])
    for node, parent in enumerate(tree.P.tolist()):
        nodes[above if parent < 0 else first + parent]["children"].append(first + node)
    end, needed = written_ends(skeleton)
    # A bone without length has no end to write, though the reader may give it one.
    for bone in np.flatnonzero(needed & (skeleton.BE[:, 0] != skeleton.BE[:, 1])).tolist():
        place = transform_points(tree.inverse[bone], end[bone] - offset).tolist()
        number = output.node(name=f"{skeleton.names[bone]}_end", translation=place)
        nodes[first + int(tree.bones[bone])]["children"].append(number)
    matrices = output.accessor(np.swapaxes(tree.inverse, 1, 2).reshape(-1, 16).astype(np.float32))
    numbers = (first + tree.bones).tolist()
    output.root["skins"] = [{"joints": numbers, "inverseBindMatrices": matrices, "skeleton": above}]
    # What one clip moves is written for all of them, so that none keeps what another left behind.
    used = {key for curves in motions for key in curves.curves()}
    for curves in motions:
        for part in PARTS:
            differs = (getattr(curves, part) != getattr(tree, part)).any(axis=1)
            used |= {(node, part) for node in np.flatnonzero(differs).tolist()}
    for clip, curves in zip(full, motions, strict=True):
        _write_animation(output, clip, curves, sorted(used) or [(0, "rotation")], first, notes)


def _place_of(tree: Curves, node: int) -> dict[str, list[float]]:
    """How the entry of a node places it at rest."""
    parts = {part: getattr(tree, part)[node] for part in PARTS}
    if not np.array_equal(tree.frame[node], np.eye(4)):
        return {"matrix": (tree.frame[node] @ compose(**parts)).T.ravel().tolist()}
    still = {"rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0, 1.0, 1.0]}
    return {part: value.tolist() for part, value in parts.items() if value.tolist() != still.get(part)}


def _write_animation(
    output: _Output, clip: Clip, curves: Curves, used: list[tuple[int, str]], first: int, notes: list[str]
) -> None:
    """Write one animation, of the parts of nodes that are used; those that it does not move stay at rest."""
    early = min(float(clip.times[0]), 0.0)
    if early < 0:
        notes.append(f"clip {clip.name!r} starts at {early:.6g} s and is moved to 0 s")
    own = curves.curves()
    clocks: dict[bytes, int] = {}
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    dropped = False
    for node, part in used:
        rest_times = np.asarray(clip.times[:1] if own else clip.times)
        rest = Curve(rest_times, np.repeat(getattr(curves, part)[node : node + 1], len(rest_times), axis=0), LINEAR)
        curve = own.get((node, part), rest)
        times = (curve.times - early).astype(np.float32)
        keep = np.append(np.diff(times) > 0, True)
        dropped |= not keep.all()
        times, values, interpolation = times[keep], curve.values[keep], curve.interpolation
        if part == "rotation" and interpolation != SPLINE:
            values, _ = unit_quaternions(values)
        if times.tobytes() not in clocks:
            clocks[times.tobytes()] = output.accessor(times[:, None], bounds=True)
        written = output.accessor(values.reshape(-1, PARTS[part]).astype(np.float32))
        channels.append({"sampler": len(samplers), "target": {"node": first + node, "path": part}})
        sampler = {"input": clocks[times.tobytes()], "output": written, "interpolation": interpolation.upper()}
        samplers.append(sampler)
    if dropped:
        notes.append(f"clip {clip.name!r}: of frames at the same time only the last is kept")
    animation = {"name": clip.name, "channels": channels, "samplers": samplers}
    output.root.setdefault("animations", []).append(animation)
