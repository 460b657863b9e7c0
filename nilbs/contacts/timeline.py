"""Contacts over the frames of a motion: with the body itself, and with others."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nilbs.characters.motion import Motion
from nilbs.contacts.pairs import contacts, skin_places
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.models.model import Model


@dataclass(frozen=True)
class FrameContact:
    """The deepest contact of one frame.

    Attributes
    ----------
    frame : int
    seconds : float
    count : int
        Places in contact.
    depth : float
        Of the deepest, in mesh units; zero if there is none.
    bones : tuple of (str, str), or None
        The bone that holds the deepest place, and the other one there.
    point : tuple of d floats, or None
        Where it is.
    """

    frame: int
    seconds: float
    count: int
    depth: float
    bones: tuple[str, str] | None
    point: tuple[float, ...] | None


@dataclass(frozen=True)
class Timeline:
    """The deepest contacts of all frames of a motion, with the body itself or with one other."""

    name: str
    frames: Sequence[FrameContact]

    @property
    def worst(self) -> list[FrameContact]:
        """Frames with a contact, the deepest first."""
        return sorted((f for f in self.frames if f.count), key=lambda f: (-f.depth, f.frame))

    def values(self, L: float) -> dict[str, Any]:
        """What is written as JSON; depths also as shares of the length L."""
        rows = [{**vars(f), "depth_of_L": f.depth / L} for f in self.frames]
        return {"with": self.name, "frames_in_contact": len(self.worst), "frames": rows}


def self_timeline(finder: SelfContactFinder, motion: Motion, *, step: Callable[[], object] = lambda: None) -> Timeline:
    """Where a body meets itself in each frame of its motion; `step` is called after each."""
    names, frames = finder.model.character.skeleton.names, []
    for k in range(len(motion)):
        found = finder(motion[k])
        bones = (names[found.part[0]], names[found.other_part[0]]) if len(found.depth) else None
        frames.append(_frame(motion, k, found.depth, found.point, bones))
        step()
    return Timeline("itself", frames)


def pair_timeline(
    model: Model, motion: Motion, name: str, other: Model, *, samples: int, step: Callable[[], object] = lambda: None
) -> Timeline:
    """Where a body meets another one, which moves as it was trained to at the same time, in each frame.

    So many places on each skin are searched.
    """
    bodies, frames = (model.character, other.character), []
    on_model, on_other = (skin_places(c.V, c.F, samples=samples) for c in bodies)
    for k in range(len(motion)):
        pose = other.motion.at(seconds=float(motion.times[k]))
        found = contacts(model, motion[k], other, pose, skins=(on_model, on_other))
        bones, deepest = None, int(np.argmax(found.depth)) if len(found.depth) else None
        if deepest is not None:
            mine, its = (found.other_facet, found.facet) if found.of_b[deepest] else (found.facet, found.other_facet)
            bones = (_bone(model, int(mine[deepest])), _bone(other, int(its[deepest])))
        order = np.argsort(-found.depth, kind="stable")
        frames.append(_frame(motion, k, found.depth[order], found.point[order], bones))
        step()
    return Timeline(name, frames)


def _bone(model: Model, facet: int) -> str:
    """The bone that moves a facet most."""
    c = model.character
    return c.skeleton.names[int(c.W[c.F[facet]].sum(axis=0).argmax())]


def _frame(motion: Motion, k: int, depth: np.ndarray, point: np.ndarray, bones: tuple[str, str] | None) -> FrameContact:
    where = tuple(point[0].tolist()) if len(depth) else None
    return FrameContact(
        int(motion.frames[k]), float(motion.times[k]), len(depth), float(depth[0]) if len(depth) else 0.0, bones, where
    )


def table(timelines: Sequence[Timeline], L: float, exempt: Mapping[str, float], *, rows: int = 5) -> str:
    """The worst frames of each timeline, for people."""
    lines = []
    for timeline in timelines:
        worst = timeline.worst
        lines.append(f"contacts with {timeline.name}: {len(worst)} of {len(timeline.frames)} frames")
        if not worst:
            continue
        lines.append(f"  {'frame':>6}  {'seconds':>8}  {'depth':>10}  {'% of L':>7}  {'places':>6}  bones")
        for f in worst[:rows]:
            assert f.bones is not None
            lines.append(
                f"  {f.frame:6d}  {f.seconds:8.3f}  {f.depth:10.4g}  {100 * f.depth / L:7.3f}  {f.count:6d}  "
                f"{f.bones[0]} and {f.bones[1]}"
            )
        if len(worst) > rows:
            lines.append(f"  and {len(worst) - rows} more frames")
    lines += [f"{name}: {100 * share:.1f} %" for name, share in exempt.items()]
    return "\n".join(lines)
