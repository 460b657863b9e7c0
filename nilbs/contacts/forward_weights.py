"""The weights by which the forward map moves points of the rest volume."""

import numpy as np
from scipy.sparse import csr_array

from nilbs.engine.search import SearchEngine
from nilbs.engine.unit_frame import at_rest
from nilbs.models.model import Model

# Weights below this are rounding of the map's single precision.
ROUNDING = 1e-6


def forward_weights(model: Model, x_rest: np.ndarray) -> csr_array:
    """Weights (n, b) of rest points (n, d) under the forward map of a model's compiled search; rows sum to one.

    Notes
    -----
    The map is linear in the pose: where bone b alone is moved by the unit vector k, coordinate k of a point moves by
    its weight of b. Each pose gives the weights of d bones.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> from nilbs.models.fitting import fit
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), steps=0)
    >>> forward_weights(model, np.array([[0.0, -0.4], [0.0, 0.4]])).toarray().round(2)
    array([[1., 0.],
           [0., 1.]])
    """
    engine, d = model.engine(), model.character.d
    assert isinstance(engine, SearchEngine)
    unit, b = at_rest(model.character, x_rest), len(model.character.skeleton.BE)
    rest = np.tile(np.eye(d + 1), (b, 1, 1))
    home = engine(rest).images(unit).astype(np.float64)
    W = np.empty((len(unit), b))
    for first in range(0, b, d):
        bones = np.arange(first, min(first + d, b))
        moved = rest.copy()
        moved[bones, bones - first, d] = 1.0
        W[:, bones] = (engine(moved).images(unit) - home)[:, : len(bones)]
    W[np.abs(W) < ROUNDING] = 0.0
    return csr_array(W / W.sum(axis=1, keepdims=True))
