import threading

import numpy as np
import pytest

from nilbs.characters.motion import Motion
from nilbs.methods.registry import untrained
from nilbs.viewer.following import Follower
from nilbs.viewer.playback import Player, clips
from nilbs.viewer.state import Body, PageFrame, Scene


@pytest.mark.parametrize("d", [2, 3])
def test_page_frame_goes_there_and_back(characters, d):
    c = characters[d]
    frame = PageFrame(c.center, c.L)
    place = frame.place(c.V)
    assert place.shape == (len(c.V), 3)
    assert np.ptp(place, axis=0).max() == pytest.approx(1)
    np.testing.assert_allclose(frame.back(place), c.V, atol=1e-6 * c.L)
    assert frame.place(c.V[c.F]).shape == (*c.F.shape, 3)


def test_a_pose_is_that_of_the_motion_until_a_hand_moves_it(body):
    one = body(3)
    np.testing.assert_array_equal(one.pose(0.1), one.motion.at(seconds=0.1))
    one.offset[:] = 1, 2, 3
    moved = one.character.skin(one.pose(0.1)) - one.character.skin(one.motion.at(seconds=0.1))
    np.testing.assert_allclose(moved, np.broadcast_to([1.0, 2, 3], moved.shape), atol=1e-12)


def test_rows_are_the_mappings_and_the_baselines(body):
    one = body(3)
    assert one.rows()[0] == "search"
    assert set(one.rows()) == {*one.model.method.mappings, *untrained()}
    x, pose = one.character.skin(one.motion[1]) + 0.01, one.motion[1]
    for row in one.model.method.mappings:
        np.testing.assert_array_equal(one.posed(pose, row).occupancy(x), one.model.occupancy(x, pose, mapping=row))
    assert one.posed(pose, "mesh-lbs").model.method.name == "mesh-lbs"
    with pytest.raises(ValueError, match="no row 'nothing'"):
        one.posed(pose, "nothing")


def test_a_character_without_a_model_has_the_baselines(characters, models):
    one = Body.of_character(characters[3], models[3].motion)
    assert one.rows() == ("nearest", *(name for name in untrained() if name != "nearest"))
    assert not one.has_ghost
    assert body_has_ghost(models[3])


def body_has_ghost(model) -> bool:
    return Body("hero", model, model.motion).has_ghost


def test_bodies_have_one_dimension(body):
    with pytest.raises(ValueError, match="flat has 2 dimensions, hero has 3"):
        Scene([body(3), body(2, "flat")])


def test_clips_follow_each_other():
    B = np.tile(np.eye(3), (5, 1, 1, 1))
    motion = Motion(B, range(5), "two.glb", [0, 1, 2, 3, 5], clips=(("walk", 0), ("run", 3)))
    assert clips(motion) == [("walk", 0, 2), ("run", 3, 5)]


def test_a_clip_of_no_length_stands_still():
    player = Player(0.0, playing=True)
    assert player.advance(1.0) == 0


def test_a_chosen_clip_starts_at_its_start(body):
    one = body(3)
    one.motion = Motion(one.motion.B, range(6), "two", clips=(("walk", 0), ("run", 3)))
    scene = Scene([one])
    with scene.changing(moves=True):
        scene.choose_clip(scene.clips[1])
    np.testing.assert_array_equal(scene.shot().poses[0], one.motion[3])


class Recorder:
    """A layer that keeps what it was told to draw, each drawing as slow as wanted."""

    def __init__(self, gate=None):
        self.drawn, self.failed, self.gate, self.started = [], [], gate, threading.Event()

    def key(self, shot):
        return shot.moved

    def draw(self, shot):
        self.started.set()
        if self.gate is not None:
            assert self.gate.wait(30)
        self.drawn.append(shot.version)
        if shot.version == 0:
            raise ValueError("nothing yet")

    def fail(self, error):
        self.failed.append(str(error))


def test_a_follower_leaves_out_what_passed_while_it_drew(scene):
    one, gate = scene(), threading.Event()
    layer = Recorder(gate)
    follower = Follower(one, [layer])
    follower.start()
    assert layer.started.wait(30)
    for _ in range(5):
        with one.changing(moves=True):
            pass
    gate.set()
    while layer.drawn[-1:] != [5]:
        threading.Event().wait(0.001)
    one.stop()
    follower.join(30)
    assert layer.drawn == [0, 5]
    assert layer.failed == ["nothing yet"]


def test_a_follower_draws_only_what_has_changed(scene):
    one, layer = scene(), Recorder()
    follower = Follower(one, [layer])
    follower.follow(one.shot())
    with one.changing():
        pass
    follower.follow(one.shot())
    assert layer.drawn == [0]
    with one.changing(moves=True):
        pass
    follower.follow(one.shot())
    assert layer.drawn == [0, 2]
