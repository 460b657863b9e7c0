"""A surface in numbers, its problems, and the volume that weights will be solved in."""

from typing import Any

import numpy as np

from nilbs.geometry.diagnosis import SurfaceReport, solid_defects, surface_report
from nilbs.geometry.domain import welded
from nilbs.geometry.orientation import coherent_orientation


def describe_surface(
    V: np.ndarray, F: np.ndarray, problems: list[str], *, used: np.ndarray | None = None
) -> dict[str, Any]:
    """Numbers on a surface, by name; `problems` grows by a sentence for every kind of defect.

    Vertices of the elements in `used`, such as triangles inside an outline, are not isolated.

    Examples
    --------
    >>> problems = []
    >>> V, F = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3]])
    >>> describe_surface(V, F, problems)["watertight"], problems
    (False, ['the surface is not closed: 2 of its ends belong to one facet only'])
    """
    d = V.shape[1]
    report = surface_report(V, F)
    isolated = report.isolated if used is None else np.setdiff1d(report.isolated, used)
    problems += _problems(report, len(F), V, isolated)
    extent = np.ptp(V, axis=0)
    return {
        "facets": len(F),
        "lower": V.min(axis=0),
        "upper": V.max(axis=0),
        "L": extent.max(),
        "watertight": report.watertight,
        "edge_manifold": not report.crowded_ridges,
        "vertex_manifold": not len(report.pinched),
        "welded_vertices": report.vertices,
        "seam_vertices": len(report.seam),
        "components": report.components,
        "boundary_edges" if d == 3 else "open_ends": report.open_ridges,
        "nonmanifold_edges" if d == 3 else "nonmanifold_vertices": report.crowded_ridges,
        "holes": report.holes,
        "self_intersections": len(report.intersections),
        "isolated_vertices": len(isolated),
        "degenerate_facets": len(report.degenerate),
        "duplicate_facets": len(report.duplicate),
        "volume" if d == 3 else "area": report.volume,
        "orientation": ("outward" if report.volume > 0 else "inward") if report.watertight and report.volume else None,
    }


def verdict(V: np.ndarray, E: np.ndarray) -> str:
    """The volume in which the weights of a mesh of triangles will be solved, in a line.

    Examples
    --------
    >>> verdict(np.eye(3), np.array([[0, 1, 2]]))
    'not a clean solid (1 hole): weights will be solved in a wrapped volume'
    """
    if V.shape[1] == 2:
        return "flat: its own triangles are the domain of the weights"
    report = surface_report(V, E)
    if not report.solid_defects() and not len(report.seam):
        return "clean solid: used as it is"
    # What the domain of the weights does before it gives a surface up.
    size = float(np.linalg.norm(np.ptp(V[np.unique(E)], axis=0)))
    V, E = welded((V - V[E].mean(axis=(0, 1))) / (size or 1.0), E)
    defects = solid_defects(V, coherent_orientation(V, E)[0]) if len(E) else ["no facet encloses anything"]
    if not defects:
        return "clean solid once vertices at one place are joined and facets are turned alike: used like that"
    return f"not a clean solid ({', '.join(defects)}): weights will be solved in a wrapped volume"


def _problems(report: SurfaceReport, m: int, V: np.ndarray, isolated: np.ndarray) -> list[str]:
    """A sentence on every kind of defect, most important first."""
    plane = report.d == 2
    kind, what = ("ends", "edges") if plane else ("edges", "triangles")
    found = []
    if report.open_ridges:
        found.append(f"the surface is not closed: {report.open_ridges} of its {kind} belong to one facet only")
        if report.t_junctions.size:
            found.append(
                f"{len(report.t_junctions)} vertices lie on the edge of a neighbour (T-junctions), number "
                f"{report.t_junctions[0]} first"
            )
    if report.crowded_ridges:
        found.append(f"the surface is not manifold: {report.crowded_ridges} of its {kind} have more than two facets")
    if report.disagreeing_ridges:
        found.append(
            f"the surface is not consistently oriented: at {report.disagreeing_ridges} of its {kind} neighbouring "
            "facets face opposite ways"
        )
    if len(report.inside_out):
        parts = "the surface is" if report.components == 1 else f"{len(report.inside_out)} closed parts are"
        found.append(f"{parts} inside out: facets face inward, number {report.inside_out[0]} first")
    if len(report.intersections):
        i, j = report.intersections[0].tolist()
        count = f"{'' if report.all_intersections else 'more than '}{len(report.intersections)}"
        found.append(f"the surface runs into itself: {count} pairs of {what} touch or cross, numbers {i} and {j} first")
    elif not report.all_intersections:
        found.append(f"too many {what} lie in one place to test whether the surface runs into itself")
    if len(report.pinched):
        found.append(f"{len(report.pinched)} vertices are where parts only touch, number {report.pinched[0]} first")
    if len(report.degenerate):
        found.append(f"{len(report.degenerate)} of {m} {what} are degenerate, number {report.degenerate[0]} first")
    if len(report.duplicate):
        found.append(f"{len(report.duplicate)} of {m} {what} repeat another, number {report.duplicate[0]} first")
    if len(isolated):
        found.append(f"{len(isolated)} of {len(V)} vertices belong to no facet, number {isolated[0]} first")
    extent = np.ptp(V, axis=0)
    if extent.min() == 0:
        found.append(f"no extent along axis {int(extent.argmin())}")
    return found
