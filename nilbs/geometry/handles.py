"""Bones as handles: the points that hold a volume mesh, and the weights that are known there."""

import numpy as np

from nilbs.geometry.validation import arrays, check_indices


def bone_samples(C: np.ndarray, BE: np.ndarray, n: int) -> np.ndarray:
    """Evenly spaced points of bones.

    Parameters
    ----------
    C : (k, d) float array
        Joints.
    BE : (b, 2) int array
        Bones, indices into C.
    n : int
        Points on each bone strictly between its joints.

    Returns
    -------
    x : (k' + b n, d) float array
        Every joint that a bone uses, once, then the points between, bone by bone.

    Raises
    ------
    ValueError
        If the sizes disagree or BE indexes a joint that does not exist.

    Examples
    --------
    >>> bone_samples([[0, 0], [1, 0]], [[0, 1]], 1)
    array([[0. , 0. ],
           [1. , 0. ],
           [0.5, 0. ]])
    """
    C, BE = arrays(C=(C, "k d"), BE=(BE, "b 2", int))
    check_indices("BE", BE, len(C), "joints")
    s = (np.arange(1, n + 1) / (n + 1))[:, None]
    between = (1 - s) * C[BE[:, :1]] + s * C[BE[:, 1:]]
    return np.concatenate([C[np.unique(BE)], between.reshape(-1, C.shape[1])])


def bone_conditions(V: np.ndarray, C: np.ndarray, BE: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that lie on bones, and the weights that they hold.

    Parameters
    ----------
    V : (n, d) float array
        Vertices of a volume mesh that conforms to the bones.
    C : (k, d) float array
        Joints.
    BE : (b, 2) int array
        Bones, indices into C.

    Returns
    -------
    fixed : (f,) int array
        Vertices on bones, ascending.
    W_fixed : (f, b) float array
        One for the bone that a vertex lies on; at a joint the bones that meet there share it equally.

    Raises
    ------
    ValueError
        If a bone holds no vertex that it owns at least half of: it lies outside the mesh, or has no length, or another
        bone lies on top of it.

    Notes
    -----
    The conditions of section 3 of [1]_ for bones. The tolerance is relative to the size of V, so the answer does not
    depend on the unit.

    References
    ----------
    .. [1] Jacobson et al., Bounded biharmonic weights for real-time deformation, SIGGRAPH 2011,
       doi:10.1145/2010324.1964973.

    Examples
    --------
    >>> fixed, W_fixed = bone_conditions([[0, 0], [1, 0], [2, 0], [1, 1]], [[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]])
    >>> fixed.tolist(), W_fixed.tolist()
    ([0, 1, 2], [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    """
    V, C, BE = arrays(V=(V, "n d"), C=(C, "k d"), BE=(BE, "b 2", int))
    check_indices("BE", BE, len(C), "joints")
    tolerance = 1e-7 * float(np.linalg.norm(np.ptp(V, axis=0))) if len(V) else 0.0
    on = np.zeros((len(V), len(BE)), dtype=bool)
    for bone, (first, second) in enumerate(C[BE]):
        axis = second - first
        s = np.clip((V - first) @ axis / max(float(axis @ axis), 1e-300), 0, 1)
        on[:, bone] = np.linalg.norm(first + s[:, None] * axis - V, axis=1) <= tolerance
    fixed = np.flatnonzero(on.any(axis=1))
    W_fixed = on[fixed] / on[fixed].sum(axis=1, keepdims=True)
    weak = np.flatnonzero(W_fixed.max(axis=0, initial=0) < 0.5)
    if len(weak):
        bone = int(weak[0])
        raise ValueError(
            f"bone {bone} (joints {BE[bone, 0]} and {BE[bone, 1]}) holds no vertex of the volume mesh: "
            "it lies outside the mesh or on top of another bone; move the joints inside or remove the bone"
        )
    return fixed, W_fixed
