"""What happens to meshes: each takes a mesh and a seeded generator and returns the mesh damaged."""

import numpy as np

from .bodies import Mesh, ball, joined, tube
from .defects import areas, size


def with_holes(mesh: Mesh, rng: np.random.Generator, count: int, radius: float) -> Mesh:
    """Cut away the faces around some places; the radius is in diagonals of the mesh's box."""
    V, F = mesh
    centre = V[F].mean(axis=1)
    middle = centre[_far_apart(centre, rng, count)]
    distance = np.linalg.norm(centre[:, None] - middle, axis=2).min(axis=1)
    return V, F[distance > radius * size(V, F)]


def _far_apart(x: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    chosen = [int(rng.integers(len(x)))]
    distance = np.full(len(x), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(x - x[chosen[-1]], axis=1))
        chosen.append(int(rng.choice(len(x), p=distance**2 / (distance**2).sum())))
    return np.array(chosen)


def with_flips(mesh: Mesh, rng: np.random.Generator, share: float) -> Mesh:
    V, F = mesh
    F = F.copy()
    which = rng.permutation(len(F))[: round(share * len(F))]
    F[which] = F[which, ::-1]
    return V, F


def with_doubled_faces(mesh: Mesh, rng: np.random.Generator, share: float, *, same_way: bool) -> Mesh:
    V, F = mesh
    again = F[rng.permutation(len(F))[: round(share * len(F))]]
    return V, np.concatenate([F, again if same_way else again[:, ::-1]])


def as_soup(mesh: Mesh) -> Mesh:
    """Every triangle with vertices of its own."""
    V, F = mesh
    return V[F.ravel()], np.arange(3 * len(F)).reshape(-1, 3)


def with_cracks(mesh: Mesh, rng: np.random.Generator, gap: float) -> Mesh:
    """A soup whose vertices no longer meet: moved by the gap, in diagonals of the mesh's box."""
    V, F = as_soup(mesh)
    return V + gap * size(V, F) * rng.uniform(-1, 1, V.shape), F


def with_seams(mesh: Mesh, rng: np.random.Generator, charts: int) -> Mesh:
    """Cut along the borders of some charts; vertices there are doubled, places stay."""
    V, F = mesh
    centre = V[F].mean(axis=1)
    seeds = centre[rng.permutation(len(F))[:charts]]
    chart = np.linalg.norm(centre[:, None] - seeds, axis=2).argmin(axis=1)
    pairs, place = np.unique(np.stack([np.repeat(chart, 3), F.ravel()], axis=1), axis=0, return_inverse=True)
    return V[pairs[:, 1]], place.reshape(-1, 3)


def with_isolated_vertices(mesh: Mesh, rng: np.random.Generator, count: int, distance: float) -> Mesh:
    """More vertices, up to some sizes away, that no face uses; before, between and after the others."""
    V, F = mesh
    d = V.shape[1]
    low, high = V.min(axis=0), V.max(axis=0)
    more = (low + high) / 2 + distance * np.linalg.norm(high - low) * rng.uniform(-1, 1, (count, d))
    order = rng.permutation(len(V) + count)
    return np.concatenate([V, more])[order], np.argsort(order)[F]


def with_fins(mesh: Mesh, rng: np.random.Generator, count: int, *, both_sides: bool) -> Mesh:
    """Triangles that stand on edges of the surface: a third face at the edge, or two back to back without volume."""
    V, F = mesh
    faces = F[rng.permutation(len(F))[:count]]
    normal = np.cross(V[faces[:, 1]] - V[faces[:, 0]], V[faces[:, 2]] - V[faces[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    tips = V[faces[:, :2]].mean(axis=1) + 0.05 * size(V, F) * normal
    fins = np.stack([faces[:, 0], faces[:, 1], len(V) + np.arange(len(faces))], axis=1)
    return np.concatenate([V, tips]), np.concatenate([F, fins, fins[:, ::-1]] if both_sides else [F, fins])


def with_flat_faces(mesh: Mesh, rng: np.random.Generator, count: int) -> Mesh:
    """Triangles without area: an index twice, three places in a row, all three the same."""
    V, F = mesh
    a, b = F[rng.integers(len(F), size=count), :2].T
    middle = len(V) + np.arange(count)
    flat = np.concatenate([np.stack(t, axis=1) for t in ((a, a, b), (a, middle, b), (a, a, a))])
    return np.concatenate([V, V[[a, b]].mean(axis=0)]), np.concatenate([F, flat])


def with_needles(mesh: Mesh, rng: np.random.Generator, count: int) -> Mesh:
    """Triangles split at a point very near to one of their edges."""
    V, F = mesh
    which = rng.permutation(len(F))[:count]
    a, b, c = F[which].T
    near = np.array([0.5 - 5e-6, 0.5 - 5e-6, 1e-5]) @ V[F[which]]
    new = len(V) + np.arange(count)
    rest = np.delete(F, which, axis=0)
    parts = [np.stack(t, axis=1) for t in ((a, b, new), (b, c, new), (c, a, new))]
    return np.concatenate([V, near]), np.concatenate([rest, *parts])


def with_hanging_vertices(mesh: Mesh, rng: np.random.Generator, count: int) -> Mesh:
    """Some triangles cut in two at the middle of an edge, their neighbours not."""
    V, F = mesh
    which = rng.permutation(len(F))[:count]
    a, b, c = F[which].T
    new = len(V) + np.arange(count)
    halves = [np.stack(t, axis=1) for t in ((a, new, c), (new, b, c))]
    return np.concatenate([V, V[F[which, :2]].mean(axis=1)]), np.concatenate([np.delete(F, which, axis=0), *halves])


def with_spike(mesh: Mesh, rng: np.random.Generator, length: float) -> Mesh:
    """One vertex pulled out, by some sizes."""
    V, F = mesh
    V = V.copy()
    vertex = int(rng.choice(np.unique(F)))
    away = V[vertex] - V.mean(axis=0)
    V[vertex] += length * size(V, F) * away / np.linalg.norm(away)
    return V, F


def crumpled(mesh: Mesh, rng: np.random.Generator, amount: float) -> Mesh:
    """Every vertex moved at random, by about the amount times the usual edge."""
    V, F = mesh
    edge = np.sqrt(np.median(areas(V, F)))
    return V + amount * edge * rng.normal(size=V.shape), F


def quantised(mesh: Mesh, steps: int) -> Mesh:
    """Places rounded to a coarse grid, as a compressed file holds them."""
    V, F = mesh
    step = np.ptp(V, axis=0).max() / steps
    return np.round(V / step) * step, F


def with_two_shells(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """A ball and an open tube more, both crossing the surface."""
    V, F = mesh
    s = size(V, F)
    first, second = V[F[_far_apart(V[F[:, 0]], rng, 2), 0]]
    x = np.linspace(-0.12, 0.12, 9) * s
    pipe, G = tube(np.stack([x, 0 * x, 0 * x], axis=1), 0.03 * s, capped=False)
    return joined(mesh, ball(first, 0.04 * s), (pipe + second, G))


def turned(V: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rotated at random."""
    Q, R = np.linalg.qr(rng.normal(size=(V.shape[1], V.shape[1])))
    Q *= np.sign(np.diag(R))
    return V @ (Q * np.where(np.arange(len(Q)) == 0, np.linalg.det(Q), 1))
