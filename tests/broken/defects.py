"""Counts of what is wrong with a mesh or a rig, by the shortest way rather than the fastest."""

import numpy as np
from scipy import sparse

from nilbs.geometry.winding import winding_number


def size(V: np.ndarray, F: np.ndarray) -> float:
    """Diagonal of the box of the vertices that faces use."""
    return float(np.linalg.norm(np.ptp(V[F.ravel()], axis=0)))


def _edges(F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Undirected edges, how many faces each has, and how often it is run through from the smaller index."""
    directed = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    edges, which, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    return edges, count, np.bincount(which.ravel(), weights=directed[:, 0] < directed[:, 1]).astype(int)


def boundary_edges(F: np.ndarray) -> int:
    return int((_edges(F)[1] == 1).sum())


def holes(F: np.ndarray) -> int:
    """Number of separate boundary curves."""
    edges, count, _ = _edges(F)
    rim = edges[count == 1]
    used, place = np.unique(rim, return_inverse=True)
    return _parts(place.reshape(-1, 2), len(used))


def crowded_edges(F: np.ndarray) -> int:
    """Edges with more than two faces."""
    return int((_edges(F)[1] > 2).sum())


def misoriented_edges(F: np.ndarray) -> int:
    """Edges whose two faces disagree on what is outside."""
    _, count, forward = _edges(F)
    return int(((count == 2) & (forward != 1)).sum())


def pieces(F: np.ndarray) -> int:
    """Parts of the mesh that share no vertex."""
    used, place = np.unique(F, return_inverse=True)
    place = place.reshape(F.shape)
    return _parts(np.concatenate([place[:, :2], place[:, 1:]]), len(used))


def bow_ties(F: np.ndarray) -> int:
    """Vertices whose faces hang together only by that vertex."""
    found = 0
    for vertex in np.unique(F):
        around = F[(vertex == F).any(axis=1)]
        others = around[around != vertex].reshape(len(around), -1)
        used, place = np.unique(others, return_inverse=True)
        found += others.shape[1] == 2 and _parts(place.reshape(-1, 2), len(used)) > 1
    return found


def _parts(pairs: np.ndarray, n: int) -> int:
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
    return sparse.csgraph.connected_components(graph, directed=False)[0]


def repeated_faces(F: np.ndarray, *, same_way: bool) -> int:
    """Faces that another one repeats, run through the same way or the other."""
    first = np.argmin(F, axis=1)
    turned = np.take_along_axis(F, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = {tuple(face) for face in turned.tolist()}
    return len(F) - len(faces) if same_way else sum((a, c, b) in faces for a, b, c in faces) // 2


def areas(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Of triangles, in the plane or in space."""
    a, b = (np.pad(V[F[:, i]] - V[F[:, 0]], ((0, 0), (0, 3 - V.shape[1]))) for i in (1, 2))
    return np.linalg.norm(np.cross(a, b), axis=1) / 2


def flat_faces(V: np.ndarray, F: np.ndarray) -> int:
    """Triangles without area."""
    return int((areas(V, F) <= 1e-14 * size(V, F) ** 2).sum())


def needles(V: np.ndarray, F: np.ndarray) -> int:
    """Triangles with area that are 1000 times longer than high."""
    longest = np.linalg.norm(V[F] - V[np.roll(F, 1, axis=1)], axis=2).max(axis=1)
    area = areas(V, F)
    return int(((area > 0) & (longest**2 > 2000 * area)).sum())


def isolated_vertices(V: np.ndarray, F: np.ndarray) -> int:
    return len(V) - len(np.unique(F))


def repeated_vertices(V: np.ndarray) -> int:
    return len(V) - len(np.unique(V, axis=0))


def hanging_vertices(V: np.ndarray, F: np.ndarray) -> int:
    """Vertices that lie within an edge of a face they do not belong to: T-junctions."""
    edges, count, _ = _edges(F)
    start, along = V[edges[count == 1, 0]], np.diff(V[edges[count == 1]], axis=1)[:, 0]
    x = V[np.unique(F)][:, None] - start
    s = (x * along).sum(axis=2) / (along**2).sum(axis=1)
    away = np.linalg.norm(x - s[..., None] * along, axis=2)
    return int(((s > 1e-6) & (s < 1 - 1e-6) & (away < 1e-9 * size(V, F))).any(axis=1).sum())


def crossings(V: np.ndarray, F: np.ndarray) -> int:
    """Pairs of an edge and a triangle that it passes through, each edge against each triangle."""
    edges = _edges(F)[0]
    found = 0
    for face in F:
        a, b, c = V[face]
        normal = np.cross(b - a, c - a)
        height = (V - a) @ normal
        height[face] = 0
        start, end = edges[height[edges].prod(axis=1) < 0].T
        s = height[start] / (height[start] - height[end])
        x = V[start] + s[:, None] * (V[end] - V[start])
        turns = [np.cross(q - p, x - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
        found += int(np.all([turn > 1e-9 * (normal @ normal) for turn in turns], axis=0).sum())
    return found


def enclosed_volume(V: np.ndarray, F: np.ndarray) -> float:
    return float(np.linalg.det(V[F] - V[F.ravel()].mean(axis=0)).sum() / 6)


def joints_outside(V: np.ndarray, F: np.ndarray, C: np.ndarray) -> int:
    """Joints that the surface does not wind around."""
    return int((np.abs(winding_number(V, F, C, exact=True)) < 0.5).sum())


def relative_lengths(V: np.ndarray, F: np.ndarray, C: np.ndarray, BE: np.ndarray) -> np.ndarray:
    """Lengths of the bones in sizes of the mesh."""
    return np.linalg.norm(C[BE[:, 1]] - C[BE[:, 0]], axis=1) / size(V, F)


def overlapping_triangles(V: np.ndarray, F: np.ndarray) -> int:
    """In the plane: triangles that hold the centre of another one."""
    centre = V[F].mean(axis=1)
    a, b, c = (V[F[:, i]][:, None] for i in range(3))
    turns = [np.sign(_cross(q - p, centre - p)) for p, q in ((a, b), (b, c), (c, a))]
    holds = (turns[0] == turns[1]) & (turns[1] == turns[2]) & (turns[0] != 0)
    np.fill_diagonal(holds, False)
    return int(holds.any(axis=1).sum())


def negative_triangles(V: np.ndarray, F: np.ndarray) -> int:
    return int((_cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]) < 0).sum())


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
