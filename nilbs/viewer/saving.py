"""What the page hands out, as the bytes of files."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from nilbs.figures.animation import pictures, write_film
from nilbs.figures.views import View
from nilbs.geometry.kinematics import local_rotations
from nilbs.geometry.surface import Surface
from nilbs.io import write_mesh, write_motion_json
from nilbs.viewer.state import Body

TURNS = 36  # pictures of a turntable


def mesh_file(U: np.ndarray, F: np.ndarray, suffix: str) -> bytes:
    """A surface as a file: .glb of triangles, or what `nilbs.io.write_mesh` writes."""
    if suffix == ".glb":
        if F.shape[1] != 3:
            raise ValueError("a .glb holds triangles, and this is an outline: save it as .obj")
        return bytes(Surface(U, F).to_trimesh().export(file_type="glb"))  # type: ignore[arg-type]
    return _written(suffix, lambda path: write_mesh(path, U, F))


def pose_file(body: Body, pose: np.ndarray) -> bytes:
    """A pose as the JSON that `--motion` takes.

    Raises
    ------
    ValueError
        If a bone is scaled or comes apart, so that the pose has no local rotations.
    """
    skeleton = body.character.skeleton
    theta, root_translation = local_rotations(skeleton.C, skeleton.BE, skeleton.P, pose)
    return _written(".json", lambda path: write_motion_json(path, skeleton.names, theta[None], root_translation[None]))


def turntable(U: np.ndarray, F: np.ndarray, view: View, *, pixels: int = 320, turns: int = TURNS) -> bytes:
    """A surface that turns once, as a GIF; an outline stands still."""
    if not len(U):
        raise ValueError("the surface is empty: there is nothing to turn")
    middle = (U.min(axis=0) + U.max(axis=0)) / 2
    radius = np.linalg.norm(U - middle, axis=1).max()

    def frames() -> Iterator[np.ndarray]:
        for k in range(turns if len(middle) == 3 else 1):
            around = view.turned(azimuth=360.0 * k / turns, elevation=18.0)
            # Ends of a ball around it, so that the window is the same from all sides.
            ends = middle + radius * np.concatenate([around.axes, -around.axes])
            yield from pictures([(U, F)], [ends], around, pixels=pixels)

    return _written(".gif", lambda path: write_film(frames(), path, fps=12))


def _written(suffix: str, write: Callable[[Path], object]) -> bytes:
    """The bytes that a function writes to a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        write(path)
        return path.read_bytes()
