"""What a surface is like, in numbers, and what is wrong with it."""

from typing import Any

import numpy as np

from nilbs.geometry.facets import components, facet_areas, is_watertight


def describe_surface(
    V: np.ndarray, F: np.ndarray, problems: list[str], *, used: np.ndarray | None = None
) -> dict[str, Any]:
    """Describe a surface and list its defects.

    Parameters
    ----------
    V : (n, d) float array
        Vertices.
    F : (m, d) int array
        Facets: edges in the plane, triangles in space.
    problems : list of str
        Grows by a sentence for every kind of defect.
    used : int array, optional
        Other elements whose vertices are not isolated: the triangles inside an outline.

    Returns
    -------
    values : dict
        Numbers by name.

    Examples
    --------
    >>> problems = []
    >>> V, F = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3]])
    >>> describe_surface(V, F, problems)["watertight"], problems
    (False, ['the surface is not closed: 2 of its ends belong to one facet only'])
    """
    d = V.shape[1]
    isolated = np.setdiff1d(np.arange(len(V)), F if used is None else used)
    area = facet_areas(V, F)
    ordered = np.sort(F, axis=1)
    repeated = len(F) - len(np.unique(ordered, axis=0))
    degenerate = int(((area == 0) | (np.diff(ordered, axis=1) == 0).any(axis=1)).sum())
    watertight = is_watertight(F)
    volume = _signed_volume(V, F)
    together = len(V) - len(np.unique(V, axis=0))
    what = "edges" if d == 2 else "triangles"
    if not watertight:
        problems.append(_why_open(F))
    elif volume < 0:
        problems.append("the surface is inside out: its facets face inward")
    if degenerate:
        problems.append(f"{degenerate} of {len(F)} {what} are degenerate, number {int((area == 0).argmax())} first")
    if repeated:
        problems.append(f"{repeated} of {len(F)} {what} repeat another")
    if len(isolated):
        problems.append(f"{len(isolated)} of {len(V)} vertices belong to no facet, number {isolated[0]} first")
    if together:
        problems.append(f"{together} vertices lie exactly on another: the surface may be cut along a seam")
    if np.ptp(V, axis=0).min() == 0:
        problems.append(f"no extent along axis {int(np.ptp(V, axis=0).argmin())}")
    return {
        "facets": len(F),
        "lower": V.min(axis=0),
        "upper": V.max(axis=0),
        "L": np.ptp(V, axis=0).max(),
        "watertight": watertight,
        "components": components(F, len(V)),
        "isolated_vertices": len(isolated),
        "degenerate_facets": degenerate,
        "duplicate_facets": repeated,
        "coincident_vertices": together,
        "volume" if d == 3 else "area": volume,
        "orientation": ("outward" if volume > 0 else "inward") if watertight and volume else None,
    }


def _signed_volume(V: np.ndarray, F: np.ndarray) -> float:
    """Enclosed volume (3D) or area (2D), positive where facets face outward; of an open surface only a hint."""
    corners = V[F] - V.mean(axis=0)
    return float(np.linalg.det(corners).sum() / (2 if V.shape[1] == 2 else 6))


def _why_open(F: np.ndarray) -> str:
    """Why a surface is not watertight: a hole, more than two facets in one place, or facets turned differently."""
    ends = F[:, :, None] if F.shape[1] == 2 else np.stack([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]], axis=1)
    _, count = np.unique(np.sort(ends.reshape(-1, ends.shape[2]), axis=1), axis=0, return_counts=True)
    kind = "ends" if F.shape[1] == 2 else "edges"
    if (count == 1).any():
        return f"the surface is not closed: {int((count == 1).sum())} of its {kind} belong to one facet only"
    if (count > 2).any():
        return f"the surface is not manifold: {int((count > 2).sum())} of its {kind} belong to more than two facets"
    return "the surface is not consistently oriented: neighbouring facets face opposite ways"
