"""Training data: labelled points of posed characters, and rest points with their weights."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from nilbs.geometry.facets import facet_normals
from nilbs.geometry.grids import Grid
from nilbs.geometry.interpolation import facet_values
from nilbs.geometry.sampling import element_samples, facet_samples, near_surface_samples, uniform_samples
from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.geometry.winding import occupancy


@dataclass(frozen=True)
class OccupancySamples:
    """Points x (t, m, d) around the posed mesh of each frame, and whether each is inside (t, m).

    Inside means an absolute winding number of the posed mesh above one half.
    """

    x: np.ndarray
    inside: np.ndarray


@dataclass(frozen=True)
class RestSamples:
    """Rest points x_rest (m, d) and their skinning weights W (m, b)."""

    x_rest: np.ndarray
    W: np.ndarray


def occupancy_samples(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray,
    B: Iterable[np.ndarray],
    *,
    n: int,
    noise: float | None,
    rng: np.random.Generator,
) -> OccupancySamples:
    """Label n points of every posed frame of B.

    Half of the points are surface samples moved by normal noise of this standard deviation, in mesh units, a quarter by
    eight times it, and a quarter are uniform in the cube around the posed mesh. Without noise all are uniform there, as
    in the paper.
    """
    points, inside = [], []
    for pose in B:
        U = linear_blend_skinning(V, W, pose)
        cube = Grid.cube(U, 1)
        x = uniform_samples(cube.lower, cube.upper, n if noise is None else n // 4, rng=rng)
        if noise is not None:
            around = near_surface_samples(U, F, n // 4, std=8 * noise, rng=rng)
            near = near_surface_samples(U, F, n - 2 * (n // 4), std=noise, rng=rng)
            x = np.concatenate([x, around, near])
        points.append(x)
        inside.append(occupancy(U, F, x))
    return OccupancySamples(np.stack(points), np.stack(inside))


def surface_samples(V: np.ndarray, W: np.ndarray) -> RestSamples:
    """Vertices of the rest surface with their weights: the paper's own supervision."""
    return RestSamples(V.astype(np.float32), W.astype(np.float32))


def volume_samples(
    V: np.ndarray,
    F: np.ndarray,
    W: np.ndarray,
    V_volume: np.ndarray,
    T: np.ndarray,
    W_volume: np.ndarray,
    *,
    n: int,
    shell: float,
    rng: np.random.Generator,
) -> RestSamples:
    """N rest points with their weights, half in the volume and half in a thin shell around the surface.

    Points of the shell lie on normals of the surface, at normal distances of standard deviation `shell` in mesh units;
    they have the weights of the surface point that they left.
    """
    solid = n // 2
    base, facet = facet_samples(V, F, n - solid, rng=rng)
    W_shell = facet_values(V, F, W, base, facet)
    shell_points = base + shell * rng.standard_normal((n - solid, 1)) * facet_normals(V, F)[facet]
    x, element, barycentric = element_samples(V_volume, T, solid, rng=rng)
    W_solid = np.einsum("nc,ncb->nb", barycentric, W_volume[T[element]])
    return RestSamples(
        np.concatenate([x, shell_points]).astype(np.float32), np.concatenate([W_solid, W_shell]).astype(np.float32)
    )
