"""The skeleton, and the joint that is turned by hand."""

from collections.abc import Hashable
from typing import Any

import numpy as np
import trimesh
import viser
from viser import transforms

from nilbs.geometry.rotations import nearest_rotations
from nilbs.viewer.panels.panel import Note, Stage, put
from nilbs.viewer.posing import joints, segments, turn_to
from nilbs.viewer.state import Shot

LINE, JOINT, CHOSEN = (60, 60, 60), (70, 110, 160), (213, 94, 0)
SIZE = 0.008  # of a joint, in L


class Bones:
    """Bones and joints of each body; a joint is chosen by a click or by name, and turned by sliders or a handle."""

    def __init__(self, stage: Stage) -> None:
        self.stage, scene = stage, stage.scene
        gui, d = stage.server.gui, scene.d
        self.visible = gui.add_checkbox("skeleton", True)
        names = [body.name for body in scene.bodies]
        labels = [f"{i + 1}: {name}" for i, name in enumerate(names)]
        self.body = gui.add_dropdown("body", labels, visible=len(labels) > 1)
        self.search = gui.add_text("search", "", hint="part of a bone's name")
        self.bone = gui.add_dropdown("bone", stage.selected.character.skeleton.names)
        letters = ("x", "y", "z") if d == 3 else ("angle",)
        self.angles = [
            gui.add_slider(letter, -180.0, 180.0, 0.5, 0.0, hint="rotation vector of the bone, degrees")
            for letter in letters
        ]
        self.handle_shown = gui.add_checkbox("handle", True)
        self.reset = gui.add_button_group("reset", ("bone", "all"))
        self.note: Note = stage.note()
        self._dragging = False
        stage.watch(self.visible, self.handle_shown)
        stage.watch(self.body, then=self._choose_body)
        stage.watch(self.search, then=self._filter)
        stage.watch(self.bone, then=self._choose_bone)
        stage.watch(*self.angles, moves=True, then=self._turn)
        self.reset.on_click(lambda _: self._reset())
        ball = trimesh.creation.icosphere(subdivisions=1, radius=SIZE)
        self._lines, self._balls = [], []
        shot = scene.shot()
        for i, (body, pose) in enumerate(zip(scene.bodies, shot.poses, strict=True)):
            skeleton = body.character.skeleton
            ends, places = scene.frame.place(segments(skeleton, pose)), scene.frame.place(joints(skeleton, pose))
            view = stage.server.scene
            self._lines.append(
                view.add_line_segments(f"/bones/{i}/lines", ends, colors=LINE, thickness=3.0, thickness_units="screen")
            )
            turns = np.tile([1.0, 0, 0, 0], (len(places), 1))
            balls = view.add_batched_meshes_simple(
                f"/bones/{i}/joints",
                ball.vertices,
                ball.faces,
                turns,
                places,
                batched_colors=self._colours(i, stage.selection),
            )
            balls.on_click(lambda event, i=i: self._choose(i, event.instance_index))  # type: ignore[misc]
            self._balls.append(balls)
        self.gizmo = self._gizmo()
        stage.server.on_client_disconnect(lambda _: self._release())

    def _gizmo(self) -> viser.TransformControlsHandle:
        d = self.stage.scene.d
        gizmo = self.stage.server.scene.add_transform_controls(
            "/handle", scale=0.16, active_axes=(True, True, d == 3), disable_sliders=True, depth_test=False
        )

        @gizmo.on_update
        def _(event: viser.TransformControlsEvent) -> None:
            self._dragging = event.phase != "end"
            with self.stage.scene.changing(moves=True):
                self._drag()

        return gizmo

    def _release(self) -> None:
        """A page that was closed holds the handle no more."""
        self._dragging = False

    # What a user does.

    def _choose(self, body: int, bone: int | None) -> None:
        if bone is None:
            return
        with self.stage.scene.changing():
            self.stage.selection = body, bone
            put(self.body, self.body.options[body])
            put(self.search, "")
            self.bone.options = self.stage.selected.character.skeleton.names
            put(self.bone, self.bone.options[bone])
            self._show_angles()

    def _choose_body(self) -> None:
        self.stage.selection = self.body.options.index(self.body.value), 0
        put(self.search, "")
        self._filter()

    def _filter(self) -> None:
        """Offer the bones whose names hold what is searched."""
        names = self.stage.selected.character.skeleton.names
        found = [name for name in names if self.search.value.lower() in name.lower()]
        self.note.show(*([] if found else [f"no bone has {self.search.value!r} in its name"]))
        if found:
            self.bone.options = found
            self._choose_bone()

    def _choose_bone(self) -> None:
        names = self.stage.selected.character.skeleton.names
        self.stage.selection = self.stage.body, names.index(self.bone.value)
        self._show_angles()

    def _turn(self) -> None:
        self.stage.selected.theta[self.stage.bone] = np.radians([angle.value for angle in self.angles])

    def _drag(self) -> None:
        """Turn the bone as the handle stands; a root also goes where it is."""
        body, bone, d = self.stage.selected, self.stage.bone, self.stage.scene.d
        pose = self.stage.scene.shot().poses[self.stage.body]
        R = transforms.SO3(np.asarray(self.gizmo.wxyz)).as_matrix()[:d, :d]
        body.theta[bone] = turn_to(pose, body.theta, bone, R)
        if body.character.skeleton.P[bone] < 0:
            joint = joints(body.character.skeleton, pose)[bone]
            body.offset += self.stage.scene.frame.back(np.asarray(self.gizmo.position)) - joint
        self._show_angles()

    def _reset(self) -> None:
        body = self.stage.selected
        with self.stage.scene.changing(moves=True):
            if self.reset.value == "all":
                body.theta[:], body.offset[:] = 0, 0
            else:
                body.theta[self.stage.bone] = 0
            self._show_angles()

    # What is drawn.

    def _show_angles(self) -> None:
        for angle, value in zip(self.angles, np.degrees(self.stage.selected.theta[self.stage.bone]), strict=True):
            put(angle, float(np.clip(value, -180, 180)))

    def _colours(self, i: int, selection: tuple[int, int]) -> np.ndarray:
        colours = np.tile(np.array(JOINT, dtype=np.uint8), (len(self.stage.scene.bodies[i].theta), 1))
        if i == selection[0]:
            colours[selection[1]] = CHOSEN
        return colours

    def key(self, shot: Shot) -> Hashable:
        """Poses, and what is selected."""
        return shot.moved, self.visible.value, self.handle_shown.value, self.stage.selection, self._dragging

    def draw(self, shot: Shot) -> None:
        """Move lines, joints and the handle, but not the handle that a user holds."""
        place, selection = self.stage.scene.frame.place, self.stage.selection
        for i, (body, pose) in enumerate(zip(self.stage.scene.bodies, shot.poses, strict=True)):
            lines: Any = self._lines[i]
            balls: Any = self._balls[i]
            lines.visible = balls.visible = self.visible.value
            lines.points = place(segments(body.character.skeleton, pose))
            balls.batched_positions = place(joints(body.character.skeleton, pose))
            balls.batched_colors = self._colours(i, selection)
        self.gizmo.visible = self.handle_shown.value
        chosen, bone = selection
        body, pose, d = self.stage.scene.bodies[chosen], shot.poses[chosen], self.stage.scene.d
        self.gizmo.disable_axes = bool(body.character.skeleton.P[bone] >= 0)
        if not self._dragging:
            R = np.eye(3)
            R[:d, :d] = nearest_rotations(pose[bone, :d, :d])
            self.gizmo.wxyz = transforms.SO3.from_matrix(R).wxyz
            self.gizmo.position = place(joints(body.character.skeleton, pose)[bone])
        self.stage.server.flush()

    def fail(self, error: Exception) -> None:
        """Show why."""
        self.note.show(str(error))
