"""Random points: in a box, on a surface by area, in a volume by volume, near a surface."""

import numpy as np

from nilbs.geometry.facets import facet_areas
from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import element_volumes


def uniform_samples(lower: np.ndarray, upper: np.ndarray, n: int, *, rng: np.random.Generator) -> np.ndarray:
    """Uniform points (n, d) in a box between two opposite corners.

    Examples
    --------
    >>> import numpy as np
    >>> uniform_samples([0, 0], [1, 0], 2, rng=np.random.default_rng(0)).round(2)
    array([[0.64, 0.  ],
           [0.04, 0.  ]])
    """
    lower, upper = arrays(lower=(lower, "d"), upper=(upper, "d"))
    if (upper < lower).any():
        raise ValueError(f"upper must not be below lower, got {upper.tolist()} and {lower.tolist()}")
    if n < 0:
        raise ValueError(f"n must not be negative, got {n}")
    return lower + (upper - lower) * rng.random((n, len(lower)))


def facet_samples(V: np.ndarray, F: np.ndarray, n: int, *, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Uniform points on a surface: by area in 3D, by length in 2D.

    Parameters
    ----------
    V, F : (nv, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.
    n : int
        Number of points.
    rng : numpy.random.Generator
        Random number generator.

    Returns
    -------
    x : (n, d) float array
        Points, in mesh units.
    facet : (n,) int array
        The facet that each lies on.

    Raises
    ------
    ValueError
        If shapes disagree, F indexes a missing vertex, n is negative, or n is positive and the surface has no area.

    Examples
    --------
    >>> import numpy as np
    >>> x, facet = facet_samples([[0, 0], [1, 0], [1, 9]], [[0, 1], [1, 2]], 1000, rng=np.random.default_rng(0))
    >>> x.shape, np.bincount(facet)
    ((1000, 2), array([ 89, 911]))
    """
    V, F = arrays(V=(V, "n d"), F=(F, "m d", int))
    facet = _weighted_choice(facet_areas(V, F), n, "surface", rng)
    barycentric = _uniform_barycentric(n, V.shape[1], rng)
    return np.einsum("nk,nkd->nd", barycentric, V[F[facet]]), facet


def element_samples(
    V: np.ndarray, T: np.ndarray, n: int, *, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Uniform points in a volume mesh.

    Parameters
    ----------
    V, T : (nv, d) float array and (t, d+1) int array
        Vertices, in mesh units, and elements: triangles or tetrahedra; the orientation does not matter.
    n : int
        Number of points.
    rng : numpy.random.Generator
        Random number generator.

    Returns
    -------
    x : (n, d) float array
        Points, in mesh units.
    element : (n,) int array
        The element that each lies in.
    barycentric : (n, d+1) float array
        Its barycentric coordinates there; rows sum to one.

    Raises
    ------
    ValueError
        If shapes disagree, T indexes a missing vertex, n is negative, or n is positive and the mesh has no volume.

    Examples
    --------
    >>> import numpy as np
    >>> V = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> x, element, barycentric = element_samples(V, [[0, 1, 2]], 5, rng=np.random.default_rng(0))
    >>> np.allclose(barycentric @ V, x)
    True
    """
    V, T = arrays(V=(V, "n d"), T=(T, "t d+1", int))
    element = _weighted_choice(np.abs(element_volumes(V, T)), n, "volume mesh", rng)
    barycentric = _uniform_barycentric(n, V.shape[1] + 1, rng)
    return np.einsum("nk,nkd->nd", barycentric, V[T[element]]), element, barycentric


def near_surface_samples(V: np.ndarray, F: np.ndarray, n: int, *, std: float, rng: np.random.Generator) -> np.ndarray:
    """Points of a surface, moved by isotropic Gaussian noise.

    Parameters
    ----------
    V, F : (nv, d) float array and (m, d) int array
        Vertices, in mesh units, and facets; d is 2 or 3.
    n : int
        Number of points.
    std : float
        Standard deviation of the noise along each axis, in mesh units.
    rng : numpy.random.Generator
        Random number generator.

    Returns
    -------
    x : (n, d) float array
        In mesh units.

    Raises
    ------
    ValueError
        As :func:`facet_samples`, or if std is negative.

    Examples
    --------
    >>> import numpy as np
    >>> near_surface_samples([[0, 0], [1, 0]], [[0, 1]], 3, std=0.1, rng=np.random.default_rng(0)).shape
    (3, 2)
    """
    if not std >= 0:
        raise ValueError(f"std must not be negative, got {std}")
    x, _ = facet_samples(V, F, n, rng=rng)
    return x + std * rng.standard_normal(x.shape)


def _weighted_choice(weight: np.ndarray, n: int, what: str, rng: np.random.Generator) -> np.ndarray:
    """Indices drawn with probability proportional to weight; never one whose weight is zero."""
    if n < 0:
        raise ValueError(f"n must not be negative, got {n}")
    total = np.cumsum(weight)
    if n and not (len(weight) and total[-1] > 0):
        raise ValueError(f"cannot sample a {what} of no extent")
    if not n:
        return np.empty(0, dtype=np.int64)
    draw = rng.random(n) * total[-1]
    return np.searchsorted(total, draw, side="right")


def _uniform_barycentric(n: int, corners: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform points of a simplex: normalised exponential variables."""
    barycentric = rng.standard_exponential((n, corners))
    return barycentric / barycentric.sum(axis=1, keepdims=True)
