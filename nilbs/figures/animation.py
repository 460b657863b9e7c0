"""A moving body as pictures, one a frame, and as a film."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nilbs.figures.canvas import plain
from nilbs.figures.surfaces import draw_body
from nilbs.figures.views import View
from nilbs.io.atomic import replacing

DPI = 100


def pictures(
    surfaces: Iterable[tuple[np.ndarray, np.ndarray]], bounds: Sequence[np.ndarray], view: View, *, pixels: int
) -> Iterator[np.ndarray]:
    """One square picture (pixels, pixels, 3) of each posed surface (U, F), all with the window around `bounds`."""
    lower, upper = view.window(*bounds)
    for U, F in surfaces:
        figure = Figure(figsize=(pixels / DPI, pixels / DPI), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        panel = figure.add_axes((0, 0, 1, 1))
        draw_body(panel, view, U, F)
        plain(panel, lower=lower, upper=upper)
        panel.axis("off")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def write_film(frames: Iterable[np.ndarray], path: str | Path, *, fps: float) -> None:
    """Write pictures (h, w, 3) as a film, .gif or .mp4; what was there before is kept until it is whole.

    Raises
    ------
    ModuleNotFoundError
        For .mp4 without the package imageio-ffmpeg.
    """
    if Path(path).suffix.lower() == ".mp4":
        _write_mp4(frames, Path(path), fps)
        return
    from PIL import Image

    images = [Image.fromarray(frame).quantize(64) for frame in frames]
    with replacing(path, "wb") as file:
        images[0].save(
            file,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            duration=round(1000 / fps),
            loop=0,
            optimize=False,
        )


def _write_mp4(frames: Iterable[np.ndarray], path: Path, fps: float) -> None:
    import tempfile

    import imageio_ffmpeg

    with tempfile.TemporaryDirectory() as folder:
        film, writer = Path(folder) / "film.mp4", None
        for frame in frames:
            if writer is None:
                writer = imageio_ffmpeg.write_frames(str(film), frame.shape[1::-1], fps=fps, macro_block_size=2)
                writer.send(None)
            writer.send(np.ascontiguousarray(frame))
        if writer is not None:
            writer.close()
        with replacing(path, "wb") as file:
            file.write(film.read_bytes())
