"""The clock of a clip: play, pause, speed and loop."""

from dataclasses import dataclass
from typing import NamedTuple

from nilbs.characters.motion import Motion


class Clip(NamedTuple):
    """A named stretch of a motion, in its seconds."""

    name: str
    start: float
    end: float


def clips(motion: Motion) -> list[Clip]:
    """The clips of a motion; of one without names, the whole.

    Examples
    --------
    >>> import numpy as np
    >>> clips(Motion(np.tile(np.eye(3), (3, 1, 1, 1)), [0, 1, 2], "walk.bvh", [0, 0.5, 1.0]))
    [Clip(name='walk.bvh', start=0.0, end=1.0)]
    """
    names, starts = zip(*(motion.clips or ((motion.source, 0),)), strict=True)
    times, ends = motion.times, [*starts[1:], len(motion)]
    return [
        Clip(name, float(times[k]), float(times[end - 1])) for name, k, end in zip(names, starts, ends, strict=True)
    ]


@dataclass
class Player:
    """Where a clip stands: its `time` is in seconds from the start of the clip.

    Examples
    --------
    >>> player = Player(duration=2.0, speed=0.5, playing=True)
    >>> player.advance(3.0), player.advance(2.0)
    (1.5, 0.5)
    >>> player.loop = False
    >>> player.advance(9.0), player.playing
    (2.0, False)
    """

    duration: float
    time: float = 0.0
    speed: float = 1.0
    loop: bool = True
    playing: bool = False

    def advance(self, seconds: float) -> float:
        """Let time pass; at the end of a clip it starts again, or stops there."""
        if not self.playing:
            return self.time
        time = self.time + self.speed * seconds
        if self.loop and self.duration > 0:
            self.time = time % self.duration
        else:
            self.time = min(time, self.duration)
            self.playing = self.time < self.duration
        return self.time
