"""What a mesh file holds before its polygons are cut into triangles."""

import os
from dataclasses import dataclass

import numpy as np

from nilbs.io.errors import FileFormatError


@dataclass(frozen=True)
class Elements:
    """Faces or edges as the file lists them.

    Parameters
    ----------
    corners : (c,) int array
        Vertex indices from 0, one element after the other.
    counts : (e,) int array
        How many corners each element has.
    lines : (e,) int array or None
        Where each element stands, where the file has lines.
    """

    corners: np.ndarray
    counts: np.ndarray
    lines: np.ndarray | None

    def line(self, element: int) -> int | None:
        """The line of an element, where there is one."""
        return None if self.lines is None else int(self.lines[element])


@dataclass(frozen=True)
class MeshFile:
    """Vertices (n, 3), faces, edges, and the number that the format gives to its first vertex."""

    path: str | os.PathLike
    V: np.ndarray
    faces: Elements
    edges: Elements
    first: int


def check_corners(file: MeshFile, kind: str) -> None:
    """Check that elements have enough corners and that these index vertices.

    Parameters
    ----------
    file : MeshFile
        The file.
    kind : "face" or "edge"
        Which of its elements.

    Raises
    ------
    FileFormatError
        Naming the first element at fault.
    """
    elements = file.faces if kind == "face" else file.edges
    least = 3 if kind == "face" else 2
    few = np.flatnonzero(elements.counts < least)
    if len(few):
        message = (
            f"{'a' if kind == 'face' else 'an'} {kind} needs {least} corners, this one has {elements.counts[few[0]]}"
        )
        raise FileFormatError(file.path, _named(kind, elements, few[0], message), elements.line(few[0]))
    wrong = np.flatnonzero((elements.corners < 0) | (elements.corners >= len(file.V)))
    if len(wrong):
        element = int(np.searchsorted(np.cumsum(elements.counts), wrong[0], side="right"))
        vertex = elements.corners[wrong[0]] + file.first
        message = f"the {kind} refers to vertex {vertex} of {len(file.V)}, counted from {file.first}"
        raise FileFormatError(file.path, _named(kind, elements, element, message), elements.line(element))


def triangle_fans(faces: Elements) -> tuple[np.ndarray, np.ndarray]:
    """Cut every polygon into a fan of triangles around its first corner.

    Parameters
    ----------
    faces : Elements
        Each with three corners or more.

    Returns
    -------
    F : (m, 3) int array
        Triangles, in the order of their polygons, wound like them.
    face : (m,) int array
        The polygon that each triangle comes from.

    Examples
    --------
    >>> triangle_fans(Elements(np.array([0, 1, 2, 3]), np.array([4]), None))[0]
    array([[0, 1, 2],
           [0, 2, 3]])
    """
    fans = faces.counts - 2
    face = np.repeat(np.arange(len(fans)), fans)
    step = np.arange(len(face)) - np.repeat(np.cumsum(fans) - fans, fans)
    start = (np.cumsum(faces.counts) - faces.counts)[face]
    F = np.stack([faces.corners[start], faces.corners[start + step + 1], faces.corners[start + step + 2]], axis=1)
    return F, face


def _named(kind: str, elements: Elements, index: int, message: str) -> str:
    return message if elements.lines is not None else f"{kind} {index}: {message}"
