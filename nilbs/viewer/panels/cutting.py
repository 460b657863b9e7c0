"""The plane that cuts the world."""

from collections.abc import Hashable
from typing import Any

import numpy as np
from viser import transforms

from nilbs.figures.views import Section
from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.section import QUANTITIES, Cut, cut, plane
from nilbs.viewer.state import Shot

AXES = ("x", "y", "z")


class Cutting:
    """Occupancy, distance or the ghost bone's weight of the selected body in a plane, as a picture there."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        gui, d = stage.server.gui, stage.scene.d
        self.visible = gui.add_checkbox("cutting plane", False)
        ghost = any(body.has_ghost for body in stage.scene.bodies)
        self.quantity = gui.add_dropdown("quantity", [name for name in QUANTITIES if ghost or name != "ghost bone"])
        self.row = stage.row_dropdown()
        across = int(np.abs(stage.view.axes[2]).argmax())
        self.axis = gui.add_dropdown("across", AXES, initial_value=AXES[across], visible=d == 3)
        self.height = gui.add_slider("height", -1.0, 1.0, 0.005, 0.0, hint="along this axis, in L", visible=d == 3)
        self.edge = gui.add_slider("edge", 0.2, 3.0, 0.1, 1.4, hint="of the square, in L")
        self.pixels = gui.add_slider("pixels", 32, 512, 32, 192, hint="along its edge")
        self.note = stage.note()
        stage.watch(self.visible, self.quantity, self.row, self.axis, self.height, self.edge, self.pixels)
        self.cut: Cut | None = None
        self.image: Any = None

    def section(self) -> Section | None:
        """The plane, while it is visible."""
        if not self.visible.value:
            return None
        axis = AXES.index(self.axis.value)
        frame, pixels = self.stage.scene.frame, int(self.pixels.value)
        return plane(frame, axis, self.height.value, edge=self.edge.value, pixels=pixels)

    def key(self, shot: Shot) -> Hashable:
        """The pose and the settings, while it is visible."""
        settings = (self.quantity, self.row, self.axis, self.height, self.edge, self.pixels)
        return self.visible.value and (shot.moved, self.stage.body, *(one.value for one in settings))

    def draw(self, shot: Shot) -> None:
        """Evaluate and show the field in the plane."""
        section = self.section()
        if section is None:
            self._remove()
            self.note.show()
            return
        self.note.wait()
        quantity, chosen = self.quantity.value, self.stage.body
        body = self.stage.scene.bodies[chosen]
        self.cut = cut(body.posed(shot.poses[chosen], self.row.value), section, quantity)
        scale = QUANTITIES[quantity]
        picture = self.cut.picture(scale)
        place = self.stage.scene.frame.place
        # viser's pictures have their x to the right and their y down.
        axes = np.eye(3) if len(section.centre) == 2 else section.view.axes
        R = np.stack([axes[0], -axes[1], -axes[2]], axis=1)
        position = place(section.centre) - (0.002 * axes[2] if len(section.centre) == 2 else 0.0)
        edge = section.edge / self.stage.scene.frame.L
        # Under a new name: the page may lose a picture that replaces another of its name.
        before, self.image = (
            self.image,
            self.stage.server.scene.add_image(
                f"/plane/{shot.version}",
                picture,
                edge,
                edge,
                format="png",
                wxyz=transforms.SO3.from_matrix(R).wxyz,
                position=position,
                cast_shadow=False,
                receive_shadow=False,
            ),
        )
        if before is not None:
            before.remove()
        low, high = np.nanmin(self.cut.values), np.nanmax(self.cut.values)
        self.note.show(f"{quantity} of {body.name}: from {low:.3g} to {high:.3g}", bar=scale.bar())

    def _remove(self) -> None:
        if self.image is not None:
            self.image.remove()
        self.image = self.cut = None

    def fail(self, error: Exception) -> None:
        """Show why there is no picture."""
        self._remove()
        self.note.show(str(error))
