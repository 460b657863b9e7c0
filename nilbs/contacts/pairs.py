"""Where two posed bodies meet: places on the skin of one that lie inside the other."""

from typing import NamedTuple

import numpy as np

from nilbs.contacts.penetration import penetration_in
from nilbs.geometry.interpolation import facet_shares
from nilbs.geometry.sampling import facet_samples
from nilbs.models.model import Model


class Skin(NamedTuple):
    """Places on a skin, which move with it.

    Attributes
    ----------
    facet : (n,) int array
    barycentric : (n, d) float array
        Weights of the facet's corners.
    """

    facet: np.ndarray
    barycentric: np.ndarray

    def at(self, U: np.ndarray, F: np.ndarray) -> np.ndarray:
        """The places (n, d) where vertices (v, d) and facets (m, d) are."""
        return np.einsum("nc,ncd->nd", self.barycentric, U[F[self.facet]])


class Contacts(NamedTuple):
    """Places where the skins of two bodies a and b reach into each other.

    Attributes
    ----------
    point : (k, d) float array
        A place on the skin of one body, inside the other.
    place : (k, d) float array
        The closest place on the other's skin.
    depth : (k,) float array
        How far apart these are, in mesh units.
    normal : (k, d) float array
        Unit vector from `point` to `place`: the way out, along the other's outward normal; zero where they coincide.
    of_b : (k,) bool array
        Whether `point` is on the skin of b, inside a; else it is on that of a.
    facet, barycentric : (k,) int and (k, d) float array
        Where `point` is on its skin.
    other_facet, other_barycentric : (k,) int and (k, d) float array
        Where `place` is on the other's.
    """

    point: np.ndarray
    place: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    of_b: np.ndarray
    facet: np.ndarray
    barycentric: np.ndarray
    other_facet: np.ndarray
    other_barycentric: np.ndarray


def skin_places(V: np.ndarray, F: np.ndarray, *, samples: int | None = None, seed: int = 0) -> Skin:
    """Places on a skin: its vertices in use, or `samples` of uniform density at rest.

    Examples
    --------
    >>> V, F = np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1], [1, 2], [2, 0]])
    >>> skin_places(V, F).at(V, F).tolist()
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    """
    if samples is not None:
        x, facet = facet_samples(V, F, samples, rng=np.random.default_rng(seed))
        shares = facet_shares(V, F, x, facet)
        return Skin(facet, np.stack([shares[np.arange(len(x)), F[facet, c]] for c in range(V.shape[1])], axis=1))
    _, first = np.unique(F, return_index=True)
    facet, corner = np.divmod(first, V.shape[1])
    return Skin(facet, np.eye(V.shape[1])[corner])


def contacts(
    a: Model, pose_a: np.ndarray, b: Model, pose_b: np.ndarray, *, skins: tuple[Skin, Skin] | None = None
) -> Contacts:
    """Where two posed bodies reach into each other, seen from both.

    Parameters
    ----------
    a, b : Model
        Two models of one dimension, or one twice.
    pose_a, pose_b : (b, d+1, d+1) float array
        Their bone transforms, rest to posed, into one world.
    skins : (Skin, Skin), optional
        Places on the skins of a and b that are searched, from `skin_places`; by default the vertices.

    Returns
    -------
    contacts : Contacts
        First those of b's skin inside a, then those of a's inside b; in the order of the places.

    Raises
    ------
    ValueError
        As for all queries of `Model`, and if the models differ in dimension.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(length=1.0, radius=0.2, d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> rest = np.tile(np.eye(3), (2, 1, 1))
    >>> aside = rest.copy()
    >>> aside[:, 0, 2] = 0.3
    >>> float(contacts(model, rest, model, aside).depth.max().round(2))
    0.1
    """
    if a.character.d != b.character.d:
        raise ValueError(f"both bodies must have one dimension, got {a.character.d} and {b.character.d}")
    skins = skins or (skin_places(a.character.V, a.character.F), skin_places(b.character.V, b.character.F))
    posed = [m.posed(pose) for m, pose in ((a, pose_a), (b, pose_b))]
    sides = []
    for of_b in (True, False):
        own, other = (1, 0) if of_b else (0, 1)
        skin, character = skins[own], posed[own].character
        x = skin.at(posed[own].U, character.F)
        found = penetration_in(posed[other], x)
        here = np.flatnonzero(found.facet >= 0)
        depth, way = found.depth[here], found.way_out[here]
        normal = np.divide(way, depth[:, None], out=np.zeros_like(way), where=depth[:, None] > 0)
        own_places = (skin.facet[here], skin.barycentric[here])
        other_places = (found.facet[here], found.barycentric[here])
        side = (x[here], x[here] + way, depth, normal, np.full(len(here), of_b), *own_places, *other_places)
        sides.append(Contacts(*side))
    return Contacts(*(np.concatenate(both) for both in zip(*sides, strict=True)))
