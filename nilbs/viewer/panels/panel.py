"""What parts of the page share: the stage that they act on, and notes."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import viser

from nilbs.figures.views import View
from nilbs.geometry.surface import Surface
from nilbs.viewer.colours import linear
from nilbs.viewer.state import Body, Scene

# Colours of bodies, the first as in every figure.
BODIES = ((0xC9, 0xA2, 0x7A), (120, 160, 200), (150, 185, 130), (190, 140, 170))


@dataclass
class Stage:
    """The scene, the server that shows it, and what is selected on the page.

    Attributes
    ----------
    selection : (int, int)
        The selected body and bone: one value, so that a thread that draws never sees a bone of another body.
    view, look : View
        The first body's front, and from where it is seen first.
    """

    scene: Scene
    server: viser.ViserServer
    selection: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        V = self.scene.bodies[0].character.V
        self.view = View.front(np.column_stack([V, np.zeros(len(V))]) if V.shape[1] == 2 else V)
        self.look = self.view.turned() if self.scene.d == 3 else self.view

    @property
    def body(self) -> int:
        """The selected body."""
        return self.selection[0]

    @property
    def bone(self) -> int:
        """The selected bone of that body."""
        return self.selection[1]

    @property
    def selected(self) -> Body:
        """The selected body."""
        return self.scene.bodies[self.body]

    def watch(self, *inputs: Any, moves: bool = False, then: Callable[[], None] | None = None) -> None:
        """Let a change of one of the inputs by a user change the scene, after `then`; what we set changes nothing."""

        def changed(event: viser.GuiEvent) -> None:
            if event.client_id is not None:
                with self.scene.changing(moves=moves):
                    if then is not None:
                        then()

        for one in inputs:
            one.on_update(changed)

    def row_dropdown(self) -> viser.GuiDropdownHandle:
        """A choice of the rows of the first body, which the others may lack."""
        rows = self.scene.bodies[0].rows()
        return self.server.gui.add_dropdown("row", rows, hint="the mapping or the baseline that answers")

    def coloured(self, name: str, U: np.ndarray, F: np.ndarray, colours: np.ndarray) -> viser.GlbHandle:
        """Draw triangles of the world whose vertices have colours (n, 3)."""
        mesh: Any = Surface(self.scene.frame.place(U), F).to_trimesh()
        mesh.visual.vertex_colors = linear(colours)
        return self.server.scene.add_mesh_trimesh(name, mesh)

    def note(self) -> "Note":
        """A place for a few lines in the panel."""
        return Note(self.server.gui.add_html(""))


def put(handle: Any, value: Any) -> None:
    """Set an input of the page from here."""
    handle.value = value


class Note:
    """Lines of text; what looks like code in them stays text."""

    def __init__(self, handle: viser.GuiHtmlHandle) -> None:
        self._handle = handle

    def wait(self) -> None:
        """State that the first answer is on its way: the engine may have to be compiled before."""
        if not self._handle.content:
            self.show("computing ...")

    def show(self, *lines: str, bar: str = "") -> None:
        """Show lines, and the bar of a scale below them."""
        text = f'<div style="margin:0.4em 1em;font-size:0.8em">{"<br>".join(map(escape, lines))}</div>'
        self._handle.content = f"{text if lines else ''}{bar}"
