"""The reconstructed surface over the skin."""

from collections.abc import Hashable
from time import perf_counter
from typing import Any

import numpy as np

from nilbs.viewer.colours import ERROR, Scale, rounded_up
from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.reconstruction import Reconstruction, reconstruction
from nilbs.viewer.state import Shot


class ReconstructedSurface:
    """The surface of each body's field, in the colours of its distance to the skin; it follows at its own pace."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        gui = stage.server.gui
        self.visible = gui.add_checkbox("surface of the field", False)
        self.row = stage.row_dropdown()
        self.resolution = gui.add_slider("resolution", 16, 256, 8, 64, hint="cells along the longest edge")
        self.note = stage.note()
        stage.watch(self.visible, self.row, self.resolution)
        self.found: list[Reconstruction] = []
        self._drawn: list[Any] = []

    def key(self, shot: Shot) -> Hashable:
        """Poses and settings, while it is visible."""
        return self.visible.value and (shot.moved, self.row.value, self.resolution.value)

    def draw(self, shot: Shot) -> None:
        """Extract and show it."""
        if not self.visible.value:
            self._remove()
            self.note.show()
            return
        self.note.wait()
        start = perf_counter()
        bodies = self.stage.scene.bodies
        found = [
            reconstruction(body.posed(pose, body.row_like(self.row.value)), self.resolution.value)
            for body, pose in zip(bodies, shot.poses, strict=True)
        ]
        seconds = perf_counter() - start
        error = np.concatenate([one.error for one in found])
        scale = ERROR._replace(high=rounded_up(100 * float(np.percentile(error, 99)))) if len(error) else ERROR
        with self.stage.server.atomic():
            self._remove()
            self._drawn = [self._show(f"/surface/{i}", one, scale) for i, one in enumerate(found) if len(one.F)]
        self.found = found
        lines = ["empty: no cell of the grid is inside"]
        if len(error):
            lines = [
                f"{sum(len(one.F) for one in found)} facets in {seconds:.2f} s",
                f"distance to the skin: {100 * error.mean():.3f} % of L, at most {100 * error.max():.2f} %",
            ]
        self.note.show(*lines, bar=scale.bar())

    def _show(self, name: str, one: Reconstruction, scale: Scale) -> Any:
        colours = scale(100 * one.error)
        if one.F.shape[1] == 3:
            return self.stage.coloured(name, one.U, one.F, colours)
        ends = self.stage.scene.frame.place(one.U[one.F])
        return self.stage.server.scene.add_line_segments(
            name, ends, colors=colours[one.F], thickness=4.0, thickness_units="screen"
        )

    def _remove(self) -> None:
        for handle in self._drawn:
            handle.remove()
        self._drawn, self.found = [], []

    def fail(self, error: Exception) -> None:
        """Show why there is none."""
        self._remove()
        self.note.show(str(error))
