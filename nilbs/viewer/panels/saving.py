"""What can be saved: a picture, a film, the surface, the pose, the page."""

import io
from collections.abc import Callable

import numpy as np
import viser
from PIL import Image

from nilbs.viewer.panels.panel import Stage
from nilbs.viewer.panels.skin import Skin
from nilbs.viewer.panels.surface import ReconstructedSurface
from nilbs.viewer.saving import mesh_file, pose_file, turntable

SIZE = (960, 1280)  # of a picture of the page: height and width, in pixels


class Saving:
    """Buttons, each of which sends a file to the browser that clicked it; none is written on this machine."""

    def __init__(self, stage: Stage, skin: Skin, surface: ReconstructedSurface) -> None:
        self.stage, self.skin, self.surface = stage, skin, surface
        self.note = stage.note()
        for label, suffix, make in (
            ("picture, .png", ".png", self._picture),
            ("turntable, .gif", ".gif", self._turntable),
            ("surface, .glb", ".glb", lambda _: self._surface(".glb")),
            ("surface, .obj", ".obj", lambda _: self._surface(".obj")),
            ("pose, .json", ".json", lambda _: self._pose()),
            ("page, .html", ".html", lambda _: self.page()),
        ):
            self._button(label, suffix, make)

    def _button(self, label: str, suffix: str, make: Callable[[viser.ClientHandle], bytes]) -> None:
        button = self.stage.server.gui.add_button(label)

        @button.on_click
        def _(event: viser.GuiEvent) -> None:
            if event.client is None:
                return
            button.disabled = True
            try:
                content = make(event.client)
                name = f"{self.stage.selected.name}{suffix}"
                event.client.send_file_download(name, content, save_immediately=True)
                self.note.show(f"{name}: {len(content):,} bytes")
            except (ValueError, MemoryError, RuntimeError, OSError, ImportError) as error:
                self.note.show(str(error))
            finally:
                button.disabled = False

    def _picture(self, client: viser.ClientHandle) -> bytes:
        picture = client.get_render(*SIZE, transport_format="png", timeout=60.0)
        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="PNG")
        return file.getvalue()

    def _shown(self) -> tuple[np.ndarray, np.ndarray]:
        """The surface of the selected body, if it is shown, else its skin."""
        i, found = self.stage.body, self.surface.found
        body = self.stage.scene.bodies[i]
        if found:
            return found[i][:2]
        pose = self.stage.scene.shot().poses[i]
        return body.model.skinning.posed(pose), body.character.F

    def _turntable(self, client: viser.ClientHandle) -> bytes:
        return turntable(*self._shown(), self.stage.view)

    def _surface(self, suffix: str) -> bytes:
        return mesh_file(*self._shown(), suffix)

    def _pose(self) -> bytes:
        return pose_file(self.stage.selected, self.stage.scene.shot().poses[self.stage.body])

    def page(self) -> bytes:
        """The scene as a page of its own, which needs no server; a pose that does not move any more."""
        return self.stage.server.scene.as_html().encode()
