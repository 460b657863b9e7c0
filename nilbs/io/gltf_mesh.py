"""The meshes of a glTF file at rest, and the bones that move their vertices."""

from typing import Any

import numpy as np

from nilbs.geometry.plane import counter_clockwise, flattened
from nilbs.geometry.rotations import transform_points
from nilbs.io.bundle import Influences, Mesh
from nilbs.io.gltf_document import INSTANCES, Document
from nilbs.io.gltf_nodes import Nodes, compose, unit_quaternions
from nilbs.io.gltf_skin import Rig, Skin

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_INSTANCES = 2**14  # copies of meshes that all nodes of a file ask for


def read_meshes(file: Document, nodes: Nodes, rig: Rig) -> tuple[Mesh | None, Influences | None, list[str]]:
    """All triangles of a file's scene at rest, one mesh after the other, what moves them, and notes."""
    pile = _Pile(file, nodes, rig)
    groups: dict[str, list[np.ndarray]] = {}
    meshes, copies = file.entries("meshes"), 0
    for node, entry in enumerate(file.entries("nodes")):
        if "mesh" in entry and nodes.shown[node]:
            index = file.whole(entry, "mesh", nodes.label(node), below=len(meshes))
            skin = None
            if "skin" in entry:
                skin = rig.skins[file.whole(entry, "skin", nodes.label(node), below=len(rig.skins))]
            first = pile.m
            places = _instances(file, nodes, node, entry, skin is not None, pile.notes)
            copies += len(places) - 1
            if copies > _INSTANCES:
                raise file.error(f"its nodes have {copies} instances; at most {_INSTANCES} are read")
            for place in places:
                pile.add_mesh(node, place, skin, meshes[index], f"mesh {index}")
            name = file.text(meshes[index], "name", f"mesh {index}")
            for group in {nodes.names[node] or name or f"node{node}", name} - {""}:
                groups.setdefault(group, []).append(np.arange(first, pile.m))
    if not pile.m:
        return None, None, pile.notes
    faces = {name: np.concatenate(parts) for name, parts in groups.items()}
    mesh = _mesh(np.concatenate(pile.V), np.concatenate(pile.E), faces)
    if not pile.bound:
        unbound = ["no mesh hangs on the skeleton: the file has no weights"] if rig.skeleton else []
        return mesh, None, pile.notes + unbound
    loose = [f"{nodes.label(node)} hangs on no joint: it follows the first root" for node in pile.loose]
    vertex, bone, weight = (np.concatenate(column) for column in zip(*pile.moved, strict=True))
    influences = Influences(vertex, bone, weight)
    return mesh, influences, pile.notes + loose


class _Pile:
    """Meshes one after the other, as lists of arrays."""

    def __init__(self, file: Document, nodes: Nodes, rig: Rig) -> None:
        self.file, self.nodes, self.rig = file, nodes, rig
        self.notes: list[str] = []
        self.V: list[np.ndarray] = []
        self.E: list[np.ndarray] = []
        self.moved: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []  # vertices, bones, weights
        self.loose: list[int] = []  # nodes with vertices that hang on no joint
        self.bound = False  # whether there are others
        self.n = self.m = 0  # vertices and triangles

    def add_mesh(self, node: int, inner: np.ndarray, skin: Skin | None, mesh: dict[str, Any], where: str) -> None:
        """Add the triangles of a mesh, which stands at a node after the transform `inner` (4, 4)."""
        file = self.file
        known: dict[tuple, tuple[int, int, bool]] = {}  # vertices that several primitives share
        for number, primitive in enumerate(file.objects(mesh, "primitives", where)):
            name = f"{where}, primitive {number}"
            mode = file.whole(primitive, "mode", name, default=_TRIANGLES)
            if mode not in (_TRIANGLES, _STRIP, _FAN):
                self.notes.append("points and lines are left out")
                continue
            if "targets" in primitive:
                self.notes.append("morph targets are left out")
            attributes = file.section(primitive, "attributes", name)
            used = sorted(key for key in attributes if key.startswith(("POSITION", "JOINTS_", "WEIGHTS_")))
            at = {key: file.whole(attributes, key, name) for key in used}
            held = file.extensions(primitive, name)
            key = tuple(at.items())
            if key not in known:
                known[key] = self._add_vertices(node, inner, skin, at, name, held)
            first, n, mirrored = known[key]
            if "indices" in primitive:
                index = file.whole(primitive, "indices", name)
                corners = file.accessor(index, f"{name}, indices", "SCALAR", whole=True, held=held)[:, 0]
            else:
                file.spend(n, name)
                corners = np.arange(n)
            if len(corners) and corners.max() >= n:
                raise file.error(f"{name} refers to vertex {corners.max()} of {n}")
            if mode == _TRIANGLES and len(corners) % 3:
                raise file.error(f"{name} has {len(corners)} corners, which make no whole triangles")
            E = first + _triangles(corners, mode)
            self.E.append(E[:, ::-1] if mirrored else E)
            self.m += len(E)

    def _add_vertices(
        self, node: int, inner: np.ndarray, skin: Skin | None, at: dict[str, int], where: str, held: list[str]
    ) -> tuple[int, int, bool]:
        """Add the vertices of a primitive: the first of them, how many, and whether they are mirrored."""
        if "POSITION" not in at:
            raise self.file.error(f"{where} has no positions")
        v = self.file.accessor(at["POSITION"], f"{where}, positions", "VEC3", held=held)
        first, n = self.n, len(v)
        self.n += n
        if skin is not None and "JOINTS_0" in at:
            place = skin.place[0]
            vertex, joint, weight = self._weights(at, n, len(skin.bones), where, held)
            self.V.append(_placed(skin, v, vertex, joint, weight))
            self.moved.append((vertex + first, skin.bones[joint], weight))
            self.bound = True
            if not np.bincount(vertex, minlength=n).all():
                self.notes.append(f"{self.nodes.label(node)} has vertices without any weight")
        else:
            place, bone = self._hanging(node)
            place = place @ inner
            self.V.append(transform_points(place, v))
            self.moved.append((np.arange(first, self.n), np.full(n, bone), np.ones(n)))
        x, y, z = place[:3, :3].T
        return first, n, bool(x @ np.cross(y, z) < 0)  # numpy.linalg.det divides, by whatever tiny number

    def _hanging(self, node: int) -> tuple[np.ndarray, int]:
        """Where a node stands at rest, and the bone that it follows."""
        rig = self.rig
        if node in rig.bone:
            self.bound = True
            return rig.rest[rig.bone[node]], rig.bone[node]
        if rig.above[node] >= 0:
            self.bound = True
            bone = rig.bone[int(rig.above[node])]
            return rig.rest[bone] @ rig.relative[node], bone
        self.loose.append(node)
        return self.nodes.world[node], 0 if rig.skeleton is None else int(np.argmin(rig.skeleton.P))

    def _weights(
        self, at: dict[str, int], n: int, k: int, where: str, held: list[str]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices, joints of the skin and weights other than zero, from all sets of a primitive."""
        found = []
        for number in range(sum(key.startswith("JOINTS_") for key in at)):
            joints, weights = f"JOINTS_{number}", f"WEIGHTS_{number}"
            if joints not in at or weights not in at:
                raise self.file.error(f"{where} has {joints} or {weights} without the other")
            joint = self.file.accessor(at[joints], f"{where}, {joints}", "VEC4", whole=True, held=held)
            weight = self.file.accessor(at[weights], f"{where}, {weights}", "VEC4", held=held)
            if len(joint) != n or len(weight) != n:
                raise self.file.error(f"{where}: {n} positions, {len(joint)} {joints} and {len(weight)} {weights}")
            vertex, slot = np.nonzero(weight)
            joint, weight = joint[vertex, slot], weight[vertex, slot]
            if len(joint) and joint.max() >= k:
                raise self.file.error(f"{where} refers to joint {joint.max()} of a skin of {k}")
            found.append((vertex, joint, weight))
        vertex, joint, weight = (np.concatenate(column) for column in zip(*found, strict=True))
        return vertex, joint, weight


def _instances(
    file: Document, nodes: Nodes, node: int, entry: dict[str, Any], skinned: bool, notes: list[str]
) -> np.ndarray:
    """Where copies of a node's mesh stand, relative to the node: (i, 4, 4)."""
    label = nodes.label(node)
    found = file.section(entry, "extensions", label).get(INSTANCES)
    if found is None:
        return np.eye(4)[None]
    attributes = file.section({"it": found}, "it", f"{label}, {INSTANCES}")
    attributes = file.section(attributes, "attributes", f"{label}, {INSTANCES}")
    parts, count = {}, None
    for key, kind, rest in (("TRANSLATION", "VEC3", 0.0), ("ROTATION", "VEC4", (0, 0, 0, 1)), ("SCALE", "VEC3", 1.0)):
        where = f"{label}, {INSTANCES}, {key}"
        if key in attributes:
            parts[key] = file.accessor(file.whole(attributes, key, where), where, kind)
            if count not in (None, len(parts[key])):
                raise file.error(f"{where}: {len(parts[key])} instances, and {count} before")
            count = len(parts[key])
        parts.setdefault(key, np.broadcast_to(np.array(rest, float), (1, 4 if kind == "VEC4" else 3)))
    if count is None or skinned:
        notes.append(f"{label} is shown once: its instances name no place, or have a skin")
        return np.eye(4)[None]
    rotation, zero = unit_quaternions(parts["ROTATION"])
    if zero.any():
        raise file.error(f"{label}, {INSTANCES}: a rotation is zero")
    notes.append(f"{label} is an instance of its mesh at {count} places: there are so many copies of it")
    return np.broadcast_to(compose(parts["TRANSLATION"], rotation, parts["SCALE"]), (count, 4, 4))


def _placed(skin: Skin, v: np.ndarray, vertex: np.ndarray, joint: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Vertices of a skin at rest; where it was bound in another pose, posed to the rest pose by its own weights."""
    V = transform_points(skin.place[0], v)
    if skin.agree:
        return V
    total = np.bincount(vertex, weight, len(v))
    sound = np.abs(total) > 1e-3
    posed = np.zeros_like(V)
    np.add.at(posed, vertex, weight[:, None] * transform_points(skin.place[joint], v[vertex]))
    V[sound] = posed[sound] / total[sound, None]
    return V


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """Triangles (m, 3) of a list, a strip or a fan."""
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    middle, last = corners[1:-1], corners[2:]
    if mode == _FAN:
        return np.stack([np.broadcast_to(corners[:1], last.shape), middle, last], axis=1)
    E = np.stack([corners[:-2], middle, last], axis=1)
    E[1::2] = E[1::2][:, [0, 2, 1]]
    # Triangles that use a corner twice join strips.
    return E[(E[:, 0] != E[:, 1]) & (E[:, 1] != E[:, 2]) & (E[:, 2] != E[:, 0])]


def _mesh(V: np.ndarray, E: np.ndarray, groups: dict[str, np.ndarray]) -> Mesh:
    """The mesh; one that is flat in the plane, its triangles counter-clockwise."""
    V = flattened(V)
    return Mesh(V, counter_clockwise(V, E) if V.shape[1] == 2 else E, groups)
