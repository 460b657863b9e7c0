"""Whether what came of a broken character is what must come of it."""

from dataclasses import dataclass
from time import perf_counter, process_time

import numpy as np

from nilbs.geometry.sampling import element_samples, facet_samples, uniform_samples
from nilbs.geometry.volume import element_volumes
from nilbs.geometry.winding import occupancy

from .case import Case, Kind
from .defects import areas

SHARE = 0.002  # of the body that must be nearest to a bone for the bone to have volume around it
OWNED = 0.01  # the least largest weight of a bone that owns some


@dataclass(frozen=True)
class Verdict:
    """What came of one case.

    Attributes
    ----------
    outcome : str
        "weights", or the error's message.
    seconds : float
        Of the processor's time, or on the clock where that was less.
    notes : tuple of str
        The solver's own notes.
    row_error : float
        Largest distance of a row's sum from one.
    problems : tuple of str
        What is wrong; empty where all is as it must be.
    """

    outcome: str
    seconds: float
    notes: tuple[str, ...]
    row_error: float
    problems: tuple[str, ...]


def verdict(kind: Kind, seed: int = 0) -> Verdict:
    from nilbs.characters.character import solve_weights

    case = kind.case(seed)
    start = perf_counter(), process_time()
    try:
        solved = solve_weights(case.V, case.F, case.skeleton)
    except ValueError as error:
        solved, message = None, str(error)
    seconds = min(perf_counter() - start[0], process_time() - start[1])
    problems: list[str] = []
    if solved is None:
        import re

        if kind.outcome == "weights":
            problems.append(f"refused: {message}")
        elif not re.search(kind.error, message):
            problems.append(f"the message does not match {kind.error!r}: {message}")
        return Verdict(message, seconds, (), 0.0, tuple(problems))
    if kind.outcome == "error":
        problems.append("weights where an error must come")
    else:
        problems += faults(case, solved)
    row_error = np.abs(solved.W.sum(axis=1) - 1).max(initial=0)
    return Verdict("weights", seconds, tuple(solved.notes), float(row_error), tuple(problems))


def faults(case: Case, solved: object) -> list[str]:
    """What is wrong with weights, in words."""
    b, found = len(case.skeleton.BE), []
    for name, W, V in (("W", solved.W, case.V), ("W_volume", solved.W_volume, solved.V_volume)):
        if W.shape != (len(V), b):
            found.append(f"{name} is {W.shape}, not ({len(V)}, {b})")
        elif not np.isfinite(W).all():
            found.append(f"{name} is not finite in {int((~np.isfinite(W)).any(axis=1).sum())} rows")
        elif W.min(initial=0) < 0 or W.max(initial=0) > 1 or np.abs(W.sum(axis=1) - 1).max(initial=0) > 1e-9:
            sums = np.abs(W.sum(axis=1) - 1).max(initial=0)
            found.append(f"{name} goes to {W.min():.2g} and to 1 + {W.max() - 1:.2g}, row sums are off by {sums:.2g}")
    if len(solved.T) and not element_volumes(solved.V_volume, solved.T).min() > 0:
        found.append("elements without volume")
    if found:
        return found
    largest = np.maximum(solved.W.max(axis=0, initial=0), solved.W_volume.max(axis=0, initial=0))
    for bone in np.flatnonzero(largest < OWNED):
        share = shares(case)[bone]
        if share > SHARE:
            found.append(f"bone {bone} owns nothing, though nearest to {100 * share:.1f} % of the body")
    return found


def shares(case: Case) -> np.ndarray:
    """Share of the body and of its surface that is nearest to each bone; bones at the same distance all count."""
    x = body_samples(case, np.random.default_rng(0))
    ends, bone = case.skeleton.segments()
    distance = np.full((len(x), len(case.skeleton.BE)), np.inf)
    for (start, end), j in zip(case.skeleton.C[ends], bone, strict=True):
        along = end - start
        s = np.clip((x - start) @ along / max(float(along @ along), 1e-300), 0, 1)
        distance[:, j] = np.minimum(distance[:, j], np.linalg.norm(start + s[:, None] * along - x, axis=1))
    nearest = distance.min(axis=1, keepdims=True)
    slack = 1e-9 * np.linalg.norm(np.ptp(x, axis=0))
    return (distance <= nearest + slack).mean(axis=0)


def body_samples(case: Case, rng: np.random.Generator, n: int = 4000) -> np.ndarray:
    """Places inside the intact body, where there is an inside, and on the surface as it is."""
    V, F = case.V, case.F
    F = F[areas(V, F) > 0]
    if V.shape[1] == 2:
        return element_samples(V, F, n, rng=rng)[0]
    surface = facet_samples(V, F, n // 4, rng=rng)[0]
    solid = case.solid or (V, F)
    corners = solid[0][solid[1].ravel()]
    x = uniform_samples(corners.min(axis=0), corners.max(axis=0), 8 * n, rng=rng)
    return np.concatenate([x[occupancy(*solid, x)][:n], surface])
