from dataclasses import replace

import numpy as np
import pytest

from nilbs.characters.motion import Motion
from nilbs.contacts.self_contacts import SelfContactFinder
from nilbs.contacts.timeline import pair_timeline, self_timeline, table
from nilbs.models.model import Model

from .conftest import LENGTH


@pytest.fixture
def bodies(capsules, moved) -> tuple[Model, Model]:
    """A capsule that swings, and one above it, which stays; the two touch where the upper bone is and the tail."""
    model = capsules[3]
    swing = Motion(np.stack([moved(3, x) for x in (0.2, 0.0, 0.1, 0.9)]), np.array([0, 2, 4, 6]), "test")
    c = model.character
    above = replace(c, skeleton=replace(c.skeleton, names=("tail", "tip")))
    still = Motion(np.stack([moved(3, 0, 0.8 * LENGTH)] * 2), np.arange(2), "test")
    return replace(model, motion=swing), Model(above, still, model.method, model.history, model.parameters, model.rest)


def test_the_deepest_contact_of_each_frame(bodies) -> None:
    model, other = bodies
    steps: list[int] = []
    found = pair_timeline(model, model.motion, "other", other, samples=4000, step=lambda: steps.append(1))
    assert len(steps) == 4
    assert [f.frame for f in found.frames] == [0, 2, 4, 6]
    assert [f.seconds for f in found.frames] == [0, 2 / 24, 4 / 24, 6 / 24]
    assert [f.frame for f in found.worst] == [2, 4, 0]
    assert found.frames[1].depth == pytest.approx(0.2 * LENGTH, abs=0.01)
    assert {f.bones for f in found.worst} == {("bone1", "tail")}
    last = found.frames[3]
    assert (last.count, last.depth, last.bones, last.point) == (0, 0.0, None, None)
    L = model.character.L
    values = found.values(L)
    assert (values["with"], values["frames_in_contact"]) == ("other", 3)
    assert values["frames"][1]["depth_of_L"] == found.frames[1].depth / L
    lines = table([found], L, {"exempt": 0.25}, rows=2).splitlines()
    assert lines[0] == "contacts with other: 3 of 4 frames"
    assert [line.split()[0] for line in lines[2:4]] == ["2", "4"]
    assert lines[2].endswith("bone1 and tail")
    assert lines[-2:] == ["  and 1 more frames", "exempt: 25.0 %"]


def test_a_body_that_does_not_meet_itself(bodies) -> None:
    model, _ = bodies
    found = self_timeline(SelfContactFinder(model, samples=100), model.motion)
    assert found.worst == []
    assert [f.frame for f in found.frames] == [0, 2, 4, 6]
    assert table([found], model.character.L, {}) == "contacts with itself: 0 of 4 frames"
