"""glTF files that tests put together."""

import json
import struct

import numpy as np

from nilbs.io.gltf import read_gltf

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = [[0.0, 0, 0], [1, 0, 0], [0, 1, 1]]


class File:
    """A glTF file that a test puts together."""

    def __init__(self, **root):
        self.root = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "nodes": [], "meshes": [], **root}
        self.data = b""

    def view(self, data, **more):
        self.data += bytes(-len(self.data) % 4)
        self.root["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.root["bufferViews"]) - 1

    def accessor(self, values, kind="f4", **more):
        values = np.asarray(values, kind)
        values = values.reshape(len(values), -1)
        entry = {"bufferView": self.view(values.tobytes()), "componentType": CODES[kind], "count": len(values)}
        self.root["accessors"].append({**entry, "type": KINDS[values.shape[1]], **more})
        return len(self.root["accessors"]) - 1

    def mesh(self, attributes, indices=None, **more):
        primitive = {"attributes": attributes, **more}
        if indices is not None:
            primitive["indices"] = self.accessor(indices, "u2")
        self.root["meshes"].append({"primitives": [primitive]})
        return len(self.root["meshes"]) - 1

    def node(self, **entry):
        self.root["nodes"].append(entry)
        return len(self.root["nodes"]) - 1

    def json(self):
        self.root["buffers"] = [{"byteLength": len(self.data)}, *self.root.get("buffers", [])[1:]]
        return self.root

    def glb(self):
        return glb(self.json(), self.data)

    def read(self, folder):
        path = folder / "made.glb"
        path.write_bytes(self.glb())
        return read_gltf(path)


def glb(root, data=b""):
    text = (root if isinstance(root, str) else json.dumps(root)).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(data)) + b"BIN\0" + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def matrix(t=(0, 0, 0), q=(0, 0, 0, 1), s=(1, 1, 1)):
    """Translation, quaternion and scale, by the textbook: v + 2 u x (u x v + w v)."""
    u, w = np.array(q[:3], float), float(q[3])
    columns = [e * k + 2 * np.cross(u, np.cross(u, e * k) + w * e * k) for e, k in zip(np.eye(3), s, strict=True)]
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = np.array(columns).T, t
    return M


def quaternion(rng):
    q = rng.normal(size=4)
    return (q / np.linalg.norm(q)).tolist()


def worlds(root, given=None):
    """World matrices of all nodes, some with other parts than at rest; recursively."""
    G = {}

    def walk(node, above):
        entry = {**root["nodes"][node], **(given or {}).get(node, {})}
        local = matrix(*(entry.get(k, d) for k, d in PARTS.items()))
        if "matrix" in entry:
            local = np.reshape(entry["matrix"], (4, 4)).T
        G[node] = above @ local
        for child in entry.get("children", []):
            walk(child, G[node])

    below = {c for n in root["nodes"] for c in n.get("children", [])}
    for node in set(range(len(root["nodes"]))) - below:
        walk(node, np.eye(4))
    return G


PARTS = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}


def animate(file, name, channels):
    """Channels: node, part, interpolation, times, values."""
    animation = {"name": name, "channels": [], "samplers": []}
    for node, part, interpolation, times, values in channels:
        sampler = {"input": file.accessor(times), "output": file.accessor(values), "interpolation": interpolation}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": node, "path": part}})
        animation["samplers"].append(sampler)
    file.root.setdefault("animations", []).append(animation)
