"""What a ray from the page meets, and the canonical points of what it meets."""

from typing import NamedTuple

import numpy as np

from nilbs.engine.all_roots import all_roots
from nilbs.engine.search import PosedSearch, SearchEngine
from nilbs.figures.views import Section
from nilbs.models.posed_model import PosedModel


class Roots(NamedTuple):
    """A posed point and its canonical points, the deepest first.

    Attributes
    ----------
    x : (d,) float array
    x_rest : (r, d) float array
        In mesh units.
    distance : (r,) float array
        Rest distance at each, in L; nan where the field has none.
    residual : (r,) float array
        In L; nan where the field has no forward map.
    """

    x: np.ndarray
    x_rest: np.ndarray
    distance: np.ndarray
    residual: np.ndarray


def first_on_skin(U: np.ndarray, F: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """How far along a ray, in its direction's lengths, it first meets triangles; inf where it meets none.

    Examples
    --------
    >>> first_on_skin(np.eye(3), np.array([[0, 1, 2]]), np.zeros(3), np.full(3, 1 / 6))
    2.0
    """
    a, e, f = U[F[:, 0]] - origin, U[F[:, 1]] - U[F[:, 0]], U[F[:, 2]] - U[F[:, 0]]
    normal = np.cross(e, f)
    along = normal @ direction
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("mi,mi->m", a, normal) / along
        aside = np.cross(direction, a)
        u = -np.einsum("mi,mi->m", aside, f) / along
        v = np.einsum("mi,mi->m", aside, e) / along
    hit = (along != 0) & (t > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
    return float(t[hit].min(initial=np.inf))


def first_on_section(section: Section, origin: np.ndarray, direction: np.ndarray) -> float:
    """How far along a ray it meets the square of a section, all on the page; inf where it passes by."""
    axes = np.eye(3)
    axes[: len(section.view.axes), : len(section.view.axes)] = section.view.axes
    along = direction @ axes[2]
    t = float((section.centre - origin) @ axes[2] / along) if along else np.inf
    if not 0 < t < np.inf:
        return np.inf
    aside = axes[:2] @ (origin + t * direction - section.centre)
    return t if np.abs(aside).max() <= section.edge / 2 else np.inf


def roots(posed: PosedModel, x: np.ndarray) -> Roots:
    """The canonical points of one posed point (d,): all that the compiled search finds, of another field its one.

    Raises
    ------
    ValueError
        If the field has no canonical points.
    """
    c, frame = posed.character, posed.frame
    engine = posed.model.engine(posed.mapping)
    if isinstance(engine, SearchEngine):
        search = engine(frame.B)
        assert isinstance(search, PosedSearch)
        found, distance = (array[0] for array in all_roots(search, x[None], frame.to_unit))
        order = np.argsort(distance, kind="stable")
        x_rest = found[order].astype(np.float64) * c.L + c.center
        residual = np.linalg.norm(posed.posed_points(x_rest) - x, axis=1) / c.L
        return Roots(x, x_rest, distance[order], residual)
    x_rest = posed.rest_points(x[None]).astype(np.float64)
    x_rest = x_rest[np.isfinite(x_rest).all(axis=1)]
    nothing = np.full(len(x_rest), np.nan)
    return Roots(x, x_rest, nothing, nothing)
