"""What a worker passes on: the spec of a job reaches the training and the scoring whole."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.study import worker
from benchmarks.study.jobs import Job
from benchmarks.study.worker import do
from nilbs.characters.motion import Motion
from nilbs.io.errors import FileFormatError
from nilbs.models.protocol import IOUS

SPEC = {
    "character": "arm",
    "frames": 17,
    "minutes": 0.25,
    "seed": 3,
    "settings": {"method": "snarf", "width": 9},
}
TRAINING = Job("arm/snarf/seed3", "train", SPEC)
MODEL = SimpleNamespace(save=lambda path: path.write_bytes(b"model"), history=np.arange(5.0))


class Called:
    """A function that remembers its calls, and returns or raises the given results in turn, the last for ever."""

    def __init__(self, *results: Any) -> None:
        self.results, self.calls = list(results), []

    def __call__(self, *args: Any, **options: Any) -> Any:
        self.calls.append((args, options))
        result = self.results.pop(0) if len(self.results) > 1 else self.results[0]
        if isinstance(result, Exception):
            raise result
        return result


@pytest.fixture
def train(store, monkeypatch) -> Callable[..., tuple[Called, Called, Any]]:
    """Do a training whose `fit` returns or raises the given results; the arm and its motion are made up."""

    def done(*results: Any) -> tuple[Called, Called, Any]:
        arm = SimpleNamespace(skeleton=SimpleNamespace(BE=np.zeros((4, 2))), V=np.zeros((10, 3)))
        motion = Called(Motion(np.zeros((2, 4, 4, 4)), np.arange(2), "made up"))
        fit = Called(*results)
        monkeypatch.setattr(worker, "prepared", Called(arm))
        monkeypatch.setattr(worker, "motion_of", motion)
        monkeypatch.setattr("nilbs.models.fitting.fit", fit)
        assert do(TRAINING, store, None) == (not isinstance(results[-1], Exception))
        return fit, motion, store.result(TRAINING)

    return done


def test_a_training_is_of_the_frames_the_minutes_the_seed_and_the_settings(train, store) -> None:
    fit, motion, result = train(MODEL)
    ((args, options),) = motion.calls
    assert args[0] == "arm"
    assert options == {"frames": 17, "seed": 3}
    ((_, options),) = fit.calls
    given = {"method": "snarf", "width": 9, "minutes": 0.25, "seed": 3, "device": "cpu", "resume": True}
    assert {name: options[name] for name in given} == given
    assert (result["frames"], result["steps"], result["loss"], result["bones"]) == (2, 5, 2.0, 4)
    assert result["resumed"] is False
    assert store.model(TRAINING.key).read_bytes() == b"model"


def test_a_training_that_is_continued_is_marked_and_leaves_no_checkpoint(train, store) -> None:
    checkpoint = worker._checkpoint(TRAINING, store)
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"half of it")
    fit, _, result = train(MODEL)
    assert fit.calls[0][1]["checkpoint"] == checkpoint
    assert result["resumed"] is True
    assert not checkpoint.exists()


def test_a_checkpoint_that_cannot_be_read_is_left_behind_once(train, store) -> None:
    unreadable = FileFormatError("a.checkpoint", "this is none")
    checkpoint = worker._checkpoint(TRAINING, store)
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"nonsense")
    fit, _, result = train(unreadable, MODEL)
    assert len(fit.calls) == 2
    assert result["resumed"] is False
    store.forget(TRAINING)
    fit, _, result = train(unreadable)  # without a checkpoint it is some other file, and no reason to begin again
    assert len(fit.calls) == 1
    assert result is None
    assert "this is none" in store.failure(TRAINING)


@pytest.mark.parametrize("ious", [None, ["iou_surface"]])
def test_a_scoring_covers_everything_in_its_spec(ious, store, monkeypatch) -> None:
    trained = {"stamp": "the first", "seconds": 1.0, "resumed": False, "steps": 5, "frames": 2, "wall_seconds": 1.0}
    store.write(TRAINING, trained)
    scores = {"poses": {}, "rows": {}, "controls": {}, "query_seconds": {}}
    evaluate = Called(SimpleNamespace(values=scores))
    load = Called("the model")
    monkeypatch.setattr("nilbs.models.evaluation.evaluate", evaluate)
    monkeypatch.setattr("nilbs.models.model.load_model", load)
    options = {
        "points": 7,
        "resolution": 9,
        "seed": 3,
        "poses": ["far"],
        "rows": ["nearest"],
        "noise": 0.5,
        "distances": True,
    }
    spec = {"training": TRAINING.key, "of": SPEC, **options} | ({} if ious is None else {"ious": ious})
    job = Job("arm/snarf/seed3/scores", "score", spec, TRAINING.key)
    assert do(job, store, None)
    assert load.calls == [((store.model(TRAINING.key),), {})]
    assert evaluate.calls == [(("the model",), {**options, "ious": ious or IOUS, "progress": True})]
    result = store.result(job)
    assert result["scores"] == scores
    assert result["trained"] == "the first"
