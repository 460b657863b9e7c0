"""Where rays and segments first meet a posed body."""

from typing import NamedTuple

import numpy as np

from nilbs.geometry.facets import facet_normals
from nilbs.geometry.validation import arrays
from nilbs.models.model import Model

# In units of L: a ray this close to the skin has met it; one that is no closer after so many steps than the second
# number has not, and passes by.
MET, BESIDE, STEPS = 1e-5, 2e-4, 1000


class Hits(NamedTuple):
    """Where rays first meet the skin.

    Attributes
    ----------
    t : (n,) float array
        Distance from the ray's origin, in mesh units; inf where it meets nothing.
    point, normal : (n, d) float arrays
        The place on the skin, and the outward unit normal of its facet; nan where there is none.
    facet : (n,) int array
        The facet; -1 where there is none.
    x_rest : (n, d) float array
        The place at rest: its canonical point; nan where there is none.
    """

    t: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    facet: np.ndarray
    x_rest: np.ndarray


def first_hits(
    model: Model, origin: np.ndarray, direction: np.ndarray, pose: np.ndarray, *, far: float | np.ndarray = np.inf
) -> Hits:
    """Where rays first meet the posed skin, by sphere tracing.

    Parameters
    ----------
    model : Model
    origin, direction : (n, d) float array
        Where rays begin, in mesh units, and where they go; of any length but zero.
    pose : (b, d+1, d+1) float array
        Bone transforms, rest to posed.
    far : float or (n,) float array
        How far along a ray hits count, in mesh units: the length of a segment.

    Returns
    -------
    hits : Hits
        Of a ray that begins inside the body, its origin's closest place, at t = 0.

    Raises
    ------
    ValueError
        As for all queries, if shapes disagree or a direction is zero.

    Notes
    -----
    A ray advances by the distance to the skin until that is a hundred-thousandth of L [1]_. A ray that grazes the skin
    may take so many steps that it counts as one that passes by.

    References
    ----------
    .. [1] Hart, Sphere tracing: a geometric method for the antialiased ray tracing of implicit surfaces, The Visual
       Computer, 1996, doi:10.1007/s003710050084.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(radius=0.2, d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> hits = first_hits(model, [[-1, 0], [-1, 2]], [[1, 0], [1, 0]], np.tile(np.eye(3), (2, 1, 1)))
    >>> hits.t.round(3).tolist()
    [0.8, inf]
    """
    d, L, F = model.character.d, model.character.L, model.character.F
    origin, direction = arrays(origin=(origin, f"n {d}"), direction=(direction, f"n {d}"))
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    if not (length > 0).all():
        raise ValueError(f"direction[{int(np.argmin(length > 0))}] is zero")
    posed = model.posed(pose)
    direction = direction / length
    t, last = _within(origin, direction, posed.U, 2 * BESIDE * L)
    last = np.minimum(last, far)
    inside = np.flatnonzero(t <= 0)
    t = np.maximum(t, 0.0)
    met = np.zeros(len(t), dtype=bool)
    met[inside] = posed.occupancy(origin[inside]) > 0.5
    active = np.flatnonzero((t <= last) & ~met)
    for _ in range(STEPS):
        if not len(active):
            break
        distance = posed.surface.distance(origin[active] + t[active, None] * direction[active])
        close = distance <= MET * L
        met[active[close]] = True
        active, distance = active[~close], distance[~close]
        t[active] += np.maximum(distance, 2 * MET * L)
        active = active[t[active] <= last[active]]
    if len(active):
        distance = posed.surface.distance(origin[active] + t[active, None] * direction[active])
        met[active[distance <= BESIDE * L]] = True
    here = np.flatnonzero(met)
    places = posed.surface.closest(origin[here] + t[here, None] * direction[here])
    none = np.full((len(t), d), np.nan)
    found = Hits(np.full(len(t), np.inf), none, none.copy(), np.full(len(t), -1), none.copy())
    found.t[here], found.point[here], found.facet[here] = t[here], places.point, places.facet
    found.normal[here] = facet_normals(posed.U, F)[places.facet]
    found.x_rest[here] = np.einsum("nc,ncd->nd", places.barycentric, model.character.V[F[places.facet]])
    return found


def segments(model: Model, start: np.ndarray, end: np.ndarray, pose: np.ndarray) -> Hits:
    """Where segments first meet the posed skin.

    Parameters
    ----------
    model : Model
    start, end : (n, d) float array
        Where segments begin and end, in mesh units; a segment may be a point.
    pose : (b, d+1, d+1) float array
        Bone transforms, rest to posed.

    Returns
    -------
    hits : Hits
        With distances from the segment's start. Of a segment that begins inside the body, its start's closest place, at
        t = 0.

    Raises
    ------
    ValueError
        As for all queries, and if shapes disagree.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(radius=0.2, d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> hits = segments(model, [[-1, 0], [-1, 0]], [[0, 0], [-0.5, 0]], np.tile(np.eye(3), (2, 1, 1)))
    >>> hits.t.round(3).tolist()
    [0.8, inf]
    """
    d = model.character.d
    start, end = arrays(start=(start, f"n {d}"), end=(end, f"n {d}"))
    length = np.linalg.norm(end - start, axis=1)
    # Where a segment is a point, any direction does.
    direction = np.where((length > 0)[:, None], end - start, np.eye(d)[0])
    return first_hits(model, start, direction, pose, far=length)


def _within(origin: np.ndarray, direction: np.ndarray, U: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter and leave the box around points, which is a little larger; entering last where they miss it."""
    low, high = U.min(axis=0) - margin, U.max(axis=0) + margin
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    # A ray along a side of the box is between its planes or not, wherever it goes.
    parallel = direction == 0
    outside = parallel & ((origin < low) | (origin > high))
    first = np.where(parallel, -np.inf, np.minimum(a, b)).max(axis=1)
    last = np.where(parallel, np.inf, np.maximum(a, b)).min(axis=1)
    return np.where(outside.any(axis=1), np.inf, first), last
