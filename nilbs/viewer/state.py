"""What the page shows, without the page: characters, their fields, and the pose in which each is."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Condition
from typing import NamedTuple

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.geometry.plane import in_space
from nilbs.methods.registry import untrained
from nilbs.models.fitting import fit
from nilbs.models.model import Model
from nilbs.models.posed_model import PosedModel
from nilbs.viewer.playback import Clip, Player, clips
from nilbs.viewer.posing import turned


class PageFrame(NamedTuple):
    """The page's frame: the first character's rest mesh is centred there, and its longest edge is 1."""

    center: np.ndarray
    L: float

    def place(self, x: np.ndarray) -> np.ndarray:
        """Points (..., d) of the world on the page, (..., 3); the plane is at z = 0.

        Examples
        --------
        >>> PageFrame(np.array([1.0, 0.0]), 2.0).place(np.array([[3.0, 1.0]])).tolist()
        [[1.0, 0.5, 0.0]]
        """
        x = (x - self.center) / self.L
        return in_space(x.reshape(-1, x.shape[-1])).reshape(*x.shape[:-1], 3).astype(np.float32)

    def back(self, place: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the page in the world, (..., d)."""
        return np.asarray(place, dtype=np.float64)[..., : len(self.center)] * self.L + self.center


class Body:
    """A character, its motion, its fields, and how it was turned by hand.

    Attributes
    ----------
    name : str
    model : Model
        What was trained; of a character without a model, the baseline `nearest`.
    motion : Motion
    theta : (b, 1) or (b, 3) float array
        Rotation vectors on top of the motion, see `nilbs.viewer.posing.turned`.
    offset : (d,) float array
        By how much the whole body is moved.
    V, W, F : arrays
        The mesh that is shown: the skin, in the plane the triangles inside.
    """

    def __init__(self, name: str, model: Model, motion: Motion) -> None:
        c = model.character
        self.name, self.model, self.motion = name, model, motion
        self.theta = np.zeros((len(c.skeleton.BE), 3 if c.d == 3 else 1))
        self.offset = np.zeros(c.d)
        self.V, self.W, self.F = (c.V, c.W, c.F) if c.d == 3 else (c.V_volume, c.W_volume, c.T)
        self._clip_pose: tuple[float, np.ndarray] = np.nan, np.zeros(0)  # of the motion, at the last time
        self._baselines: dict[str, Model] = {model.method.name: model} if model.method.name in untrained() else {}

    @classmethod
    def of_character(cls, character: Character, motion: Motion) -> "Body":
        """A character without a model: its field is that of the baseline `nearest`, which learns nothing."""
        return cls(character.name, fit(character, motion, "nearest"), motion)

    @property
    def character(self) -> Character:
        """The character."""
        return self.model.character

    def pose(self, seconds: float) -> np.ndarray:
        """The pose (b, d+1, d+1) at a time of the motion, turned and moved by hand."""
        if self._clip_pose[0] != seconds:  # it stays the same while a bone is turned by hand
            self._clip_pose = seconds, self.motion.at(seconds=seconds)
        B = turned(self.character.skeleton, self._clip_pose[1], self.theta)
        if self.offset.any():
            B = B.copy()
            B[:, :-1, -1] += self.offset
        return B

    def rows(self) -> tuple[str, ...]:
        """Names of its fields: the mappings of its method, or the method itself, and the baselines."""
        own = tuple(self.model.method.mappings) or (self.model.method.name,)
        mapping = getattr(self.model.method, "mapping", None)
        own = tuple(sorted(own, key=lambda row: row != mapping))  # its own mapping first
        return own + tuple(name for name in untrained() if name not in own)

    def row_like(self, row: str) -> str:
        """The row of that name, or its own first one if it has none such."""
        return row if row in self.rows() else self.rows()[0]

    def posed(self, pose: np.ndarray, row: str) -> PosedModel:
        """The field of a row in a pose.

        Raises
        ------
        ValueError
            If there is no such row, or the model has no network for it.
        """
        if row not in self.rows():
            raise ValueError(f"{self.name} has no row {row!r}: choose one of {', '.join(self.rows())}")
        if row in self.model.method.mappings:
            return self.model.posed(pose, mapping=row)
        if row not in untrained():
            return self.model.posed(pose)
        if row not in self._baselines:
            self._baselines[row] = fit(self.character, self.motion, row)
        return self._baselines[row].posed(pose)

    @property
    def has_ghost(self) -> bool:
        """Whether a network predicts the weight of the ghost bone."""
        return bool(self.model.parameters) and bool(getattr(self.model.method, "ghost", False))


class Shot(NamedTuple):
    """The scene at one moment.

    Attributes
    ----------
    version : int
        Grows with each change.
    moved : int
        The version at which a body last moved.
    poses : tuple of (b, d+1, d+1) float arrays
        One of each body.
    """

    version: int
    moved: int
    poses: tuple[np.ndarray, ...]


class Scene:
    """Bodies in one world at one time; threads that draw wait for its changes.

    Parameters
    ----------
    bodies : sequence of Body
        Of one dimension.
    points : (n, d) float array, optional
        Points that are coloured by whether a body contains them.
    """

    def __init__(self, bodies: Sequence[Body], *, points: np.ndarray | None = None) -> None:
        for body in bodies[1:]:
            found, wanted = body.character.d, bodies[0].character.d
            if found != wanted:
                raise ValueError(f"{body.name} has {found} dimensions, {bodies[0].name} has {wanted}")
        names = [body.name for body in bodies]
        for i, body in enumerate(bodies, 1):
            if names.count(body.name) > 1:
                body.name = f"{body.name} {i}"
        self.bodies, self.points = tuple(bodies), points
        first = bodies[0].character
        self.frame = PageFrame(first.center, first.L)
        self.clips = clips(bodies[0].motion)
        self.clip = self.clips[0]
        self.player = Player(self.clip.end - self.clip.start)
        self.stopped = False
        self._condition = Condition()
        self._version = self._moved = 0
        self._last: Shot | None = None

    @property
    def d(self) -> int:
        """Dimension, 2 or 3."""
        return self.bodies[0].character.d

    @contextmanager
    def changing(self, *, moves: bool = False) -> Iterator[None]:
        """Change the scene, or what is shown of it, and wake who waits; `moves` if a body may have another pose."""
        with self._condition:
            yield
            self._version += 1
            if moves:
                self._moved = self._version
            self._condition.notify_all()

    def choose_clip(self, clip: Clip) -> None:
        """Go to the start of a clip."""
        self.clip = clip
        self.player.duration, self.player.time = clip.end - clip.start, 0.0

    def shot(self) -> Shot:
        """The scene now."""
        with self._condition:
            return self._shot()

    def wait(self, after: int) -> Shot | None:
        """The scene as soon as its version is above `after`; None when it is stopped."""
        with self._condition:
            self._condition.wait_for(lambda: self.stopped or self._version > after)
            return None if self.stopped else self._shot()

    def stop(self) -> None:
        """End the threads that wait."""
        with self._condition:
            self.stopped = True
            self._condition.notify_all()

    def _shot(self) -> Shot:
        if self._last is not None and self._last.version == self._version:
            return self._last  # for another thread that draws
        # All at the same time, as `nilbs check` compares them; a motion that is shorter stands still.
        poses = [body.pose(self.clip.start + self.player.time) for body in self.bodies]
        self._last = Shot(self._version, self._moved, tuple(poses))
        return self._last
