"""Points inside a posed body: how deep they are, and which way is out."""

from typing import NamedTuple

import numpy as np

from nilbs.models.model import Model
from nilbs.models.posed_model import PosedModel


class Penetration(NamedTuple):
    """How deep points are inside a body.

    Attributes
    ----------
    depth : (n,) float array
        Distance to the posed skin, in mesh units; zero outside.
    way_out : (n, d) float array
        From the point to the closest place on the skin, in mesh units; zero outside.
    facet : (n,) int array
        The facet of that place; -1 outside.
    barycentric : (n, d) float array
        Its weights of the facet's corners; nan outside.
    """

    depth: np.ndarray
    way_out: np.ndarray
    facet: np.ndarray
    barycentric: np.ndarray


def penetration(model: Model, x: np.ndarray, pose: np.ndarray) -> Penetration:
    """How deep posed points are inside a body, and the shortest way out.

    Parameters
    ----------
    model : Model
    x : (n, d) or (p, n, d) float array
        Posed points, in mesh units.
    pose : (b, d+1, d+1) or (p, b, d+1, d+1) float array
        Bone transforms, rest to posed.

    Returns
    -------
    penetration : Penetration
        Arrays (n,) and (n, d), or (p, n) and (p, n, d).

    Raises
    ------
    ValueError
        As for all queries of `Model`.

    Notes
    -----
    Inside is where `Model.occupancy` is above one half. Only for those points closest places are searched. Where the
    body overlaps itself, skin inside another part counts, so that the way out may be too short.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(radius=0.2, d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> rest = np.tile(np.eye(3), (2, 1, 1))
    >>> found = penetration(model, np.array([[0.15, 0.0], [0.3, 0.0]]), rest)
    >>> found.depth.round(3).tolist(), found.way_out.round(3).tolist()
    ([0.05, 0.0], [[0.05, 0.0], [0.0, 0.0]])
    """
    return penetration_in(model.posed(pose), x)


def penetration_in(posed: PosedModel, x: np.ndarray) -> Penetration:
    """As `penetration`, in a pose, or in several, for which the model was prepared: cheaper for several queries."""
    inside = posed.occupancy(x) > 0.5
    x = np.asarray(x, dtype=np.float64)
    found = Penetration(np.zeros(x.shape[:-1]), np.zeros(x.shape), np.full(x.shape[:-1], -1), np.full(x.shape, np.nan))
    for k in np.ndindex(x.shape[:-2]):
        here = np.flatnonzero(inside[k])
        if not len(here):
            continue
        places = (posed.model.posed(posed.pose[k]) if k else posed).closest_points(x[k][here])
        found.depth[k][here], found.facet[k][here] = places.distance, places.facet
        found.way_out[k][here], found.barycentric[k][here] = places.point - x[k][here], places.barycentric
    return found
