"""Inside or outside, by the generalized winding number."""

import numpy as np

from nilbs.geometry.validation import arrays


def winding_number(V: np.ndarray, F: np.ndarray, x: np.ndarray, *, exact: bool = False) -> np.ndarray:
    """Generalized winding number of a surface around points.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3. Facets are triangles counter-clockwise seen from outside, or
        edges with the inside on their left.
    x : (p, d) float array
        Query points, in mesh units.
    exact : bool, optional
        In 3D sum every triangle's solid angle, in time m p, instead of the tree's far-field expansion, whose error is
        a few thousandths. In 2D the answer is exact either way.

    Returns
    -------
    w : (p,) float array
        1 inside a closed surface, 0 outside, 2 where it covers a place twice, fractions near holes, negative where the
        surface is inside out. No facets: 0 everywhere.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex or a number is not finite.

    Notes
    -----
    The 3D tree is that of [2]_ in libigl. In 2D the angle that an edge spans is the difference of its ends' polar
    angles, plus a turn where it crosses their branch cut; along a curve the differences cancel, so that only signed
    crossings of a half line and the angles of loose ends are left.

    References
    ----------
    .. [1] Jacobson, Kavan, Sorkine-Hornung, Robust Inside-Outside Segmentation using Generalized Winding Numbers,
       2013, doi:10.1145/2461912.2461916.
    .. [2] Barill, Dickson, Schmidt, Levin, Jacobson, Fast Winding Numbers for Soups and Clouds, 2018,
       doi:10.1145/3197517.3201337.

    Examples
    --------
    >>> V, F = [[0, 0], [1, 0], [0, 1]], [[0, 1], [1, 2], [2, 0]]
    >>> winding_number(V, F, [[0.2, 0.2], [0.9, 0.9]])
    array([1., 0.])
    """
    V, F, x = arrays(V=(V, "n d"), F=(F, "m d", "V"), x=(x, "p d"))
    if not len(F):
        return np.zeros(len(x))
    if V.shape[1] == 2:
        return _curve_winding_number(V, F, x)
    import igl

    # The tree computes in single precision: far from the origin it needs the surface moved there, at unit size.
    used = V[F.ravel()]
    lower, upper = used.min(axis=0), used.max(axis=0)
    size = (upper - lower).max() or 1.0
    V, x = (np.ascontiguousarray((a - (lower + upper) / 2) / size) for a in (V, x))
    winding = igl.winding_number if exact else igl.fast_winding_number
    return winding(V, np.ascontiguousarray(F), x)


def occupancy(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Whether points lie inside a surface.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.
    x : (p, d) float array
        Query points, in mesh units.

    Returns
    -------
    inside : (p,) bool array
        True where the absolute generalized winding number is above one half: also where a posed body overlaps itself,
        and also for a surface that is inside out. No facets: False everywhere.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex or a number is not finite.

    Examples
    --------
    >>> occupancy([[0, 0], [1, 0], [0, 1]], [[0, 1], [1, 2], [2, 0]], [[0.2, 0.2], [0.9, 0.9]])
    array([ True, False])
    """
    return np.abs(winding_number(V, F, x)) > 0.5


def _curve_winding_number(V: np.ndarray, F: np.ndarray, x: np.ndarray) -> np.ndarray:
    # Sorted by height, the points whose half line towards negative x an edge can cross are one slice.
    order = np.argsort(x[:, 1])
    px, py = x[order].T
    w = np.zeros(len(x))
    start, end = V[F[:, 0]], V[F[:, 1]]
    upward = end[:, 1] > start[:, 1]
    low = np.where(upward[:, None], start, end)
    high = np.where(upward[:, None], end, start)
    # An end at exactly the point's height counts as above, as in arctan2, whose range holds +pi but not -pi.
    first = np.searchsorted(py, low[:, 1], side="right")
    last = np.searchsorted(py, high[:, 1], side="right")
    for e in np.flatnonzero(last > first):
        part = slice(first[e], last[e])
        along = high[e] - low[e]
        left_of_point = along[0] * (py[part] - low[e, 1]) < along[1] * (px[part] - low[e, 0])
        w[part] += np.where(left_of_point, -1.0 if upward[e] else 1.0, 0.0)
    loose = np.bincount(F[:, 1], minlength=len(V)) - np.bincount(F[:, 0], minlength=len(V))
    for v in np.flatnonzero(loose):
        w += loose[v] / (2 * np.pi) * np.arctan2(V[v, 1] - py, V[v, 0] - px)
    result = np.empty_like(w)
    result[order] = w
    return result
