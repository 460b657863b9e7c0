"""Shaded pictures of surfaces: a depth buffer, a light, and occlusion measured by the surface's own distance."""

import numpy as np
from matplotlib.colors import to_rgb

from nilbs.figures.views import View
from nilbs.geometry.distance import closest_points

SUPERSAMPLING = 3
LIGHT = np.array([-0.45, 0.6, 0.75])  # right, up, towards the viewer
HALFWAY = LIGHT / np.linalg.norm(LIGHT) + (0, 0, 1)  # between light and viewer, for the highlight
AMBIENT, HIGHLIGHT, SHININESS = 0.58, 0.16, 24.0
REACHES = (0.012, 0.03, 0.06, 0.12)  # of the window's edge: how far occlusion is measured


def render(
    U: np.ndarray,
    F: np.ndarray,
    colours: np.ndarray | str,
    *,
    view: View,
    window: tuple[np.ndarray, np.ndarray],
    pixels: int,
) -> np.ndarray:
    """Draw a surface on a transparent square.

    Parameters
    ----------
    U, F : arrays
        Vertices (n, 3) and triangles.
    colours : (n, 3) float array, or str
        Colours of the vertices, or one for all.
    view : View
    window : (2,) float array, (2,) float array
        Lower left and upper right corner of the square, in the view's plane.
    pixels : int
        Edge of the picture.

    Returns
    -------
    image : (pixels, pixels, 4) float array
        Red, green, blue and opacity; the first row is the top.
    """
    if isinstance(colours, str):
        colours = np.broadcast_to(to_rgb(colours), U.shape)
    size = pixels * SUPERSAMPLING
    lower, edge = window[0], float((window[1] - window[0])[0])
    corners = U @ view.axes.T
    corners[:, :2] = (corners[:, :2] - lower) * size / edge
    pixel, facet, share = _visible(corners, F, size)

    def at_pixels(values: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nkc->nc", share, values[F[facet]])

    normal = _unit(at_pixels(_vertex_normals(U, F)))
    light = _lambert(normal @ view.axes.T) * _openness(U, F, at_pixels(U), normal, edge)
    colour = at_pixels(colours) * light[:, None] + _highlight(normal @ view.axes.T)[:, None]
    image = np.zeros((size * size, 4))
    image[pixel, :3], image[pixel, 3] = np.clip(colour, 0, 1), 1
    image[:, :3] *= image[:, 3:]  # means of colours count by opacity
    blocks = image.reshape(pixels, SUPERSAMPLING, pixels, SUPERSAMPLING, 4).mean(axis=(1, 3))[::-1]
    blocks[..., :3] /= np.maximum(blocks[..., 3:], 1e-6)
    return np.clip(blocks, 0, 1)


def _visible(corners: np.ndarray, F: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels that the surface covers, the nearest facet at each, and its barycentric coordinates there."""
    triangles = corners[F]
    longest = np.linalg.norm(np.roll(triangles[..., :2], 1, axis=1) - triangles[..., :2], axis=2).max(axis=1)
    steps = np.ceil(longest * 1.6).astype(int) + 1
    found = []
    for n in np.unique(steps):  # points of every facet less than a pixel apart
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        kept = i + j <= n
        share = np.column_stack([i[kept], j[kept], n - i[kept] - j[kept]]) / n
        facet = np.flatnonzero(steps == n)
        points = np.einsum("sk,fkc->fsc", share, triangles[facet]).reshape(-1, 3)
        column, row = np.floor(points[:, :2]).astype(int).T
        seen = (column >= 0) & (column < size) & (row >= 0) & (row < size)
        number = np.arange(len(points))[seen]
        pixel = row[seen] * size + column[seen]
        order = np.lexsort((points[seen, 2], pixel))
        last = order[np.append(pixel[order][1:] != pixel[order][:-1], True)] if len(order) else order
        found.append(
            (pixel[last], points[seen][last, 2], facet[number[last] // len(share)], share[number[last] % len(share)])
        )
    pixel, depth, facet, share = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((depth, pixel))
    last = order[np.append(pixel[order][1:] != pixel[order][:-1], True)]
    return pixel[last], facet[last], share[last]


def _vertex_normals(U: np.ndarray, F: np.ndarray) -> np.ndarray:
    corners = U[F]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(U)
    for k in range(3):
        np.add.at(normals, F[:, k], across)
    return _unit(normals)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-300)


def _lambert(normal: np.ndarray) -> np.ndarray:
    """Light from one side, and a little from all around."""
    return AMBIENT + (1 - AMBIENT) * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0, None)


def _highlight(normal: np.ndarray) -> np.ndarray:
    return HIGHLIGHT * np.clip(normal @ (HALFWAY / np.linalg.norm(HALFWAY)), 0, None) ** SHININESS


def _openness(U: np.ndarray, F: np.ndarray, x: np.ndarray, normal: np.ndarray, edge: float) -> np.ndarray:
    """Ambient occlusion: how far the surface keeps away from points above it, as a factor of the light."""
    closed = np.zeros(len(x))
    for k, reach in enumerate(REACHES):
        distance = np.abs(closest_points(U, F, x + reach * edge * normal)[0])
        closed += 0.5**k * np.clip(1 - distance / (reach * edge), 0, 1)
    return 1 - 0.55 * np.clip(closed, 0, 1)
