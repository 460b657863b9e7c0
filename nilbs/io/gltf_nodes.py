"""The nodes of a glTF scene: their tree and their transforms at rest."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.curves import LARGEST
from nilbs.geometry.quaternions import compose, unit_quaternions
from nilbs.io.gltf_document import Document

_LIMIT = 2**17  # nodes; an empty one takes three bytes of the file, and some hundreds here
AT_REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class Nodes:
    """A forest of n named coordinate frames.

    `parent` is -1 at a root; `order` has parents before their children; `local` and `world` (n, 4, 4) are the
    transforms at rest, relative to the parent and the world. `local` is made of `translation`, `rotation` (unit
    quaternions x, y, z, w) and `scale`, except where a matrix is `fixed`, which no animation may move. `shown` nodes
    stand in the file's scene.
    """

    names: list[str]
    parent: np.ndarray
    order: list[int]
    local: np.ndarray
    world: np.ndarray
    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    fixed: np.ndarray
    shown: np.ndarray

    def below(self, is_joint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest joint above every node, -1 for none, and the map relative to it, or to the world, at rest."""
        above, relative = np.full(len(self.order), -1), self.local.copy()
        for node in self.order:
            parent = self.parent[node]
            if parent >= 0 and is_joint[parent]:
                above[node] = parent
            elif parent >= 0:
                above[node] = above[parent]
                relative[node] = relative[parent] @ self.local[node]
        return above, relative

    def label(self, node: int) -> str:
        """What errors and notes call a node."""
        return repr(self.names[node][:80]) if self.names[node] else f"node {node}"


def read_nodes(file: Document) -> Nodes:
    """The nodes of a file, checked: they form a forest of finite affine maps."""
    entries = file.entries("nodes")
    n = len(entries)
    if n > _LIMIT:
        raise file.error(f"it has {n} nodes; at most {_LIMIT} are read")
    names = [file.text(entry, "name", f"node {i}") for i, entry in enumerate(entries)]
    parts = {key: np.tile(default, (n, 1)) for key, default in AT_REST.items()}
    matrices = np.zeros((n, 4, 4))
    fixed = np.zeros(n, dtype=bool)
    for i, entry in enumerate(entries):
        for key, values in parts.items():
            if key in entry:
                values[i] = file.numbers(entry, key, f"node {i}", values.shape[1])
        if "matrix" in entry:
            matrices[i] = np.reshape(file.numbers(entry, "matrix", f"node {i}", 16), (4, 4)).T
            fixed[i] = True
    parts["rotation"], zero = unit_quaternions(parts["rotation"])
    if zero.any():
        raise file.error(f"node {np.flatnonzero(zero)[0]}: the rotation is zero")
    local = np.where(fixed[:, None, None], matrices, compose(**parts))
    if not np.allclose(local[:, 3], [0, 0, 0, 1], rtol=0, atol=1e-5):
        raise file.error("the last row of a node's matrix is not (0, 0, 0, 1)")
    local[:, 3] = [0, 0, 0, 1]
    children = [file.indices(entry, "children", f"node {i}", n) for i, entry in enumerate(entries)]
    parent = np.full(n, -1)
    for i, below in enumerate(children):
        for child in below:
            if parent[child] >= 0:
                raise file.error(f"node {child} is a child of node {parent[child]} and of node {i}; nodes form a tree")
            parent[child] = i
    order = _reached(children, np.flatnonzero(parent < 0).tolist(), n)
    if len(order) < n:
        circle = next(iter(set(range(n)) - set(order)))
        raise file.error(f"node {circle} is below itself; nodes form a tree")
    world = local.copy()
    with np.errstate(over="ignore", invalid="ignore"):
        for node in order:
            if parent[node] >= 0:
                world[node] = world[parent[node]] @ local[node]
    bad = np.argwhere(~(np.abs(world) < LARGEST))
    if len(bad):
        raise file.error(f"the transform of node {bad[0][0]} is out of bounds")
    shown = np.zeros(n, dtype=bool)
    shown[_reached(children, _roots(file, n), n)] = True
    return Nodes(names, parent, order, local, world, **parts, fixed=fixed, shown=shown)


def _roots(file: Document, n: int) -> list[int]:
    """The uppermost nodes of the scene that the file shows: the one it names, else its first, else all."""
    scenes = file.entries("scenes")
    if not scenes:
        return list(range(n))
    number = file.whole(file.root, "scene", "the file", default=0, below=len(scenes))
    return file.indices(scenes[number], "nodes", f"scene {number}", n)


def _reached(children: list[list[int]], start: list[int], n: int) -> list[int]:
    """All nodes at and below these, parents before their children, each once."""
    order: list[int] = []
    seen = np.zeros(n, dtype=bool)
    level = start
    while level:
        fresh = []
        for node in level:
            if not seen[node]:
                seen[node] = True
                fresh.append(node)
        order += fresh
        level = [child for node in fresh for child in children[node]]
    return order
