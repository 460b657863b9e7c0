"""The posed meshes."""

from collections.abc import Hashable

import viser

from nilbs.engine.skinning import SparseSkinning
from nilbs.viewer.panels.panel import BODIES, Stage
from nilbs.viewer.state import Shot


class Skin:
    """The posed mesh of each body, by linear blend skinning; drawn at once in each pose."""

    def __init__(self, stage: Stage) -> None:
        self.stage, scene = stage, stage.scene
        gui = stage.server.gui
        self.visible = gui.add_checkbox("skin", True)
        self.opacity = gui.add_slider("opacity", 0.1, 1.0, 0.05, 1.0 if scene.d == 2 else 0.75)
        stage.watch(self.visible, self.opacity)
        self.covered: set[int] = set()  # bodies that another layer draws in colours
        self._skinning = [SparseSkinning(body.V, body.W) for body in scene.bodies]
        self.meshes: list[viser.MeshHandle] = [
            stage.server.scene.add_mesh_simple(
                f"/skin/{i}",
                scene.frame.place(body.V),
                body.F,
                color=BODIES[i % len(BODIES)],
                side="double",
            )
            for i, body in enumerate(scene.bodies)
        ]

    def key(self, shot: Shot) -> Hashable:
        """Poses, and how the meshes look."""
        return shot.moved, self.visible.value, self.opacity.value, tuple(self.covered)

    def draw(self, shot: Shot) -> None:
        """Move the vertices."""
        place = self.stage.scene.frame.place
        for i, (mesh, skinning, pose) in enumerate(zip(self.meshes, self._skinning, shot.poses, strict=True)):
            mesh.visible = self.visible.value and i not in self.covered
            mesh.opacity = None if self.opacity.value == 1 else self.opacity.value
            if mesh.visible:
                mesh.vertices = place(skinning.posed(pose))
        self.stage.server.flush()

    def fail(self, error: Exception) -> None:
        """A pose always has a skin."""
        raise error
