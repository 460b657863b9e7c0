"""The clip: which one, where it stands, and how fast it goes."""

from collections.abc import Hashable
from threading import Thread
from time import perf_counter, sleep

from nilbs.viewer.panels.panel import Stage, put
from nilbs.viewer.state import Shot

TICK = 1 / 30  # seconds between the poses of a clip that plays


class Playing:
    """Plays the clips of the first body; the others move at the same time."""

    def __init__(self, stage: Stage) -> None:
        self.stage, scene = stage, stage.scene
        gui = stage.server.gui
        self._labels = [f"{i + 1}: {clip.name}" for i, clip in enumerate(scene.clips)]
        self.clip = gui.add_dropdown("clip", self._labels)
        self.play = gui.add_button("play")
        longest = max(clip.end - clip.start for clip in scene.clips)
        self.time = gui.add_slider("time", 0.0, max(longest, 1e-3), 1e-3, 0.0, hint="seconds from the clip's start")
        self.speed = gui.add_slider("speed", 0.1, 4.0, 0.1, 1.0)
        self.loop = gui.add_checkbox("loop", True)
        stage.watch(self.clip, moves=True, then=self._choose)
        stage.watch(self.time, moves=True, then=self._scrub)
        stage.watch(self.speed, self.loop, then=self._set)
        self.play.on_click(lambda _: self._toggle())
        self._choose()
        Thread(target=self._tick, daemon=True).start()

    def _choose(self) -> None:
        scene = self.stage.scene
        scene.choose_clip(scene.clips[self._labels.index(self.clip.value)])
        self.time.max = max(scene.player.duration, 1e-3)
        put(self.time, 0.0)

    def _scrub(self) -> None:
        self.stage.scene.player.time = min(self.time.value, self.stage.scene.player.duration)

    def _set(self) -> None:
        self.stage.scene.player.speed, self.stage.scene.player.loop = self.speed.value, self.loop.value

    def _toggle(self) -> None:
        player = self.stage.scene.player
        with self.stage.scene.changing(moves=True):
            if not player.playing and player.time >= player.duration:
                player.time = 0.0
            player.playing = not player.playing

    def _tick(self) -> None:
        scene, before = self.stage.scene, perf_counter()
        while not scene.stopped:
            sleep(TICK)
            now = perf_counter()
            if scene.player.playing:
                with scene.changing(moves=True):
                    scene.player.advance(now - before)
            before = now

    def key(self, shot: Shot) -> Hashable:
        """The time."""
        return self.stage.scene.player.time, self.stage.scene.player.playing

    def draw(self, shot: Shot) -> None:
        """Show where the clip stands."""
        player = self.stage.scene.player
        self.play.label = "pause" if player.playing else "play"
        if player.playing or player.time >= player.duration:
            put(self.time, round(min(player.time, self.time.max), 3))

    def fail(self, error: Exception) -> None:
        """A clock does not fail."""
        raise error
