"""Defects of a surface as the boundary of a solid."""

from dataclasses import dataclass

import numpy as np

from nilbs.geometry.facets import components, facet_areas, facet_normals, seamless
from nilbs.geometry.intersections import degenerate_facets, self_intersections, t_junctions
from nilbs.geometry.topology import Ridges, group_labels, ridges
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import winding_number

_STEP = 1e-4  # in sizes of a facet: so close beside it that little lies between


@dataclass(frozen=True)
class SurfaceReport:
    """Findings on a surface of n vertices and m facets; a clean solid has none of the defects.

    Vertices at one place count as one vertex: a surface that is cut along a seam is not open there.
    "Edges" are end points of edges in the plane.
    """

    d: int
    size: float  # L, the longest edge of the bounding box of the vertices that are used
    volume: float  # enclosed; an area in the plane; negative if facets face inward; only a hint if the surface is open
    vertices: int  # places at which facets have vertices
    components: int  # pieces; facets that share a vertex are in one
    holes: int  # groups of connected edges that belong to one facet only
    open_ridges: int  # edges of one facet only
    crowded_ridges: int  # edges of more than two facets
    disagreeing_ridges: int  # edges of two facets that face opposite ways
    t_junctions: np.ndarray  # (t,) vertices of holes on another edge of a hole; empty if not `all_intersections`
    pinched: np.ndarray  # (p,) vertices where parts of the surface meet in nothing but this vertex
    inside_out: np.ndarray  # (i,) a facet of every closed piece that faces inward and is no cavity of another
    degenerate: np.ndarray  # (g,) facets without area, by `degenerate_facets`
    duplicate: np.ndarray  # (u,) facets with the same vertices as one before them
    intersections: np.ndarray  # (k, 2) pairs of facets, by `self_intersections`
    all_intersections: bool  # whether these are all
    isolated: np.ndarray  # (i,) vertices of no facet
    seam: np.ndarray  # (s,) vertices of facets at the place of another, as textures and sharp edges need; no defect

    @property
    def watertight(self) -> bool:
        """Closed, manifold along its edges and turned alike."""
        return not (self.open_ridges or self.crowded_ridges or self.disagreeing_ridges)

    def solid_defects(self) -> list[str]:
        """What keeps the surface from being a clean solid, most important first; isolated vertices and seams do not."""
        hole, ridge, ridges = ("hole", "edge", "edges") if self.d == 3 else ("open end", "vertex", "vertices")
        crossings = _count(len(self.intersections), "self-intersection")
        findings = [
            (self.holes, _count(self.holes, hole)),
            (len(self.t_junctions), _count(len(self.t_junctions), "T-junction")),
            (self.crowded_ridges, _count(self.crowded_ridges, ridge, ridges) + " of more than two facets"),
            (self.disagreeing_ridges, _count(self.disagreeing_ridges, ridge, ridges) + " where facets disagree"),
            (len(self.inside_out), _count(len(self.inside_out), "part") + " inside out"),
            (len(self.intersections), crossings if self.all_intersections else f"more than {crossings}"),
            (not self.all_intersections and not len(self.intersections), "too many facets in one place"),
            (len(self.pinched), _count(len(self.pinched), "vertex", "vertices") + " where parts only touch"),
            (len(self.degenerate), _count(len(self.degenerate), "facet") + " without area"),
            (len(self.duplicate), _count(len(self.duplicate), "facet") + " twice"),
        ]
        return [text for found, text in findings if found]


def solid_defects(V: np.ndarray, F: np.ndarray) -> list[str]:
    """Short phrases such as "3 holes" on what keeps a surface V, F from being a clean solid.

    None: the surface is closed, manifold, faces outward and is clear of itself; no facet is degenerate or repeated.
    Seams and vertices that no facet uses do no harm.

    Examples
    --------
    >>> V = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> solid_defects(V, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    []
    >>> solid_defects(V, [[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    ['1 hole']
    """
    return surface_report(V, F).solid_defects()


def surface_report(V: np.ndarray, F: np.ndarray) -> SurfaceReport:
    """Examine a surface.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets; d is 2 or 3. Facets are edges in the plane, triangles in space.

    Returns
    -------
    report : SurfaceReport

    Raises
    ------
    ValueError
        If a shape is wrong or F indexes a missing vertex.

    Notes
    -----
    Vertices at one place, with equal coordinates, are joined first. What is reported of a place names its first vertex.

    Examples
    --------
    >>> report = surface_report([[0, 0], [2, 0], [2, 1], [0, 1], [5, 5]], [[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> report.watertight, report.volume, report.isolated.tolist(), report.solid_defects()
    (True, 2.0, [4], [])
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    used = np.unique(F)
    _, place, count = np.unique(V[used] + 0.0, axis=0, return_inverse=True, return_counts=True)
    joined = seamless(V, F)
    whole = np.flatnonzero((np.diff(np.sort(joined, axis=1), axis=1) > 0).all(axis=1))  # facets that did not collapse
    surface = joined[whole]
    meeting = ridges(surface)
    _, _, alike = meeting.neighbours()
    boundary = meeting.corners[meeting.count == 1]
    pairs, complete = self_intersections(V, F)
    return SurfaceReport(
        d=V.shape[1],
        size=float(np.ptp(V[used], axis=0).max()) if len(used) else 0.0,
        volume=enclosed_volume(V, F),
        vertices=len(count),
        components=components(surface, len(V)),
        holes=_holes(boundary),
        open_ridges=len(boundary),
        crowded_ridges=int((meeting.count > 2).sum()),
        disagreeing_ridges=int((~alike).sum()),
        t_junctions=t_junctions(V, boundary) if V.shape[1] == 3 and complete else used[:0],
        pinched=_pinched(surface, meeting),
        inside_out=whole[_inside_out(V, surface, meeting)],
        degenerate=np.flatnonzero(degenerate_facets(V, F)),
        duplicate=whole[_repeated_rows(np.sort(surface, axis=1))],
        intersections=pairs,
        all_intersections=complete,
        isolated=np.setdiff1d(np.arange(len(V)), used),
        seam=used[count[place.ravel()] > 1],
    )


def enclosed_volume(V: np.ndarray, F: np.ndarray) -> float:
    """Volume inside a closed surface, or area inside a closed curve; negative where the facets face inward.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices and facets; d is 2 or 3.

    Returns
    -------
    volume : float
        In mesh units to the power d. Where the surface covers a place twice, it counts twice.

    Raises
    ------
    ValueError
        If V and F disagree on d.

    Examples
    --------
    >>> enclosed_volume([[0, 0], [2, 0], [0, 2]], [[0, 1], [1, 2], [2, 0]])
    2.0
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    return float(_wedges(V, F).sum())


def _wedges(V: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Signed volumes between each facet and one point in the middle."""
    if not len(F):
        return np.zeros(0)
    corners = V[F] - V[F].mean(axis=(0, 1))
    return np.linalg.det(corners) / (2 if V.shape[1] == 2 else 6)


def _count(number: int, one: str, many: str | None = None) -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _repeated_rows(rows: np.ndarray) -> np.ndarray:
    """Rows that stand before them already."""
    _, first = np.unique(rows, axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(rows)), first)


def _holes(boundary: np.ndarray) -> int:
    if boundary.shape[1] == 1:
        return len(boundary)
    vertex, ends = np.unique(boundary, return_inverse=True)
    ends = ends.reshape(-1, 2)
    label = group_labels(ends[:, 0], ends[:, 1], len(vertex))
    return len(np.unique(label))


def _pinched(F: np.ndarray, meeting: Ridges) -> np.ndarray:
    """Vertices whose triangles are not all joined by edges at this vertex."""
    m, d = F.shape
    if d == 2 or not m:
        return np.zeros(0, dtype=np.int64)
    # At a ridge every facet has a corner at its lower and one at its higher vertex; those of one vertex are joined.
    tail = np.arange(3 * m).reshape(m, 3)
    head = np.roll(tail, -1, axis=1)
    along = meeting.sign > 0
    order = np.argsort(meeting.ridge.ravel(), kind="stable")
    together = np.diff(meeting.ridge.ravel()[order]) == 0
    first, second = order[:-1][together], order[1:][together]
    low, high = np.where(along, tail, head).ravel(), np.where(along, head, tail).ravel()
    label = group_labels(np.concatenate([low[first], high[first]]), np.concatenate([low[second], high[second]]), 3 * m)
    _, one = np.unique(label, return_index=True)
    vertex, fans = np.unique(F.ravel()[one], return_counts=True)
    return vertex[fans > 1]


def _inside_out(V: np.ndarray, F: np.ndarray, meeting: Ridges) -> np.ndarray:
    """A facet of every closed, coherent piece that faces inward and does not lie inside another."""
    m = len(F)
    first, second, alike = meeting.neighbours()
    piece = group_labels(first, second, m)
    sound = np.ones(m, dtype=bool)
    sound[piece[first[~alike]]] = False
    sound[piece[(meeting.count[meeting.ridge] != 2).any(axis=1)]] = False
    negative = np.bincount(piece, _wedges(V, F), minlength=m) < 0
    # The winding number beside the largest facet of each such piece, on its outer side, counts what else is around it.
    area = facet_areas(V, F)
    order = np.lexsort((area, piece))
    last = np.append(np.diff(piece[order]) != 0, True)
    facet = order[last & (negative & sound)[piece[order]]]
    if not len(facet):
        return facet
    step = _STEP * area[facet] ** (1 / (V.shape[1] - 1))
    beside = V[F[facet]].mean(axis=1) - step[:, None] * facet_normals(V, F[facet])
    return np.sort(facet[winding_number(V, F, beside) < 0.5])
