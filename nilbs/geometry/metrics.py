"""Scores of a reconstruction: of its inside, and of its surface."""

from collections.abc import Callable

import numpy as np

from nilbs.geometry.distance import closest_points
from nilbs.geometry.facets import components, facet_areas, facet_normals, is_watertight
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.validation import arrays

# The F-score counts a sample as reached within this part of the unit.
_F_SCORE_DISTANCE = 0.01
# Scores that are best where they are largest.
HIGHER_IS_BETTER = ("iou_bbox", "iou_surface", "normal_consistency", "f_score", "watertight")


def intersection_over_union(predicted: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union of two sets of points.

    Parameters
    ----------
    predicted : (n,) bool array
        Which points the prediction calls inside.
    true : (n,) bool array
        Which points are inside.

    Returns
    -------
    score : float
        Between 0 and 1; 1 for two empty sets, which agree.

    Raises
    ------
    ValueError
        If an array is not of booleans or the shapes disagree.

    Examples
    --------
    >>> intersection_over_union([True, True, False], [True, False, False])
    0.5
    """
    predicted, true = np.asarray(predicted), np.asarray(true)
    for name, value in (("predicted", predicted), ("true", true)):
        if value.dtype != bool or value.ndim != 1:
            raise ValueError(f"{name} must be an (n,) array of booleans, got {value.shape} of {value.dtype}")
    if len(predicted) != len(true):
        raise ValueError(f"true must be (n,) = ({len(predicted)},), got {true.shape}")
    union = np.count_nonzero(predicted | true)
    return float(np.count_nonzero(predicted & true) / union) if union else 1.0


def surface_scores(
    U: np.ndarray,
    F: np.ndarray,
    U_true: np.ndarray,
    F_true: np.ndarray,
    *,
    unit: float,
    n: int = 100_000,
    rng: np.random.Generator,
    closest: Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]] = closest_points,
) -> dict[str, float | int | bool | None]:
    """Scores of a reconstructed surface against the true one.

    Parameters
    ----------
    U, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets of the reconstruction; d is 2 or 3.
    U_true, F_true : (k, d) float array and (l, d) int array
        Vertices and facets of the true surface.
    unit : float
        The length that stands for 100 %, in mesh units: the longest edge of the rest mesh's bounding box.
    n : int, optional
        Number of samples of each surface.
    rng : numpy.random.Generator
        Random number generator.
    closest : function
        A faster one than `nilbs.geometry.distance.closest_points`, with its arguments and results.

    Returns
    -------
    scores : dict
        - ``chamfer_l1``: mean of accuracy and completeness, each the mean distance from one surface's samples to the
          other surface itself; in % of unit;
        - ``chamfer_l1_sampled``: the same to the nearest *sample* of the other surface, which never falls to zero;
        - ``hausdorff``, ``p95``: maximum and 95th percentile of the exact distances both ways; in % of unit;
        - ``normal_consistency``: mean both ways of the product of a sample's normal and that of the nearest facet of
          the other surface, -1 to 1;
        - ``f_score``: harmonic mean of the parts of both samples within 1 % of unit of the other surface, 0 to 1;
        - ``components``, ``watertight``: of the reconstruction.

        What is undefined because a surface is empty or without area is None; ``components`` of nothing is 0.

    Raises
    ------
    ValueError
        If shapes disagree, facets index missing vertices, or unit or n is not positive.

    Notes
    -----
    As in Occupancy Networks (Chamfer, normals) and Convolutional Occupancy Networks (F-score), except that distances go
    to the surface and not to samples of it, and normals keep their sign.

    Examples
    --------
    >>> import numpy as np
    >>> V, F = np.array([[0, 0], [8, 0], [8, 8], [0, 8]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> scores = surface_scores(V, F, V, F, unit=8, n=100, rng=np.random.default_rng(0))
    >>> scores["chamfer_l1"] < 1e-12, scores["f_score"], scores["components"], scores["watertight"]
    (True, 1.0, 1, True)
    """
    U, F, U_true, F_true = arrays(
        U=(U, "n d"), F=(F, "m d", "U"), U_true=(U_true, "k d"), F_true=(F_true, "l d", "U_true")
    )
    if not unit > 0:
        raise ValueError(f"unit must be positive, got {unit}")
    if n < 1:
        raise ValueError(f"n must be positive, got {n}")
    scores: dict[str, float | int | bool | None] = dict.fromkeys(
        ("chamfer_l1", "chamfer_l1_sampled", "hausdorff", "p95", "normal_consistency", "f_score")
    )
    scores["components"] = components(F, len(U))
    scores["watertight"] = is_watertight(F) if len(F) else None
    # A facet without area bears no sample and has no normal; where it is the nearest its neighbours are as near.
    F, F_true = (faces[facet_areas(V, faces) > 0] for V, faces in ((U, F), (U_true, F_true)))
    if not (len(F) and len(F_true)):
        return scores
    x, facet = facet_samples(U, F, n, rng=rng)
    x_true, facet_true = facet_samples(U_true, F_true, n, rng=rng)
    normal, normal_true = facet_normals(U, F), facet_normals(U_true, F_true)
    accuracy, nearest_true, _ = closest(U_true, F_true, x)
    completeness, nearest, _ = closest(U, F, x_true)
    both = np.concatenate([accuracy, completeness])
    near = _F_SCORE_DISTANCE * unit
    precision, recall = np.mean(accuracy <= near), np.mean(completeness <= near)
    aligned = np.sum(normal[facet] * normal_true[nearest_true], axis=1)
    aligned_true = np.sum(normal_true[facet_true] * normal[nearest], axis=1)
    percent = 100 / float(unit)
    scores["chamfer_l1"] = percent * float(accuracy.mean() + completeness.mean()) / 2
    # A sample is a facet with all corners at one place.
    samples = np.repeat(np.arange(n)[:, None], U.shape[1], axis=1)
    there, back = closest(x_true, samples, x)[0], closest(x, samples, x_true)[0]
    scores["chamfer_l1_sampled"] = percent * float(there.mean() + back.mean()) / 2
    scores["hausdorff"] = percent * float(both.max())
    scores["p95"] = percent * float(np.percentile(both, 95))
    scores["normal_consistency"] = float(aligned.mean() + aligned_true.mean()) / 2
    scores["f_score"] = float(2 * precision * recall / (precision + recall)) if precision + recall else 0.0
    return scores
