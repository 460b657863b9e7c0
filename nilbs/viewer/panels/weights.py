"""The weights of the selected bone on the skin."""

from collections.abc import Hashable
from typing import Any

from nilbs.geometry.skinning import linear_blend_skinning
from nilbs.viewer.colours import WEIGHT
from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.panels.skin import Skin
from nilbs.viewer.state import Shot


class Weights:
    """The selected body in the colours of the selected bone's skinning weights, instead of its skin."""

    def __init__(self, stage: Stage, skin: Skin) -> None:
        self.stage, self.skin = stage, skin
        self.visible = stage.server.gui.add_checkbox("weights of the bone", False)
        self.note = stage.note()
        stage.watch(self.visible)
        self._drawn: Any = None

    def key(self, shot: Shot) -> Hashable:
        """The pose and the bone, while they are visible."""
        return self.visible.value and (shot.moved, self.stage.selection)

    def draw(self, shot: Shot) -> None:
        """Draw the body in colours, and hide its skin."""
        if not self.visible.value:
            self._remove()
            self.note.show()
            return
        i, bone = self.stage.selection
        body = self.stage.scene.bodies[i]
        U = linear_blend_skinning(body.V, body.W, shot.poses[i])
        self._drawn = self.stage.coloured("/weights", U, body.F, WEIGHT(body.W[:, bone]))
        self.note.show(f"weights of {body.character.skeleton.names[bone]}", bar=WEIGHT.bar())
        if self.skin.covered != {i}:
            with self.stage.scene.changing():
                self.skin.covered = {i}

    def _remove(self) -> None:
        if self._drawn is not None:
            self._drawn.remove()
            self._drawn = None
            with self.stage.scene.changing():
                self.skin.covered = set()

    def fail(self, error: Exception) -> None:
        """Show why."""
        self.note.show(str(error))
