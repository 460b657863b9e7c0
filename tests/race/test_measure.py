import numpy as np
import pytest

from nilbs.race import measure
from nilbs.race.measure import times, warm_up
from nilbs.race.scenes import Scene

SCENE = Scene(np.eye(4)[None], np.zeros((4, 3)))


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    monkeypatch.setattr(measure, "perf_counter", Clock())
    return measure.perf_counter


class Slow:
    """Takes so long, by a clock that it moves on itself."""

    def __init__(self, log=None, name="", pose=0.0, query=0.0, clock=None):
        self.log, self.name, self.seconds, self.clock = log if log is not None else [], name, (pose, query), clock

    def _take(self, seconds):
        if self.clock is not None:
            self.clock.now += seconds

    def points(self, x):
        self._take(1000)
        return x

    def pose(self, B):
        self.log.append(self.name)
        self._take(self.seconds[0])

    def query(self, x):
        self._take(self.seconds[1] * len(self.log))
        return np.ones(len(x), dtype=bool)


def test_times_are_medians_per_pose_without_the_conversion_of_points(clock):
    found = times({"a": Slow(pose=1, query=2, clock=clock)}, lambda k: [SCENE] * 2, 3)["a"]
    # Queries of the three repeats take 2 + 4, 6 + 8 and 10 + 12 seconds.
    assert found == pytest.approx({"pose_s": 1, "query_s": 7, "total_s": 8, "low_s": 4, "high_s": 12})


def test_contestants_take_turns_and_each_begins_once():
    log, turns = [], []
    contestants = {name: Slow(log, name) for name in "abc"}
    times(contestants, lambda k: [SCENE], 3, turn=turns.append)
    assert "".join(log) == "".join(turns) == "abcbcacab"


def test_each_repeat_has_its_own_block():
    asked = []
    times({"a": Slow()}, lambda k: asked.append(k) or [SCENE], 4)
    assert asked == [0, 1, 2, 3]


def test_poses_may_be_taken_together(clock):
    class Together(Slow):
        def together(self, B, x):
            assert (B.shape, x.shape) == ((2, 1, 4, 4), (2, 4, 3))
            self._take(6)

    found = times({"a": Together(pose=1, query=2, clock=clock)}, lambda k: [SCENE] * 2, 3)["a"]
    assert found == pytest.approx({"pose_s": 0, "query_s": 3, "total_s": 3, "low_s": 3, "high_s": 3})


def test_no_contestants_no_times():
    assert times({}, lambda k: [SCENE], 2) == {}


def test_a_first_call_answers():
    assert warm_up(Slow(), SCENE).all()
