"""A thread that draws layers of a scene at its own pace: always the newest state, and only what has changed."""

from collections.abc import Hashable, Sequence
from threading import Thread
from typing import Protocol

from nilbs.viewer.state import Scene, Shot


class Layer(Protocol):
    """Something that is drawn."""

    def key(self, shot: Shot) -> Hashable:
        """What the drawing depends on: it is drawn again when this changes."""

    def draw(self, shot: Shot) -> None:
        """Draw it; errors that a user may cause go to `fail`."""

    def fail(self, error: Exception) -> None:
        """Show why it could not be drawn."""


class Follower(Thread):
    """Draws layers of a scene until it is stopped. States that pass while it draws are left out."""

    def __init__(self, scene: Scene, layers: Sequence[Layer]) -> None:
        super().__init__(daemon=True)
        self.scene, self.layers = scene, tuple(layers)
        self._drawn: dict[int, Hashable] = {}

    def run(self) -> None:
        """Wait for changes and draw them."""
        version = -1
        while (shot := self.scene.wait(after=version)) is not None:
            version = shot.version
            self.follow(shot)

    def follow(self, shot: Shot) -> None:
        """Draw the layers that differ in a shot from what was drawn last."""
        for i, layer in enumerate(self.layers):
            key = layer.key(shot)
            if self._drawn.get(i, self) == key:
                continue
            try:
                layer.draw(shot)
            except (ValueError, ImportError, RuntimeError, MemoryError) as error:
                layer.fail(error)
            self._drawn[i] = key
