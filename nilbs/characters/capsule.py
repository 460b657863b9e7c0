"""A capsule drawn from code, with bones in a row along its axis: the simplest body that bends and twists.

Its shape has a closed form and its vertices lie on it, so what skinning or a reconstruction does to it can be measured.
"""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from nilbs.characters.character import Character


def capsule(
    *, bones: int = 2, length: float = 1.0, radius: float = 0.15, resolution: int = 32, d: int = 3
) -> "Character":
    """A capsule that stands upright in y around the origin, with bounded biharmonic weights.

    Its bones are equally long and lie one after the other, from the middle of the lower cap to that of the upper one;
    the lowest is the root. `length` is from tip to tip, `resolution` the number of edges around (in the plane, around
    both caps), at least 6; d = 2 is the planar section.

    Nothing is random. The vertices lie on the capsule, which is convex: the mesh lies inside it and encloses less than
    pi r^2 (length - 2 r) + 4/3 pi r^3, in the plane 2 r (length - 2 r) + pi r^2, by an error that falls with the square
    of the edges' length.

    Examples
    --------
    >>> character = capsule(bones=3, resolution=12, d=2)
    >>> character.skeleton.names, character.skeleton.C[:, 1].round(3).tolist()
    (('bone0', 'bone1', 'bone2'), [-0.35, -0.117, 0.117, 0.35])
    """
    from nilbs.characters.character import assemble
    from nilbs.geometry.skeleton import skeleton_of_bones

    V, E = capsule_mesh(length=length, radius=radius, resolution=resolution, d=d)
    if bones < 1:
        raise ValueError(f"bones must be at least 1, got {bones}")
    half = length / 2 - radius
    C = np.zeros((bones + 1, d))
    C[:, 1] = np.linspace(-half, half, bones + 1)
    BE = np.column_stack([np.arange(bones), np.arange(1, bones + 1)])
    skeleton = skeleton_of_bones(C, BE)
    return assemble(V, E, skeleton, name="capsule")


def capsule_mesh(*, length: float, radius: float, resolution: int, d: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """The capsule's mesh alone, without bones.

    For d = 3 all vertices lie on the capsule, and the triangles are its surface, counter-clockwise from outside. For
    d = 2 the vertices of the outline come first, and the triangles fill it.

    Examples
    --------
    >>> V, E = capsule_mesh(length=1.0, radius=0.2, resolution=12)
    >>> V[[0, -1]].tolist()
    [[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]]
    """
    if d not in (2, 3):
        raise ValueError(f"d must be 2 or 3, got {d}")
    if not 0 < 2 * radius < length:
        raise ValueError(f"length must be more than twice the radius, got {length} and {radius}")
    if resolution < 6:
        raise ValueError(f"resolution must be at least 6, got {resolution}")
    return (_stadium if d == 2 else _rings)(length, radius, resolution)


def _profile(length: float, radius: float, edge: float) -> np.ndarray:
    """The right half of the planar section from the lower tip to the upper one, (r, y), an edge apart."""
    half = length / 2 - radius
    turn = np.linspace(-np.pi / 2, 0.0, max(2, round(radius * np.pi / 2 / edge)) + 1)
    cap = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    cap[0, 0] = 0.0
    y = np.linspace(-half, half, max(1, round(2 * half / edge)) + 1)
    side = np.column_stack([np.full(len(y), radius), y])
    return np.concatenate([cap[:-1] - [0, half], side, cap[-2::-1] * [1, -1] + [0, half]])


def _rings(length: float, radius: float, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Rings of vertices around the axis, with a triangle on every edge of a ring towards the ring above and below."""
    edge = 2 * radius * np.sin(np.pi / resolution)
    profile = _profile(length, radius, edge * np.sqrt(3) / 2)
    sizes = np.maximum(4, np.round(resolution * profile[:, 0] / radius)).astype(int)
    sizes[[0, -1]] = 1
    first = np.concatenate([[0], np.cumsum(sizes)])
    # Every other ring is turned by half an edge.
    odd = np.arange(len(sizes)) % 2
    ring = np.repeat(np.arange(len(sizes)), sizes)
    angle = np.pi * (2 * (np.arange(first[-1]) - first[ring]) + odd[ring]) / sizes[ring]
    r, y = profile[ring].T
    V = np.column_stack([r * np.sin(angle), y, r * np.cos(angle)]) + 0.0  # turns -0.0 into 0.0
    rings = zip(first[:-1].tolist(), sizes.tolist(), odd.tolist(), strict=True)
    bands = [_band(*below, *above) for below, above in pairwise(rings)]
    return V, np.concatenate(bands)


def _band(first: int, m: int, odd: int, first_above: int, m_above: int, odd_above: int) -> np.ndarray:
    """Triangles between two rings of m vertices each; in whole numbers, so that no tie is broken by rounding.

    An edge's third corner is the vertex of the other ring that is nearest in angle to the edge's middle. Of two that
    are as near the lower ring's edges take the later one and the upper ring's the earlier one, which fit each other.
    """
    triangles = []
    if m > 1:
        i = np.arange(m)
        nearest = ((2 * i + 1 + odd) * m_above + m - odd_above * m) // (2 * m)
        triangles.append(np.column_stack([first + i, first + (i + 1) % m, first_above + nearest % m_above]))
    if m_above > 1:
        j = np.arange(m_above)
        nearest = -((m_above + odd * m_above - (2 * j + 1 + odd_above) * m) // (2 * m_above))
        triangles.append(np.column_stack([first_above + (j + 1) % m_above, first_above + j, first + nearest % m]))
    return np.concatenate(triangles)


def _stadium(length: float, radius: float, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """The outline and a hexagonal grid inside it; a Delaunay triangulation of a convex shape has all of its edges."""
    from scipy.spatial import Delaunay

    edge = 2 * radius * np.sin(np.pi / resolution)
    right = _profile(length, radius, edge)
    outline = np.concatenate([right, right[-2:0:-1] * [-1, 1]])
    reach = np.array([radius, length / 2])
    columns, rows = np.arange(0, 2 * radius, edge), np.arange(0, length, edge * np.sqrt(3) / 2)
    grid = np.stack(np.meshgrid(columns - columns[-1] / 2, rows - rows[-1] / 2, indexing="ij"), axis=-1)
    grid[:, 1::2, 0] += edge / 2
    grid = grid.reshape(-1, 2)
    axis = np.column_stack([0 * grid[:, 0], np.clip(grid[:, 1], radius - reach[1], reach[1] - radius)])
    grid = grid[np.linalg.norm(grid - axis, axis=1) < radius - 0.6 * edge]
    V = np.concatenate([outline, grid])
    return V, Delaunay(V).simplices.astype(np.int64)  # in the plane, SciPy orients them counter-clockwise
