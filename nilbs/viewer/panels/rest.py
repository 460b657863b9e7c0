"""The rest pose beside the posed one, and a clicked point in both."""

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.viewer.panels.cutting import Cutting
from nilbs.viewer.panels.panel import BODIES, Stage
from nilbs.viewer.picking import first_on_section, first_on_skin, roots
from nilbs.viewer.state import Shot

POINT, ROOT = (213, 94, 0), (0, 114, 178)


class Rest:
    """The selected body at rest, beside the scene, and the roots of a point that is clicked on skin or plane."""

    def __init__(self, stage: Stage, cutting: Cutting) -> None:
        self.stage, self.cutting = stage, cutting
        gui = stage.server.gui
        self.visible = gui.add_checkbox("rest pose beside", False)
        self.picking = gui.add_checkbox("click on a point", False, hint="of the skin or of the cutting plane")
        self.row = stage.row_dropdown()
        self.note = stage.note()
        stage.watch(self.visible, self.row)
        stage.watch(self.picking, then=self._listen)
        self.x: np.ndarray | None = None  # the point, which stays where it is while the body moves
        self._drawn: list[Any] = []

    @property
    def aside(self) -> np.ndarray:
        """Where on the page the rest pose stands: to the left of the scene, for who has just opened it."""
        left = -self.stage.look.axes[0]
        body, frame = self.stage.scene.bodies[0], self.stage.scene.frame
        return left * (0.35 + float(np.ptp(frame.place(body.character.V) @ left)))

    def _listen(self) -> None:
        view = self.stage.server.scene
        view.remove_click_callback()
        if not self.picking.value:
            self.x = None
            return

        @view.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self.pick(np.array(event.ray_origin), np.array(event.ray_direction))

    def pick(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """Take the point that a ray of the page meets first."""
        scene = self.stage.scene
        shot = scene.shot()
        first = np.inf
        section = self.cutting.section()
        if section is not None:
            on_page = replace(section, centre=scene.frame.place(section.centre), edge=section.edge / scene.frame.L)
            first = first_on_section(on_page, origin, direction)
        for body, pose in zip(scene.bodies, shot.poses, strict=True):
            U = scene.frame.place(linear_blend_skinning(body.V, body.W, pose)).astype(np.float64)
            first = min(first, first_on_skin(U, body.F, origin, direction))
        if np.isfinite(first):
            with scene.changing():
                self.x = scene.frame.back(origin + first * direction)

    def key(self, shot: Shot) -> Hashable:
        """The pose and the point, while they are visible."""
        x = self.x
        point = x is not None and (shot.moved, x.tobytes(), self.row.value)
        return self.visible.value, self.picking.value, self.stage.body, point

    def draw(self, shot: Shot) -> None:
        """Show the body at rest, and the roots there."""
        self._remove()
        frame, view = self.stage.scene.frame, self.stage.server.scene
        x, chosen = self.x, self.stage.body
        body = self.stage.scene.bodies[chosen]
        if self.visible.value:
            colour = BODIES[chosen % len(BODIES)]
            V = frame.place(body.V)
            opacity = None if self.stage.scene.d == 2 else 0.5
            self._drawn.append(
                view.add_mesh_simple(
                    "/rest/skin", V, body.F, color=colour, side="double", opacity=opacity, position=self.aside
                )
            )
        if x is None:
            self.note.show(*(["click on the skin or on the cutting plane"] if self.picking.value else []))
            return
        self.note.wait()
        found = roots(body.posed(shot.poses[chosen], self.row.value), x)
        here = frame.place(found.x[None])
        self._drawn.append(view.add_point_cloud("/picked/posed", here, POINT, point_size=0.02, point_shape="circle"))
        if self.visible.value and len(found.x_rest):
            there = frame.place(found.x_rest) + self.aside.astype(np.float32)
            colours = np.tile(np.array(ROOT, dtype=np.uint8), (len(there), 1))
            ends = np.stack([np.broadcast_to(here, there.shape), there], axis=1)
            self._drawn += [
                view.add_point_cloud("/picked/rest", there, colours, point_size=0.02, point_shape="circle"),
                view.add_line_segments("/picked/lines", ends, colors=ROOT, thickness=1.5, thickness_units="screen"),
            ]
        count = len(found.x_rest)
        lines = [f"posed point {_numbers(found.x)}", f"{count} root{'' if count == 1 else 's'} by {self.row.value}"]
        for x_rest, distance, residual in zip(found.x_rest, found.distance, found.residual, strict=True):
            quality = f", distance {distance:.4f} L, residual {residual:.1e} L" if np.isfinite(residual) else ""
            lines.append(f"root {_numbers(x_rest)}{quality}")
        self.note.show(*lines)

    def _remove(self) -> None:
        for handle in self._drawn:
            handle.remove()
        self._drawn = []

    def fail(self, error: Exception) -> None:
        """Show why there are no roots."""
        self.note.show(str(error))


def _numbers(x: np.ndarray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in x)})"
