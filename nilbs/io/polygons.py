"""What a mesh file holds before its polygons are cut into triangles."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nilbs.io.errors import FileFormatError


@dataclass(frozen=True)
class Elements:
    """Faces or edges in the order of the file: corners (c,), counts (e,), and lines (e,) if any."""

    corners: np.ndarray
    counts: np.ndarray
    lines: np.ndarray | None

    def line(self, element: int) -> int | None:
        """The line of an element, where there is one."""
        return None if self.lines is None else int(self.lines[element])


@dataclass(frozen=True)
class MeshFile:
    """What a mesh file lists; its format gives the number `first` to its first vertex."""

    path: str | os.PathLike
    V: np.ndarray
    faces: Elements
    edges: Elements
    first: int
    groups: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def no_elements() -> Elements:
    """No faces, or no edges."""
    return Elements(np.zeros(0, np.int64), np.zeros(0, np.int64), None)


def check_corners(file: MeshFile, kind: str) -> None:
    """Check that the corners of "face" or "edge" elements index vertices."""
    elements = file.faces if kind == "face" else file.edges
    wrong = np.flatnonzero((elements.corners < 0) | (elements.corners >= len(file.V)))
    if len(wrong):
        element = int(np.searchsorted(np.cumsum(elements.counts), wrong[0], side="right"))
        vertex = elements.corners[wrong[0]] + file.first
        message = f"the {kind} refers to vertex {vertex} of {len(file.V)}, counted from {file.first}"
        named = message if elements.lines is not None else f"{kind} {element}: {message}"
        raise FileFormatError(file.path, named, elements.line(element))


def without_repeats(elements: Elements) -> Elements:
    """Elements without corners that repeat the one before them: some have few corners left, or none.

    Examples
    --------
    >>> short = without_repeats(Elements(np.array([0, 1, 1, 2, 5, 6, 6]), np.array([4, 3]), None))
    >>> short.corners.tolist(), short.counts.tolist()
    ([0, 1, 2, 5, 6], [3, 2])
    """
    following = np.roll(elements.corners, -1)
    last = (np.cumsum(elements.counts) - 1)[elements.counts > 0]
    following[last] = elements.corners[last - elements.counts[elements.counts > 0] + 1]
    kept = elements.corners != following
    element = np.repeat(np.arange(len(elements.counts)), elements.counts)
    counts = np.bincount(element[kept], minlength=len(elements.counts))
    return Elements(elements.corners[kept], counts, elements.lines)
