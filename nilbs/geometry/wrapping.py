"""A closed surface around any triangles: the boundary of a volume if the mesh itself is none."""

import numpy as np

from nilbs.geometry.distance import closest_points
from nilbs.geometry.extraction import node_levels
from nilbs.geometry.facets import facet_areas
from nilbs.geometry.grids import Grid
from nilbs.geometry.level_sets import isosurface
from nilbs.geometry.sampling import facet_samples
from nilbs.geometry.validation import arrays
from nilbs.geometry.winding import occupancy

# Half the thickness, in cells, that parts without volume are given: above sqrt(3)/2 any sheet holds together.
THICKNESS = 0.9
# Standard deviation, in cells, of a blur. Without it the surface has stairs where the winding number passes one half
# away from all facets, and decimation folds there. A sheet of the thickness above survives it.
BLUR = 0.7


def wrap(V: np.ndarray, F: np.ndarray, *, resolution: int = 192) -> tuple[Grid, np.ndarray]:
    """Grid and levels, negative inside, of a solid that holds a surface, whatever its defects.

    The facets, at least one, may have holes, crossings, loose sheets, and be doubled or flipped. `resolution` is the
    count of cells along the longest edge of the bounding box. Near the surface levels are distances.

    Notes
    -----
    A place belongs to the solid where the absolute generalized winding number is above one half [1]_. Where the grid
    sees no such place near a facet (sheets, hair, plates thinner than a cell) it is given a thickness, as small as
    holds it together on this grid; solid parts are not thickened, so that what is close stays apart.

    References
    ----------
    .. [1] Jacobson, Kavan, Sorkine-Hornung, Robust Inside-Outside Segmentation using Generalized Winding Numbers,
       2013, doi:10.1145/2461912.2461916.

    Examples
    --------
    >>> sheet = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> grid, levels = wrap(sheet, [[0, 1, 2], [0, 2, 3]], resolution=20)
    >>> bool((levels < 0).any())
    True
    """
    from scipy.ndimage import gaussian_filter

    V, F = arrays(V=(V, "n d"), F=(F, "m d", "V"))
    if not len(F):
        raise ValueError("F is empty: there is nothing to wrap")
    grid = Grid.box(V[np.unique(F)], resolution, pad=3.0 / resolution)

    def solid(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, _, _ = closest_points(V, F, x)
        return np.where(occupancy(V, F, x), -distance, distance), distance

    levels, _ = node_levels(solid, grid, stride=4)
    # What the blur would remove is thin too.
    bare = _nodes_without_volume(V, F, grid, gaussian_filter(levels, BLUR) < 0)
    if bare.any():
        distance, _, _ = closest_points(V, F, grid.origin + grid.spacing * np.argwhere(bare))
        levels[bare] = np.minimum(levels[bare], distance - THICKNESS * grid.spacing)
    return grid, gaussian_filter(levels, BLUR)


def wrapping_surface(V: np.ndarray, F: np.ndarray, *, resolution: int = 192) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface around any facets, whatever their defects; see `wrap`.

    Parameters
    ----------
    V, F : (n, d) float array and (m, d) int array
        Vertices, in mesh units, and facets, at least one; d is 2 or 3.
    resolution : int
        Cells along the longest edge of the bounding box.

    Returns
    -------
    V_wrap, F_wrap : (n', d) float array and (m', d) int array
        Vertices, in mesh units, and facets, closed and oriented outward.

    Raises
    ------
    ValueError
        If the sizes disagree, F is empty or all points coincide.

    Examples
    --------
    >>> from nilbs.geometry.facets import is_watertight
    >>> sheet = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> is_watertight(wrapping_surface(sheet, [[0, 1, 2], [0, 2, 3]], resolution=20)[1])
    True
    """
    grid, levels = wrap(V, F, resolution=resolution)
    return isosurface(levels, grid)


def _nodes_without_volume(V: np.ndarray, F: np.ndarray, grid: Grid, inside: np.ndarray) -> np.ndarray:
    """Nodes within two cells of those places of the surface that have no node inside within about a cell."""
    from scipy.ndimage import maximum_filter

    rng = np.random.default_rng(0)
    area = facet_areas(V, F).sum() / grid.spacing ** (V.shape[1] - 1)
    # Some four places a cell of surface, and every facet's centre, however small it is.
    x = facet_samples(V, F, min(int(4 * area), 2_000_000), rng=rng)[0] if area > 0 else V[:0]
    node = np.round((np.concatenate([V[F].mean(axis=1), x]) - grid.origin) / grid.spacing).astype(np.int64)
    bare = np.zeros(grid.shape, dtype=bool)
    bare[tuple(node.T)] = True
    bare &= ~maximum_filter(inside, size=3)
    return maximum_filter(bare, size=5)
