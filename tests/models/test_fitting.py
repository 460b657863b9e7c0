import itertools
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nilbs.app.main import main
from nilbs.characters.character import Character, assemble
from nilbs.characters.motion import Motion, random_motion
from nilbs.fields.objective import Objective
from nilbs.geometry.skeleton import Skeleton
from nilbs.io.archive import read_archive, write_archive
from nilbs.io.errors import FileFormatError
from nilbs.io.mesh import write_mesh
from nilbs.io.tgf import write_tgf
from nilbs.io.weights import write_weights
from nilbs.methods.mlp import Mlp
from nilbs.methods.nilbs import Nilbs
from nilbs.models.fitting import CHECKPOINT_KIND, fit, remove_checkpoint
from nilbs.models.model import Model, load_model

V, E = np.array([[0, 0], [2, 0], [2, 0.6], [0, 0.6]]), np.array([[0, 1, 2], [0, 2, 3]])
C, BE = np.array([[0.2, 0.3], [1, 0.3], [1.8, 0.3]]), np.array([[0, 1], [1, 2]])
BONES = Skeleton(C, BE, [-1, 0], ("bone0", "bone1"))
W = np.array([[1, 0], [0, 1], [0, 1], [1, 0.0]])
SIZES = {
    "width": 8,
    "depth": 3,
    "poses_per_step": 2,
    "points_per_pose": 32,
    "samples_per_frame": 100,
    "cache_resolution": 16,
    "weight_resolution": 16,
}
TINY = Nilbs(steps=20, learning_rate=0.01, occupancy_loss=1.0, **SIZES)
MLP = Mlp(steps=20, **{name: size for name, size in SIZES.items() if "resolution" not in name})
# Steps between two refreshes of the errors, after which a training may be continued.
REFRESH = 5


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """The order of sums, and so the last digits, depend on the number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nilbs.fields.objective.REFRESH", REFRESH)


@pytest.fixture(scope="module")
def bar() -> tuple[Character, Motion]:
    character = assemble(V, E, BONES, W, name="bar")
    return character, random_motion(character, frames=4)


def assert_same(model: Model, other: Model) -> None:
    np.testing.assert_array_equal(model.history, other.history)
    for (name, a), (_, b) in zip(model.field.state_dict().items(), other.field.state_dict().items(), strict=True):
        assert torch.equal(a, b), name


def watched(monkeypatch: pytest.MonkeyPatch, *, interrupt_at: int | None = None) -> list[int]:
    """The steps that a training makes; it can be interrupted when it comes to one."""
    loss, steps = Objective.__call__, []

    def watching(self: Objective, step: int) -> torch.Tensor:
        if step == interrupt_at:
            raise KeyboardInterrupt
        steps.append(step)
        return loss(self, step)

    monkeypatch.setattr(Objective, "__call__", watching)
    return steps


def test_the_same_seed_gives_the_same_model(bar) -> None:
    model = fit(*bar, TINY)
    assert model.history.shape == (20,)
    assert np.isfinite(model.history).all()
    assert model.method == TINY
    assert model.character is bar[0]
    assert model.motion is bar[1]
    assert_same(fit(*bar, TINY), model)
    other = fit(*bar, TINY, seed=1)
    assert other.method.seed == 1
    assert other.history[0] != model.history[0]


def test_more_steps_fit_better(bar) -> None:
    history = fit(*bar, TINY, steps=300, width=32, learning_rate=0.01).history
    assert history[-30:].mean() < 0.8 * history[:30].mean()


def test_the_paper_s_own_supervision(bar) -> None:
    model = fit(*bar, "paper", steps=20, **SIZES)
    assert model.config["method"] == "paper"
    assert model.history[0] != fit(*bar, TINY).history[0]


def test_double_precision(bar) -> None:
    model = fit(*bar, TINY, dtype=torch.float64)
    tensors = model.field.state_dict().values()
    assert {tensor.dtype for tensor in tensors if tensor.is_floating_point()} == {torch.float64}


@pytest.mark.parametrize("dtype", [torch.float16, torch.int32])
def test_another_precision_is_refused(bar, dtype: torch.dtype) -> None:
    with pytest.raises(ValueError, match=rf"float64, got {dtype}$"):
        fit(*bar, TINY, dtype=dtype)


def test_a_motion_of_another_rig_is_refused(bar, characters) -> None:
    character, motion = bar
    for other, said in (
        (characters[2], r"^the motion moves 13 bones in 2 dimensions, the character has 2 in 2$"),
        (characters[3], r"^the motion moves 3 bones in 3 dimensions, the character has 2 in 2$"),
    ):
        with pytest.raises(ValueError, match=said):
            fit(character, random_motion(other, frames=2), TINY)
    with pytest.raises(ValueError, match=r"^steps .* -1$"):
        fit(character, motion, TINY, steps=-1)


def test_a_training_is_as_long_as_its_rig_asks_for(characters, monkeypatch) -> None:
    monkeypatch.setattr("nilbs.fields.training.train", lambda *args, steps, **options: np.zeros(steps))
    for d, bones in ((2, 13), (3, 3)):
        motion = random_motion(characters[d], frames=2)
        model = fit(characters[d], motion, MLP, steps=None)
        assert model.method.steps == len(model.history) == 1000 + 100 * bones
        assert fit(characters[d], motion, TINY, steps=None).method.steps == 2000


@pytest.mark.parametrize(("stop", "step"), [(REFRESH, REFRESH), (14, 10)])
def test_an_interrupted_training_goes_on_to_the_same_end(
    stop: int, step: int, bar, tmp_path: Path, monkeypatch
) -> None:
    whole, path = fit(*bar, TINY), tmp_path / "a.checkpoint"
    with monkeypatch.context() as patch:
        watched(patch, interrupt_at=stop)
        with pytest.raises(KeyboardInterrupt):
            fit(*bar, TINY, checkpoint=path)
    lines: list[str] = []
    with monkeypatch.context() as patch:
        steps = watched(patch)
        assert_same(fit(*bar, TINY, checkpoint=path, resume=True, report=lines.append), whole)
    assert steps == list(range(step, 20))
    assert lines == [f"continuing at step {step} of 20"]
    # Without asking for it, the checkpoint is left aside.
    lines.clear()
    assert_same(fit(*bar, TINY, checkpoint=path, report=lines.append), whole)
    assert not lines


@pytest.mark.parametrize("method", [MLP, replace(TINY, adaptive=False)])
def test_what_never_looks_at_its_points_goes_on_from_any_second(method, bar, tmp_path: Path, monkeypatch) -> None:
    whole, path = fit(*bar, method), tmp_path / "a.checkpoint"
    with monkeypatch.context() as patch:
        seconds = itertools.count(step=2)
        patch.setattr("nilbs.fields.training.monotonic", lambda: next(seconds))
        watched(patch, interrupt_at=7)
        with pytest.raises(KeyboardInterrupt):
            fit(*bar, method, checkpoint=path)
    steps = watched(monkeypatch)
    assert_same(fit(*bar, method, checkpoint=path, resume=True), whole)
    assert steps == list(range(7, 20))


def test_nothing_is_saved_before_a_training_can_be_continued(bar, tmp_path: Path, monkeypatch) -> None:
    watched(monkeypatch, interrupt_at=REFRESH - 1)
    with pytest.raises(KeyboardInterrupt):
        fit(*bar, TINY, checkpoint=tmp_path / "a.checkpoint")
    assert not list(tmp_path.iterdir())


def test_without_a_checkpoint_the_training_starts_and_says_so(bar, tmp_path: Path) -> None:
    lines: list[str] = []
    model = fit(*bar, TINY, checkpoint=tmp_path / "none", resume=True, report=lines.append)
    assert_same(model, fit(*bar, TINY))
    assert lines == [f"no checkpoint {tmp_path / 'none'}: training starts at step 0"]
    assert not list(tmp_path.iterdir())


def test_the_checkpoint_of_another_training_is_refused(bar, tmp_path: Path, monkeypatch) -> None:
    character, motion = bar
    path = tmp_path / "a.checkpoint"
    with monkeypatch.context() as patch:
        watched(patch, interrupt_at=REFRESH)
        with pytest.raises(KeyboardInterrupt):
            fit(character, motion, TINY, checkpoint=path)
    other = assemble(V, E, BONES, W[:, ::-1], name="bar")
    for given in (
        (character, motion, replace(TINY, seed=1)),
        (character, random_motion(character, frames=4, seed=1), TINY),
        (other, motion, TINY),
    ):
        with pytest.raises(FileFormatError, match=r"a\.checkpoint: belongs to a training with other files or settings"):
            fit(*given, checkpoint=path, resume=True)
    with pytest.raises(FileFormatError, match="belongs to a training with other files or settings"):
        fit(character, motion, TINY, checkpoint=path, resume=True, dtype=torch.float64)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FileFormatError, match=r"a\.checkpoint: .*: remove it to start anew$"):
        fit(character, motion, TINY, checkpoint=path, resume=True)


def test_removing_a_checkpoint_that_may_not_be_there(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    path.write_bytes(b"")
    remove_checkpoint(path)
    remove_checkpoint(path)
    assert not path.exists()


# The command as it is, but for a training small enough for a test, saved wherever it can be, and slow to be killed.
SLOWLY = f"""
import functools, sys, time
import torch
import nilbs.fields.objective
import nilbs.fields.training
from nilbs.app.main import main
from nilbs.fields.objective import Objective

nilbs.fields.objective.REFRESH = {REFRESH}
torch.set_num_threads(1)
loss = Objective.__call__
Objective.__call__ = lambda self, step: (time.sleep(0.05), loss(self, step))[1]
nilbs.fields.training.train = functools.partial(nilbs.fields.training.train, save_seconds=0.0)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill a process on the spot")
def test_a_training_killed_half_way_and_resumed_ends_at_the_same_loss(tmp_path: Path, monkeypatch, capsys) -> None:
    steps = 60
    write_mesh(tmp_path / "bar.obj", V, E)
    write_tgf(tmp_path / "bar.tgf", np.pad(C, ((0, 0), (0, 1))), BE)
    write_weights(tmp_path / "bar.npz", W)

    def command(name: str) -> list[str]:
        files = [str(tmp_path / file) for file in ("bar.obj", "bar.tgf")]
        options = ["--weights", str(tmp_path / "bar.npz"), "--frames", "4", "--steps", str(steps), "--device", "cpu"]
        options += [word for name, size in SIZES.items() for word in (f"--{name.replace('_', '-')}", str(size))]
        return ["train", *files, *options, "-o", str(tmp_path / name), "--json"]

    killed = subprocess.Popen([sys.executable, "-c", SLOWLY, *command("killed.nilbs")], stderr=subprocess.DEVNULL)
    checkpoint = tmp_path / "killed.nilbs.checkpoint"
    while killed.poll() is None and steps_done(checkpoint) < steps // 3:
        time.sleep(0.02)
    killed.kill()
    assert killed.wait() == -signal.SIGKILL
    assert steps // 3 <= steps_done(checkpoint) < steps
    assert not (tmp_path / "killed.nilbs").exists()
    losses = []
    for arguments in (command("whole.nilbs"), [*command("killed.nilbs"), "--resume"]):
        assert main(arguments) == 0
        out, err = capsys.readouterr()
        losses.append(json.loads(out)["loss"])
    assert "continuing at step" in err
    assert losses[1] == pytest.approx(losses[0], rel=1e-6)
    histories = [load_model(tmp_path / name).history for name in ("whole.nilbs", "killed.nilbs")]
    np.testing.assert_allclose(histories[1], histories[0], rtol=1e-6)
    assert not checkpoint.exists()


def steps_done(checkpoint: Path) -> int:
    return read_archive(checkpoint, kind=CHECKPOINT_KIND)[1]["step"] if checkpoint.exists() else 0


def test_minutes_are_turned_into_steps_and_leave_the_model_as_steps_would(bar) -> None:
    character, motion = bar
    said = []
    timed = fit(character, motion, TINY, steps=None, device="cpu", minutes=0.005, report=said.append)
    steps = timed.method.steps
    assert len(timed.history) == steps > 0
    assert said == ["measuring how long a step takes", f"{steps} steps will take about 0.005 min"]
    counted = fit(character, motion, TINY, steps=steps, device="cpu")
    np.testing.assert_array_equal(timed.history, counted.history)
    assert timed.method == counted.method


@pytest.mark.parametrize(("minutes", "steps"), [(0.0, None), (-1.0, None), (1.0, 20), (float("inf"), None)])
def test_minutes_are_positive_and_stand_alone(minutes: float, steps: int | None, bar) -> None:
    with pytest.raises(ValueError, match=r"^minutes .* got"):
        fit(*bar, TINY, steps=steps, device="cpu", minutes=minutes)


def test_frames_may_lie_in_memory_in_any_order(bar) -> None:
    character, motion = bar
    backwards, copy = motion.B[::-1], motion.B[::-1].copy()
    copy.flags.writeable = False
    losses = [fit(character, replace(motion, B=B), MLP, steps=2, device="cpu").history for B in (backwards, copy)]
    np.testing.assert_array_equal(*losses)


def test_a_method_that_learns_nothing_takes_no_minutes(bar) -> None:
    assert not len(fit(*bar, "nearest", device="cpu", minutes=1).history)


def test_a_training_by_minutes_goes_on_to_the_steps_it_began_with(bar, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.checkpoint"
    options = {"device": "cpu", "checkpoint": path}
    with monkeypatch.context() as patch:
        watched(patch, interrupt_at=40)  # after the trial
        with pytest.raises(KeyboardInterrupt):
            fit(*bar, TINY, steps=None, minutes=0.05, **options)
    steps = read_archive(path, kind=CHECKPOINT_KIND)[1]["steps"]
    assert steps > 40
    resumed = fit(*bar, TINY, steps=None, minutes=0.05, resume=True, **options)
    assert_same(resumed, fit(*bar, TINY, steps=steps))


def test_the_trial_of_a_slow_training_is_short(bar, monkeypatch) -> None:
    clock = itertools.count()

    def slow(field, loss, *, steps: int, **options) -> np.ndarray:
        asked.append(steps)
        for _ in range(9 * steps - 1):
            next(clock)
        return np.zeros(steps)

    asked: list[int] = []
    monkeypatch.setattr("nilbs.models.fitting.perf_counter", lambda: float(next(clock)))
    monkeypatch.setattr("nilbs.fields.training.train", slow)
    # A step takes 9 s: after three there is little left of a tenth of the 300.
    steps = fit(*bar, replace(MLP, steps=None), minutes=5).method.steps
    assert asked == [1, 2, 4, steps]
    assert steps == 300 // 9


def test_more_minutes_than_anyone_can_mean_are_refused(bar) -> None:
    with pytest.raises(ValueError, match=r"^minutes are 1e\+08, enough for .* steps; 1e\+08 are the most$"):
        fit(*bar, TINY, steps=None, device="cpu", minutes=1e8)


def test_a_motion_without_frames_is_refused(bar) -> None:
    character, motion = bar
    nothing = replace(motion, B=motion.B[:0], frames=motion.frames[:0], times=motion.times[:0])
    with pytest.raises(ValueError, match=r"^the motion has no frames$"):
        fit(character, nothing, TINY, device="cpu")


def test_what_learns_nothing_says_so(bar) -> None:
    said: list[str] = []
    fit(*bar, "nearest", device="cpu", report=said.append)
    assert said == ["the method nearest learns nothing: there is no training"]


def test_without_steps_there_is_no_network(bar, tmp_path: Path) -> None:
    said: list[str] = []
    model = fit(*bar, TINY, steps=0, report=said.append)
    assert said == ["0 steps: the model has no network"]
    assert (model.method.steps, len(model.history), dict(model.parameters)) == (0, 0, {})
    trained = fit(*bar, TINY)
    for name, array in trained.rest.arrays.items():
        np.testing.assert_array_equal(model.rest.arrays[name], array)
    x, pose = bar[0].V + 0.01, bar[1][2]
    # The default search needs no network, and is the same with one.
    for answer in ("occupancy", "distance", "posed_distance", "rest_points", "posed_points"):
        np.testing.assert_array_equal(getattr(model, answer)(x, pose), getattr(trained, answer)(x, pose))
    assert model.occupancy(x, pose, mapping="all-bones").shape == (4,)
    for mapping in ("one-search", "fixed-point", "inverse", "reverse"):
        with pytest.raises(
            ValueError, match=f"^the mapping '{mapping}' needs a network, and with 0 steps there is none$"
        ):
            model.occupancy(x, pose, mapping=mapping)
    with pytest.raises(ValueError, match=r"^training had 0 steps: there is no network$"):
        model.weights(x, pose)
    model.save(tmp_path / "grids.nilbs")
    again = load_model(tmp_path / "grids.nilbs")
    assert again.method == model.method
    np.testing.assert_array_equal(again.occupancy(x, pose), model.occupancy(x, pose))


@pytest.mark.parametrize("method", ["paper", replace(TINY, mapping="inverse")])
def test_a_model_whose_own_mapping_needs_a_network_has_one(method, bar) -> None:
    with pytest.raises(ValueError, match=r"^the mapping 'inverse' needs a network, and with 0 steps there is none$"):
        fit(*bar, method, steps=0)
    assert fit(*bar, method, steps=0, mapping="search").method.mapping == "search"


@pytest.mark.parametrize("method", ["nasa", "snarf", "mlp"])
def test_what_is_a_network_alone_has_steps(method: str, bar) -> None:
    with pytest.raises(ValueError, match=r"^steps must lie between 1 and 1e\+09, got 0$"):
        fit(*bar, method, steps=0)


@pytest.mark.parametrize("method", [TINY, "nearest"])
def test_device_and_precision_are_checked_before_the_work(method, bar, monkeypatch) -> None:
    monkeypatch.setattr("nilbs.methods.nilbs.Nilbs.rest", lambda self, character: pytest.fail("the work began"))
    settings = {} if method == "nearest" else {"steps": 0}
    for changes in ({}, settings):
        with pytest.raises(ValueError, match=r"^torch cannot use the device 'abacus'"):
            fit(*bar, method, device="abacus", **changes)
        with pytest.raises(ValueError, match=r"^dtype must be"):
            fit(*bar, method, dtype=torch.float16, **changes)


def test_without_steps_too_precision_is_what_was_asked_for(bar) -> None:
    model = fit(*bar, TINY, steps=0, dtype=torch.float64)
    assert model.occupancy(bar[0].V, bar[1][0]).dtype == np.float64
    assert model.engine() is None


@pytest.mark.parametrize(("method", "changes"), [(TINY, {"steps": 0}), ("nearest", {})])
def test_what_does_not_train_leaves_the_checkpoint_of_another_training(
    method, changes: dict, bar, tmp_path: Path, monkeypatch
) -> None:
    path = tmp_path / "a.checkpoint"
    with monkeypatch.context() as patch:
        watched(patch, interrupt_at=REFRESH)
        with pytest.raises(KeyboardInterrupt):
            fit(*bar, TINY, checkpoint=path)
    with pytest.raises(FileFormatError, match="belongs to a training with other files or settings"):
        fit(*bar, method, checkpoint=path, resume=True, **changes)
    assert path.exists()


@pytest.mark.parametrize(
    "change", [{"step": None}, {"steps": "many"}, {"step": -1}, {"step": 3}, {"steps": 1}, {"steps": 10**30}]
)
def test_a_checkpoint_whose_steps_do_not_fit_is_refused(change: dict, bar, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.checkpoint"
    with monkeypatch.context() as patch:
        watched(patch, interrupt_at=REFRESH)
        with pytest.raises(KeyboardInterrupt):
            fit(*bar, TINY, device="cpu", checkpoint=path)
    tensors, settings = read_archive(path, kind=CHECKPOINT_KIND)
    write_archive(path, tensors, settings | change, kind=CHECKPOINT_KIND)
    with pytest.raises(FileFormatError, match="its numbers of steps do not fit: remove it to start anew"):
        fit(*bar, TINY, device="cpu", checkpoint=path, resume=True)


def test_the_callers_random_numbers_are_left_alone(bar) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    fit(*bar, TINY, steps=1, device="cpu")
    assert torch.equal(torch.rand(3), expected)
