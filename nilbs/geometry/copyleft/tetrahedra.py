"""Tetrahedra that fill a closed surface and hold the bones, by TetGen (AGPL, inside libigl's copyleft module)."""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.geometry.volume import element_volumes

PROGRAM = Path(__file__).with_name("tetgen_process.py")


def conforming_tetrahedra(
    V: np.ndarray, F: np.ndarray, points: np.ndarray, *, spacing: float = 0.03, quality: float = 2**0.5
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a closed surface with tetrahedra that have vertices at given points (s, 3) inside.

    Returns V_volume, the surface's vertices in their order, then the points and further ones, and positively oriented
    T. `spacing` is the edge of the largest regular tetrahedron, as a fraction of the bounding box's diagonal, `quality`
    the largest ratio of circumradius to shortest edge. A surface that is open or crosses itself is a ValueError.

    Notes
    -----
    TetGen [1]_ with flags pqaY: quality tetrahedra of bounded volume, the surface's triangles kept as they are.

    References
    ----------
    .. [1] Si, TetGen, a Delaunay-based quality tetrahedral mesh generator, 2015, doi:10.1145/2629697.
    """
    V, F, points = arrays(V=(V, "n 3"), F=(F, "m 3", "V"), points=(points, "s 3"))
    # TetGen's tolerances are absolute, so it gets a copy of size one around the origin; rounded, so that the same mesh
    # in another unit gives the same elements.
    size = float(np.linalg.norm(np.ptp(V, axis=0))) if len(V) else 0.0
    if not size > 0 or not len(F):
        raise ValueError("the surface has no extent, so there is nothing to fill with tetrahedra")
    center = (V.min(axis=0) + V.max(axis=0)) / 2
    given = np.round((np.concatenate([V, points]) - center) / size, 9)
    V_volume, T = _tetgen(given, F, f"pq{quality:.4g}a{spacing**3 / 72**0.5:.6g}YQ")
    if not len(T):
        raise ValueError("TetGen found no volume inside the surface")
    V_volume = V_volume * size + center
    V_volume[: len(V)] = V
    T = np.where((element_volumes(V_volume, T) < 0)[:, None], T[:, [0, 2, 1, 3]], T)
    return V_volume, T


def _tetgen(V: np.ndarray, F: np.ndarray, flags: str) -> tuple[np.ndarray, np.ndarray]:
    """Run TetGen in a child process: where it gives up it leaves files and prints, and it may crash."""
    with TemporaryDirectory() as folder:
        np.savez(Path(folder, "surface.npz"), V=V, F=F, flags=flags)
        done = subprocess.run(
            [sys.executable, "-P", "-S", str(PROGRAM)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        if done.returncode == 1:  # an error of Python, such as a full disk or a library that is missing
            raise ChildProcessError(f"TetGen could not be run: {done.stderr.decode(errors='replace').strip()[-300:]}")
        problem = f"it crashed with code {done.returncode}"
        if done.returncode == 0:
            with np.load(Path(folder, "volume.npz")) as volume:
                if "T" in volume:
                    return volume["V"], volume["T"].astype(np.int64)
                problem = str(volume["error"])
    raise ValueError(
        f"TetGen could not fill the surface with tetrahedra ({problem}): it must be closed and must not cross itself"
    )
