"""The volume in which weights are solved: the inside of a mesh that is a clean solid, else one wrapped around it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from nilbs.geometry.diagnosis import enclosed_volume, solid_defects
from nilbs.geometry.distance import closest_points
from nilbs.geometry.facets import facet_areas, is_watertight
from nilbs.geometry.grids import Grid, cell_corners
from nilbs.geometry.orientation import coherent_orientation
from nilbs.geometry.triangles import conforming_triangles
from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import boundary_facets, element_volumes
from nilbs.geometry.winding import occupancy
from nilbs.geometry.wrapping import wrap, wrapping_surface

# Weights are smooth, so some ten thousand vertices are enough; the time to factorise grows with their square.
SURFACE_LIMIT = 10_000  # vertices; a surface with more is decimated
DECIMATED = 10_000  # facets
SPACING = 0.023  # of the diagonal: edge of the elements inside a slender body
QUALITY = 2**0.5  # circumradius over shortest edge of the worst element
ELEMENTS = 25_000  # inside a bulky one, whose elements are larger
FLAT_SPACING = 0.02  # of the diagonal: between vertices that are added in the plane
# Weights of few bones have few steep places: if so few points hold them, these parts of the numbers above are enough.
FEW_POINTS, FEW_FACETS, FEW_ELEMENTS = 40, 0.4, 0.2
LONGEST_EDGE = 0.05  # of the diagonal; a surface of few triangles with longer edges is refined
RESOLUTIONS = (160, 80)  # cells of a wrap along its longest edge; the second if the first cannot be filled
BLOCKS = 56  # cells along the longest edge of the blocks, which are used if nothing finer can be filled
WELD = 1e-7  # of the diagonal: vertices that are nearer are one
VOLUME_LIMIT = 20_000  # vertices; factorising more takes minutes
SMALLEST_VOLUME = 1e-16  # of the cubed diagonal
SMALLEST_AREA = 1e-14  # of the squared diagonal: triangles with no more have none
MARGIN = 3e-3  # of the diagonal: a point of a bone this near to the surface, or to another point, is not put in


@dataclass(frozen=True)
class Domain:
    """A volume mesh V, T to solve weights in.

    The first `surface` vertices are its boundary's. `notes` holds a sentence on every repair that the mesh needed.
    """

    V: np.ndarray
    T: np.ndarray
    surface: int
    notes: tuple[str, ...]


def volume_domain(V: np.ndarray, E: np.ndarray, points: np.ndarray, *, coarseness: float = 1.0) -> Domain:
    """Fill a mesh of triangles (m, 3) with elements, whatever state it is in.

    The triangles fill the shape in the plane, or are its surface in space. Those of the points (s, d) that lie inside
    become vertices, except in blocks. With a larger `coarseness` elements may be larger, and worse in shape; surfaces
    keep their triangles.

    Notes
    -----
    In the plane the triangles are refined as they are. In space a closed, manifold, oriented surface without crossings
    is filled by TetGen. Any other is wrapped first (see `wrap`) and the wrap is decimated; where TetGen refuses that
    or makes too many elements, the wrap is made coarser, and at last the domain is of blocks, which always exist.
    """
    V, E, points = arrays(V=(V, "n d"), E=(E, "m 3", "V"), points=(points, "s d"))
    if not len(E):
        raise ValueError("the mesh has no triangle")
    used = V[np.unique(E)]
    center, size = (used.min(axis=0) + used.max(axis=0)) / 2, float(np.linalg.norm(np.ptp(used, axis=0))) or 1.0
    # Every tolerance below is of a shape of size one around the origin.
    surface, points = (V - center) / size, (points - center) / size
    flat = V.shape[1] == 2
    area = element_volumes(surface, E) if flat else facet_areas(surface, E)
    if not (np.abs(area) > SMALLEST_AREA).any():
        raise ValueError("no triangle of the mesh has any area")
    notes = []
    # In the plane all triangles turn alike, so that of two in one place one stays.
    surface, E_welded = welded(surface, np.where((area < 0)[:, None], E[:, [0, 2, 1]], E))
    if len(E_welded) < len(E):
        notes.append(f"{len(E) - len(E_welded)} triangles were collapsed or repeated others, and do not count")
    E = E_welded
    if flat:
        V_volume, T = conforming_triangles(surface, E, points, spacing=FLAT_SPACING)
        first = len(surface)
    else:
        F, _ = coherent_orientation(surface, E)
        F = F if enclosed_volume(surface, F) >= 0 else F[:, ::-1]
        V_volume, T, first, more = _spatial(surface, F, points, coarseness)
        notes += more
    return Domain(V_volume * size + center, T, first, tuple(notes))


def welded(V: np.ndarray, E: np.ndarray, *, tolerance: float = WELD) -> tuple[np.ndarray, np.ndarray]:
    """Mesh in which vertices at one place are one vertex, and no face (m, k) is collapsed or repeated.

    Vertices are the same if their coordinates round to the same multiples of the tolerance; used ones keep their order.

    Examples
    --------
    >>> V, E = welded([[0, 0], [1, 0], [0, 1], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [3, 4, 5]])
    >>> len(V), E.tolist()
    (4, [[0, 1, 2], [1, 3, 2]])
    """
    V, E = arrays(V=(V, "n d"), E=(E, "m k", int))
    used = np.unique(E)
    _, first, place = np.unique(np.round(V[used] / tolerance), axis=0, return_index=True, return_inverse=True)
    joined = np.arange(len(V))
    joined[used] = used[first[place.ravel()]]
    E = joined[E]
    ordered = np.sort(E, axis=1)
    E, ordered = (a[(np.diff(ordered, axis=1) > 0).all(axis=1)] for a in (E, ordered))
    E = E[np.sort(np.unique(ordered, axis=0, return_index=True)[1])]
    kept, compact = np.unique(E, return_inverse=True)
    return V[kept], compact.reshape(E.shape)


def _spatial(
    V: np.ndarray, F: np.ndarray, points: np.ndarray, coarseness: float
) -> tuple[np.ndarray, np.ndarray, int, list[str]]:
    from nilbs.geometry.copyleft.tetrahedra import conforming_tetrahedra

    notes: list[str] = []
    # Without a point the weights are given, and their steep places unknown.
    facets, elements = (FEW_FACETS, FEW_ELEMENTS) if 0 < len(points) < FEW_POINTS else (1, 1)
    for V_closed, F_closed, note in _closed_surfaces(V, F, coarseness, facets):
        notes += note
        distance, _, _ = closest_points(V_closed, F_closed, points)
        inner = points[occupancy(V_closed, F_closed, points) & (distance > MARGIN)]
        # A regular tetrahedron with edge h has the volume h^3 / sqrt(72).
        edge = float(np.cbrt(np.sqrt(72) * abs(enclosed_volume(V_closed, F_closed)) / (elements * ELEMENTS)))
        spacing = coarseness * max(SPACING, edge)
        try:
            V_volume, T = conforming_tetrahedra(
                V_closed, F_closed, inner, spacing=spacing, quality=coarseness * QUALITY
            )
        except ValueError:
            continue
        # Nothing can be solved on slivers.
        if len(V_volume) <= VOLUME_LIMIT and element_volumes(V_volume, T).min(initial=1) > SMALLEST_VOLUME:
            return V_volume, T, len(V_closed), notes
    resolution = BLOCKS
    V_volume, T = blocks(*wrap(V, F, resolution=resolution))
    while len(V_volume) > VOLUME_LIMIT / 2 and resolution > 8:
        resolution = resolution * 3 // 4
        V_volume, T = blocks(*wrap(V, F, resolution=resolution))
    notes.append("no finer volume could be filled: weights are solved in blocks")
    return V_volume, T, len(np.unique(boundary_facets(T))), notes


def _closed_surfaces(
    V: np.ndarray, F: np.ndarray, coarseness: float, part: float
) -> Iterator[tuple[np.ndarray, np.ndarray, list[str]]]:
    """Surfaces to fill, the best first, each with its notes."""
    from nilbs.geometry.copyleft.decimation import decimated

    V_few, F_few, notes = V, F, []
    if len(V) > part * SURFACE_LIMIT and is_watertight(F):
        V_few, F_few = decimated(V, F, round(part * DECIMATED))
        notes = [f"the surface is large: weights are solved inside one with {len(F_few)} triangles"]
    # What is filled has to be clean; of a large surface it is also quicker to examine.
    defects = solid_defects(V_few, F_few)
    if not defects:
        yield *_refined(V_few, F_few, coarseness * LONGEST_EDGE), notes
    if not defects or notes:
        defects = (notes and solid_defects(V, F)) or ["it could not be filled"]
    notes = [f"the mesh is not a clean solid ({', '.join(defects)}): weights are solved in a volume wrapped around it"]
    for resolution in RESOLUTIONS:
        yield *decimated(*wrapping_surface(V, F, resolution=resolution), round(part * DECIMATED)), notes
        notes = ["a coarser wrap was needed"]


def _refined(V: np.ndarray, F: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """A surface of few large triangles in more of them: elements behind a large triangle are large themselves."""
    import igl

    while len(F) < DECIMATED / 8 and np.linalg.norm(V[F] - V[np.roll(F, 1, axis=1)], axis=2).max() > longest:
        V, F = igl.upsample(V, F, 1)
    return V, F.astype(np.int64)


def blocks(grid: Grid, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra V, T that fill the cells of a grid in space with a corner of negative level.

    Vertices of the boundary come first. Six tetrahedra a cell, Kuhn's subdivision, which agrees across neighbouring
    cells.
    """
    cell = np.argwhere(np.logical_or.reduce(cell_corners(levels < 0, 3)))
    # A path from corner 000 to 111 along the axes in each of their six orders.
    paths = np.array([np.cumsum(np.eye(3, dtype=np.int64)[list(order)], axis=0) for order in permutations(range(3))])
    paths = np.concatenate([np.zeros((6, 1, 3), dtype=np.int64), paths], axis=1)
    node = np.ravel_multi_index(tuple(np.moveaxis(cell[:, None, None] + paths, -1, 0)), grid.shape).reshape(-1, 4)
    used, T = np.unique(node, return_inverse=True)
    V = grid.nodes(used)
    T = T.reshape(-1, 4)
    T = np.where((element_volumes(V, T) < 0)[:, None], T[:, [0, 2, 1, 3]], T)
    outer = np.zeros(len(V), dtype=bool)
    outer[boundary_facets(T)] = True
    order = np.argsort(~outer, kind="stable")
    rank = np.empty(len(V), dtype=np.int64)
    rank[order] = np.arange(len(V))
    return V[order], rank[T]
