"""Contacts, and the points of a file."""

from collections.abc import Hashable
from typing import Any

import numpy as np

from nilbs.viewer.colours import DEPTH
from nilbs.viewer.meeting import Meetings, Places, inside
from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.state import Shot

IN, OUT = (213, 94, 0), (0, 114, 178)


class Contacts:
    """Places where bodies meet each other or themselves, in the colours of their depth."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        gui, several = stage.server.gui, len(stage.scene.bodies) > 1
        self.pairs = gui.add_checkbox("contacts of bodies", False, visible=several)
        self.themselves = gui.add_checkbox("contacts of a body with itself", False)
        self.note = stage.note()
        stage.watch(self.pairs, self.themselves)
        self.meetings = Meetings(stage.scene.bodies)
        self._drawn: Any = None

    def key(self, shot: Shot) -> Hashable:
        """Poses, while they are visible."""
        shown = self.pairs.value, self.themselves.value
        return any(shown) and (shot.moved, *shown)

    def draw(self, shot: Shot) -> None:
        """Find and show them."""
        if self.pairs.value or self.themselves.value:
            self.note.wait()
        found: dict[str, Places] = {}
        if self.pairs.value:
            found |= self.meetings.pairs(shot.poses)
        if self.themselves.value:
            found |= self.meetings.themselves(shot.poses)
        self._remove()
        lines = []
        for name, places in found.items():
            deepest = f", at most {100 * places.depth.max():.2f} % of L deep" if len(places.depth) else ""
            lines.append(f"{name}: {len(places.depth)} places{deepest}")
        self.note.show(*lines, bar=DEPTH.bar() if lines else "")
        point = [places.point for places in found.values() if len(places.point)]
        if point:
            depth = np.concatenate([places.depth for places in found.values()])
            here = self.stage.scene.frame.place(np.concatenate(point))
            self._drawn = self.stage.server.scene.add_point_cloud(
                "/contacts", here, DEPTH(100 * depth), point_size=0.008, point_shape="circle"
            )

    def _remove(self) -> None:
        if self._drawn is not None:
            self._drawn.remove()
        self._drawn = None

    def fail(self, error: Exception) -> None:
        """Show why there are none."""
        self._remove()
        self.note.show(str(error))


class Points:
    """The points of a file, orange inside a body and blue outside."""

    def __init__(self, stage: Stage, x: np.ndarray) -> None:
        self.stage, self.x = stage, x
        gui = stage.server.gui
        self.visible = gui.add_checkbox("points of the file", True)
        self.row = stage.row_dropdown()
        self.size = gui.add_slider("size", 0.001, 0.05, 0.001, 0.008, hint="of a point, in L")
        self.note = stage.note()
        stage.watch(self.visible, self.row, self.size)
        self.cloud = stage.server.scene.add_point_cloud(
            "/points", stage.scene.frame.place(x), OUT, point_shape="circle", precision="float32"
        )

    def key(self, shot: Shot) -> Hashable:
        """Poses and settings, while they are visible."""
        return self.visible.value and (shot.moved, self.row.value, self.size.value)

    def draw(self, shot: Shot) -> None:
        """Colour them."""
        self.cloud.visible = self.visible.value
        if not self.visible.value:
            return
        within = inside(self.stage.scene.bodies, shot.poses, self.x, self.row.value)
        self.cloud.colors = np.where(within[:, None], IN, OUT).astype(np.uint8)
        self.cloud.point_size = self.size.value
        self.note.show(f"{int(within.sum())} of {len(within)} points are inside")

    def fail(self, error: Exception) -> None:
        """Show why they have no colours."""
        self.note.show(str(error))
