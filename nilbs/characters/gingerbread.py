"""A gingerbread man drawn from code: a flat figure or a cookie, with a skeleton of thirteen bones.

The figure is a smooth union of capsules around the skeleton. Its outline, resampled evenly, is all that the flat mesh
and the cookie are made from, so both are the same on every machine up to rounding.
"""

from pathlib import Path

import numpy as np

from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.plane import in_space
from nilbs.geometry.winding import occupancy
from nilbs.io.mesh import write_mesh
from nilbs.io.tgf import write_tgf

# Joints of the middle and of the left half (x > 0); _skeleton mirrors the limbs.
_JOINTS = {
    "seat": (0.0, -0.185),
    "pelvis": (0.0, -0.075),
    "chest": (0.0, 0.1),
    "crown": (0.0, 0.425),
    "shoulder": (0.13, 0.115),
    "elbow": (0.24, 0.125),
    "hand": (0.35, 0.145),
    "knee": (0.175, -0.255),
    "foot": (0.265, -0.38),
}
# One tree under the single root bone seat-pelvis: every other bone starts where its parent ends.
_TRUNK = (("seat", "pelvis"), ("pelvis", "chest"), ("chest", "crown"))
_LIMBS = (("chest", "shoulder"), ("shoulder", "elbow"), ("elbow", "hand"), ("pelvis", "knee"), ("knee", "foot"))

# Capsules (start, end, radius) of the body; a circle is a capsule without length. Limbs are mirrored.
_BODY = (
    ((0.0, 0.38), (0.0, 0.38), 0.127),
    ((0.0, 0.055), (0.0, 0.264), 0.055),
    ((0.0, 0.066), (0.0, -0.088), 0.143),
    ((0.11, 0.11), (0.363, 0.143), 0.064),
    ((-0.11, 0.11), (-0.363, 0.143), 0.064),
    ((0.099, -0.143), (0.275, -0.396), 0.075),
    ((-0.099, -0.143), (-0.275, -0.396), 0.075),
)
_SMOOTHING = 0.033  # length over which neighbouring capsules melt into each other
_HALF_THICKNESS = 0.1  # of the cookie
_ROUNDING = 0.036  # radius of the cookie's edges; must stay below the smallest radius of the outline


def gingerbread(d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """V, triangles, C and BE of the gingerbread man, about one unit tall: a flat figure (d = 2) or a cookie (d = 3).

    The triangles fill the flat figure, or are the cookie's closed surface. It stands upright in y, centred at z = 0;
    bone 0 is the only root. Nothing is random. In 2D the bones are chains of edges of the mesh.

    Examples
    --------
    >>> V, E, C, BE = gingerbread(2)
    >>> V.shape[1], E.shape[1], len(BE)
    (2, 3, 13)
    """
    if d not in (2, 3):
        raise ValueError(f"d must be 2 or 3, got {d}")
    C, BE = _skeleton()
    if d == 2:
        outline = _outline(320)
        V, T = _fill(outline, also=_bone_samples(C, BE, spacing=float(np.linalg.norm(outline[1] - outline[0]))))
        return V, T, C, BE
    V, F = _cookie(_outline(265))
    return V, F, in_space(C), BE


def write_gingerbread(folder: str | Path, d: int) -> tuple[Path, Path]:
    """Write the gingerbread man as files: gingerbread.obj (d = 2) or cookie.obj (d = 3), and gingerbread.tgf.

    The folder is made if it is missing. The skeleton's file is the same for both; coordinates have six decimals.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.name for path in write_gingerbread(folder, 2)]
    ['gingerbread.obj', 'gingerbread.tgf']
    """
    V, E, C, BE = gingerbread(d)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    mesh, rig = folder / ("gingerbread.obj" if d == 2 else "cookie.obj"), folder / "gingerbread.tgf"
    write_mesh(mesh, V.round(6) + 0.0, E)  # adding zero turns -0.0 into 0.0
    write_tgf(rig, in_space(C.round(6) + 0.0), BE)
    return mesh, rig


def _skeleton() -> tuple[np.ndarray, np.ndarray]:
    joints: dict[tuple[float, float], int] = {}
    bones = []
    for chain, side in ((_TRUNK, 1), (_LIMBS, 1), (_LIMBS, -1)):
        for bone in chain:
            ends = [(side * _JOINTS[name][0] + 0.0, _JOINTS[name][1]) for name in bone]
            bones.append([joints.setdefault(end, len(joints)) for end in ends])
    return np.array(list(joints)), np.array(bones)


def _body(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A smooth implicit function of the flat body, negative inside, with its gradient; nearly a distance outside."""
    distances = np.empty((len(_BODY), len(x)))
    directions = np.empty((len(_BODY), *x.shape))
    for k, (start, end, radius) in enumerate(_BODY):
        axis = np.subtract(end, start)
        along = np.clip((x - start) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
        offset = x - start - along[:, None] * axis
        length = np.linalg.norm(offset, axis=1)
        distances[k] = length - radius
        directions[k] = offset / np.maximum(length, 1e-12)[:, None]
    least = distances.min(axis=0)
    share = np.exp((least - distances) / _SMOOTHING)
    total = share.sum(axis=0)
    return least - _SMOOTHING * np.log(total), np.einsum("kn,knd->nd", share / total, directions)


def _onto_outline(x: np.ndarray) -> np.ndarray:
    """Points near the outline moved onto it along the gradient (Newton's method)."""
    for _ in range(5):
        value, gradient = _body(x)
        x = x - (value / np.einsum("nd,nd->n", gradient, gradient))[:, None] * gradient
    return x


def _outline(n: int) -> np.ndarray:
    """The outline as n points, counter-clockwise from the top of the head, evenly spaced by arc length."""
    grid = Grid(np.array([-0.6, -0.6]), 0.01, (121, 121))
    V, F = isosurface(_body(grid.points())[0].reshape(grid.shape), grid)
    following = np.empty(len(V), dtype=int)
    following[F[:, 0]] = F[:, 1]
    loop = [int(np.argmax(V[:, 1]))]
    while (after := int(following[loop[-1]])) != loop[0]:
        loop.append(after)
    assert len(loop) == len(V), "the outline must be one closed curve"

    # The grid's own points are uneven; a few rounds of resampling and projecting forget where they were.
    x = V[loop]
    for points in (4 * n, n, n):
        x = _onto_outline(x)
        x[0] = [0.0, x[0, 1]]
        x[:1] = _onto_outline(x[:1])
        closed = np.vstack([x, x[:1]])
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        at = np.linspace(0.0, s[-1], points, endpoint=False)
        x = np.column_stack([np.interp(at, s, closed[:, k]) for k in range(2)])
    return _onto_outline(x)


def _bone_samples(C: np.ndarray, BE: np.ndarray, *, spacing: float) -> np.ndarray:
    """Points along the bones, both ends included, every joint once."""
    samples = [C]
    for start, end in C[BE]:
        pieces = max(1, round(float(np.linalg.norm(end - start)) / spacing))
        s = np.arange(1, pieces)[:, None] / pieces
        samples.append(start + s * (end - start))
    return np.concatenate(samples)


def _fill(outline: np.ndarray, *, also: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that fill a closed outline; vertices are the outline's, then those of `also`, then a hexagonal grid's.

    Free of Shewchuk's Triangle, whose licence forbids commercial use: a Delaunay triangulation holds every edge of
    the outline on its own as long as the other points keep their distance from it.
    """
    from scipy.spatial import Delaunay, cKDTree

    loop = np.arange(len(outline))
    edges = np.column_stack([loop, np.roll(loop, -1)])
    lengths = np.linalg.norm(outline[edges[:, 1]] - outline[edges[:, 0]], axis=1)
    spacing = float(lengths.mean())
    lower, upper = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(lower[1], upper[1], spacing * np.sqrt(3) / 2)
    columns = np.arange(lower[0], upper[0], spacing)
    grid = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1)
    grid[:, 1::2, 0] += spacing / 2
    grid = grid.reshape(-1, 2)
    grid = grid[occupancy(outline, edges, grid)]
    # An edge is in the triangulation when the circle around it is empty: half a length clears it, the rest is shape.
    distance, nearest = cKDTree(outline[edges].mean(axis=1)).query(grid)
    grid = grid[distance > 0.8 * lengths[nearest]]
    if len(also):
        grid = grid[cKDTree(also).query(grid)[0] > 0.7 * spacing]

    V = np.concatenate([outline, also, grid])
    T = Delaunay(V).simplices.astype(np.int64)  # in the plane, SciPy orients them counter-clockwise
    T = T[occupancy(outline, edges, V[T].mean(axis=1))]
    present = {tuple(edge) for edge in T[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    missing = [edge for edge in edges.tolist() if tuple(edge) not in present]
    assert not missing, f"the triangulation lacks {len(missing)} edges of the outline"
    return V, T


def _cookie(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The outline extruded in z with rounded edges: two filled faces joined by rings of quadrilaterals cut in two."""
    n = len(outline)
    gradient = _body(outline)[1]
    inward = -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    spacing = float(np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).mean())

    # The profile from the back face's rim to the front's: how far each ring lies inside the outline, and at which z.
    arc = np.linspace(0.0, np.pi / 2, max(3, round(_ROUNDING * np.pi / 2 / spacing) + 1))
    inset, height = _ROUNDING * (1 - np.sin(arc)), _HALF_THICKNESS - _ROUNDING + _ROUNDING * np.cos(arc)
    wall = np.linspace(-height[-1], height[-1], max(2, round(2 * height[-1] / spacing) + 1))[1:-1]
    insets = np.concatenate([inset, 0.0 * wall, inset[::-1]])
    heights = np.concatenate([-height, wall, height[::-1]])

    rim = outline + _ROUNDING * inward
    flat, T = _fill(rim, also=np.empty((0, 2)))
    rings = [np.column_stack([outline + k * inward, np.full(n, z)]) for k, z in zip(insets, heights, strict=True)]
    inner = flat[n:]
    back = np.column_stack([inner, np.full(len(inner), heights[0])])
    front = np.column_stack([inner, np.full(len(inner), heights[-1])])
    V = np.concatenate([*rings, back, front])

    start = np.arange(len(rings) - 1)[:, None] * n
    here = (start + np.arange(n)).ravel()
    aside = (start + (np.arange(n) + 1) % n).ravel()
    sides = np.concatenate([np.column_stack([here, aside, aside + n]), np.column_stack([here, aside + n, here + n])])
    last = n * (len(rings) - 1)
    to_back = np.concatenate([np.arange(n), n * len(rings) + np.arange(len(inner))])
    to_front = np.concatenate([last + np.arange(n), n * len(rings) + len(inner) + np.arange(len(inner))])
    return V, np.concatenate([sides, to_back[T][:, ::-1], to_front[T]])
