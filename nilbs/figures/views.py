"""Projections onto paper: orthographic views, and planar sections."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """An orthographic view: the plane itself in 2D, a direction in 3D.

    Parameters
    ----------
    axes : (d, d) float array
        Orthonormal rows: right on paper, up on paper and, in 3D, towards the viewer.
    """

    axes: np.ndarray

    @classmethod
    def front(cls, V: np.ndarray) -> "View":
        """The view along the thinnest extent of rest vertices V, with y (else z) up.

        Examples
        --------
        >>> View.front([[0, 0, 0], [1, 2, 3]]).axes.tolist()
        [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
        """
        V = np.asarray(V, dtype=float)
        d = V.shape[1]
        if d == 2:
            return cls(np.eye(2))
        toward = np.eye(3)[int(np.argmin(np.ptp(V, axis=0)))]
        up = np.eye(3)[1 if toward[1] == 0 else 2]
        return cls(np.array([np.cross(up, toward), up, toward]) + 0.0)

    def turned(self, *, azimuth: float = 30.0, elevation: float = 18.0) -> "View":
        """The same view from further right and above, in degrees; in 2D the view itself."""
        if len(self.axes) == 2:
            return self
        right, up, toward = self.axes
        a, e = np.radians([azimuth, elevation])
        aside = np.cos(a) * right - np.sin(a) * toward
        level = np.sin(a) * right + np.cos(a) * toward
        return View(np.array([aside, np.cos(e) * up - np.sin(e) * level, np.sin(e) * up + np.cos(e) * level]))

    def project(self, x: np.ndarray) -> np.ndarray:
        """Points (..., d) on paper, (..., 2), in mesh units."""
        return x @ self.axes[:2].T

    def window(self, *clouds: np.ndarray, margin: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
        """Corners (2,), (2,) of the square on paper around all clouds of points, with a margin."""
        flat = np.concatenate([self.project(cloud) for cloud in clouds])
        lower, upper = flat.min(axis=0), flat.max(axis=0)
        half = (0.5 + margin) * max(float((upper - lower).max()), 1e-12)
        middle = (lower + upper) / 2
        return middle - half, middle + half


@dataclass(frozen=True)
class Section:
    """A square of pixels in a plane parallel to the paper of a view; in 2D, in the plane itself.

    Its `centre` (d,) and its `edge` are in mesh units, with `pixels` along the edge.
    """

    view: View
    centre: np.ndarray
    edge: float
    pixels: int = 320

    @classmethod
    def through(cls, view: View, U: np.ndarray, *, scale: float = 1.2, pixels: int = 320) -> "Section":
        """The section through posed vertices U, `scale` times as large as they are, at their mean depth."""
        middle = (U.min(axis=0) + U.max(axis=0)) / 2
        edge = scale * float(np.ptp(view.project(U), axis=0).max())
        if len(view.axes) == 3:
            middle = middle + ((U.mean(axis=0) - middle) @ view.axes[2]) * view.axes[2]
        return cls(view, middle, edge, pixels)

    def points(self) -> np.ndarray:
        """Middles of the pixels, (pixels * pixels, d), row by row from the bottom."""
        s = ((np.arange(self.pixels) + 0.5) / self.pixels - 0.5) * self.edge
        right, up = np.meshgrid(s, s)
        return self.centre + np.column_stack([right.ravel(), up.ravel()]) @ self.view.axes[:2]

    def image(self, values: np.ndarray) -> np.ndarray:
        """Values at `points` as an image, bottom row first."""
        return values.reshape(self.pixels, self.pixels, *values.shape[1:])

    @property
    def lower(self) -> np.ndarray:
        """Lower left corner (2,) on paper."""
        return self.view.project(self.centre) - self.edge / 2

    @property
    def upper(self) -> np.ndarray:
        """Upper right corner (2,) on paper."""
        return self.view.project(self.centre) + self.edge / 2

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top on paper, as matplotlib's imshow takes them."""
        return float(self.lower[0]), float(self.upper[0]), float(self.lower[1]), float(self.upper[1])

    def cut(self, U: np.ndarray, F: np.ndarray) -> np.ndarray:
        """The plane's intersection with a surface: ends (s, 2, 2) of segments on paper; in 2D, the facets themselves.

        Examples
        --------
        >>> section = Section(View(np.eye(3)), np.array([0, 0, 0.5]), 2.0)
        >>> section.cut(np.array([[0, 0, 0], [0, 1, 0], [1, 0, 1.0]]), np.array([[0, 1, 2]])).tolist()
        [[[0.5, 0.0], [0.5, 0.5]]]
        """
        if U.shape[1] == 2:
            return U[F]
        height = (U - self.centre) @ self.view.axes[2]
        height = np.where(height == 0, 1e-12 * self.edge, height)  # a vertex in the plane counts as in front
        above = height[F] > 0
        F, above = F[above.any(axis=1) & ~above.all(axis=1)], above[above.any(axis=1) & ~above.all(axis=1)]
        # Rotate each triangle until the single corner on one side is first.
        alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
        corner = np.take_along_axis(F, (alone[:, None] + np.arange(3)) % 3, axis=1)
        ends = []
        for k in (1, 2):
            a, b = height[corner[:, 0]], height[corner[:, k]]
            s = (a / (a - b))[:, None]
            ends.append(self.view.project(U[corner[:, 0]] * (1 - s) + U[corner[:, k]] * s))
        return np.stack(ends, axis=1)
