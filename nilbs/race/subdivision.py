"""The same character with more triangles."""

from dataclasses import replace

import numpy as np

from nilbs.models.model import Model

# Of each triangle by its corners 0, 1, 2 and the midpoints 3, 4, 5 of the edges 01, 12, 20.
_PARTS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


def subdivided(V: np.ndarray, F: np.ndarray, W: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3), triangles (4 m, 3) and weights (n, b), with a new vertex in the middle of every edge of F.

    Examples
    --------
    >>> V, F, W = np.eye(3), np.array([[0, 1, 2]]), np.eye(3)
    >>> V, F, W = subdivided(V, F, W)
    >>> len(V), len(F), W[3].tolist()
    (6, 4, [0.5, 0.5, 0.0])
    """
    edges = np.sort(F[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edge, which = np.unique(edges, axis=0, return_inverse=True)
    corners = np.concatenate([F, len(V) + which.reshape(-1, 3)], axis=1)
    V, W = (np.concatenate([a, (a[edge[:, 0]] + a[edge[:, 1]]) / 2]) for a in (V, W))
    return V, np.ascontiguousarray(corners[:, _PARTS].reshape(-1, 3)), W


def subdivided_model(model: Model, level: int) -> Model:
    """The model with a mesh whose triangles are divided in four `level` times: its grids and its network are the same.

    The rest surface is the same too, and so is the unit frame. The posed surface differs, as weights are linear on
    smaller triangles.
    """
    c = model.character
    V, F, W = c.V, c.F, c.W
    for _ in range(level):
        V, F, W = subdivided(V, F, W)
    return Model(replace(c, V=V, F=F, W=W), model.motion, model.method, model.history, model.parameters, model.rest)
