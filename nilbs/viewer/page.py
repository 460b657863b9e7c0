"""The page: a scene, its panels, and the threads that draw them."""

import numpy as np

from nilbs.viewer import server
from nilbs.viewer.following import Follower
from nilbs.viewer.guard import Guard
from nilbs.viewer.panels.bones import Bones
from nilbs.viewer.panels.cutting import Cutting
from nilbs.viewer.panels.meetings import Contacts, Points
from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.panels.playing import Playing
from nilbs.viewer.panels.rest import Rest
from nilbs.viewer.panels.saving import Saving
from nilbs.viewer.panels.skin import Skin
from nilbs.viewer.panels.surface import ReconstructedSurface
from nilbs.viewer.panels.weights import Weights
from nilbs.viewer.state import Scene

FAR = 1.35  # of the camera from the first body, in L


class Page:
    """A scene on a page.

    One thread draws the posed meshes and bones, and another one what takes longer; each always takes up the newest
    state, so that neither waits for the other.

    Parameters
    ----------
    scene : Scene
    host : str
        The address that it is served on.
    port : int
        0 for any that is free.
    """

    def __init__(self, scene: Scene, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.scene, self.guard = scene, Guard.of(host)
        self.server = server.start(self.guard, port)
        self.stage = Stage(scene, self.server)
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._look()
        tabs = gui.add_tab_group()
        with tabs.add_tab("pose"):
            self.bones = Bones(self.stage)
            self.playing = Playing(self.stage)
        with tabs.add_tab("body"):
            self.skin = Skin(self.stage)
            self.weights = Weights(self.stage, self.skin)
            self.surface = ReconstructedSurface(self.stage)
        with tabs.add_tab("cut"):
            self.cutting = Cutting(self.stage)
        with tabs.add_tab("rest"):
            self.rest = Rest(self.stage, self.cutting)
        with tabs.add_tab("meet"):
            self.contacts = Contacts(self.stage)
            points = [Points(self.stage, scene.points)] if scene.points is not None else []
        with tabs.add_tab("save"):
            self.saving = Saving(self.stage, self.skin, self.surface)
        self._threads = [
            Follower(scene, [self.skin, self.bones, self.playing]),
            Follower(scene, [self.weights, self.surface, self.cutting, self.rest, self.contacts, *points]),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return self.guard.address(self.server.get_port())

    def stop(self) -> None:
        """End the threads and the server."""
        self.scene.stop()
        for thread in self._threads:
            thread.join(timeout=5.0)  # compiling the engine takes longer
        server.stop(self.server)

    def _look(self) -> None:
        """The first look of who opens the page."""
        camera, middle = self.server.initial_camera, np.zeros(3)
        self.server.scene.set_up_direction(tuple(self.stage.view.axes[1]))
        camera.position, camera.look_at = middle + FAR * self.stage.look.axes[2], middle
        camera.up = self.stage.view.axes[1]
        self.server.scene.configure_default_lights(cast_shadow=False)
