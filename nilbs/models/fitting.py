"""From a character and a motion to a trained model."""

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.characters.report import Report, silent
from nilbs.methods.base import Method, TrainedMethod
from nilbs.methods.registry import method_of, values_of
from nilbs.models.model import Model

if TYPE_CHECKING:
    import torch

    from nilbs.fields.field import Field
    from nilbs.fields.objective import Objective
    from nilbs.fields.training import TrainingState

CHECKPOINT_KIND = "nilbs checkpoint 4"
# Steps of the trial that measures a step, and the share of the time after which fewer must do.
TRIAL = 16
TRIAL_PART = 0.1
# That a time can have meant.
MOST_STEPS = 10**8


def fit(
    character: Character,
    motion: Motion,
    method: Method | str = "nilbs",
    *,
    device: str = "auto",
    dtype: "torch.dtype | None" = None,
    minutes: float | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: bool = False,
    report: Report | None = None,
    **settings: Any,
) -> Model:
    """Train a field on a character in motion.

    Parameters
    ----------
    character : Character
    motion : Motion
        Its frames are what the occupancy loss sees.
    method : Method or str
        How to make and train the field; a name takes its default settings.
    device : str
        "cpu", "cuda", ... or "auto".
    dtype : torch.dtype
        torch.float32, the default, or torch.float64.
    minutes : float, optional
        How long the steps may take together, instead of their number; a short trial measures how many will fit. The
        model's method then has that number, and a training with it gives the same model.
    checkpoint : path, optional
        Where the training is saved while it runs; `remove_checkpoint` removes it when the model is safe.
    resume : bool
        Whether to go on from the checkpoint, if there is one.
    progress : bool
        Show progress on standard error.
    report : function of str, optional
        Receives a line on where a continued training goes on.
    **settings
        Settings of the method by name, instead of its own: ``fit(character, motion, "nasa", steps=1000, seed=3)``.

    Returns
    -------
    model : Model

    Raises
    ------
    ValueError
        If the motion moves another number of bones, a setting is out of range, both steps and minutes are given,
        torch has no such device, or the checkpoint belongs to another training.
    FileFormatError
        If the checkpoint cannot be read.
    FloatingPointError
        If the loss is no number any more: the learning rate is too large.

    Examples
    --------
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.characters.motion import random_motion
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> model.occupancy([[0, -0.3], [9, 9]], model.motion[0]) > 0.5
    array([ True, False])
    """
    chosen = method_of(method, **settings)
    if not len(motion):
        raise ValueError("the motion has no frames")
    if minutes is not None and not (0 < minutes < float("inf") and getattr(chosen, "steps", None) is None):
        raise ValueError(f"minutes must be positive and stand without steps, got {minutes}")
    if motion.B.shape[1:] != (len(character.skeleton.BE), character.d + 1, character.d + 1):
        raise ValueError(
            f"the motion moves {motion.B.shape[1]} bones in {motion.B.shape[2] - 1} dimensions, "
            f"the character has {len(character.skeleton.BE)} in {character.d}"
        )
    resolved = chosen.resolved(character)
    report = report or silent
    trains = isinstance(resolved, TrainedMethod) and resolved.steps != 0
    # Before the work: what would fail only after it.
    if trains or dtype is not None or device not in ("auto", "cpu"):
        device, dtype = _place(device, dtype)
    # How long a training takes is no part of what it is.
    open_ended = replace(resolved, steps=None) if trains and minutes is not None else resolved  # type: ignore[call-arg]
    fingerprint = _fingerprint(character, motion, open_ended, dtype)
    state = None
    if checkpoint is not None and resume and (trains or Path(checkpoint).exists()):
        state = _load_checkpoint(Path(checkpoint), fingerprint, report)
    rest = resolved.rest(character)
    if not trains:
        no_network = "0 steps: the model has no network"
        report(no_network if resolved.trained else f"the method {resolved.name} learns nothing: there is no training")
        model = Model(character, motion, resolved, np.zeros(0), rest=rest)
        return model.to(device=None if device == "auto" else device, dtype=dtype)
    import torch

    from nilbs.fields.field import like
    from nilbs.fields.scene import Scene
    from nilbs.fields.training import train
    from nilbs.models.torch_field import parameters_of

    assert isinstance(resolved, TrainedMethod)
    with torch.random.fork_rng():  # networks draw from torch's own generator, which is the caller's
        torch.manual_seed(resolved.seed)
        field = resolved.field_around(character, rest).to(device=device, dtype=dtype)
    scene = Scene.of(character, motion, like(field), seed=resolved.seed, progress=progress)
    objective = resolved.objective(field, scene)
    assert resolved.steps is not None
    steps = resolved.steps
    if state is not None:
        steps = state.steps
    elif minutes is not None:
        report("measuring how long a step takes")
        steps = _steps_within(60 * minutes, field, objective, resolved.learning_rate)
        report(f"{steps} steps will take about {minutes:g} min")

    def save(state: "TrainingState") -> None:
        if checkpoint is not None:
            _save_checkpoint(Path(checkpoint), fingerprint, steps, state)

    history = train(
        field,
        objective,
        steps=steps,
        learning_rate=resolved.learning_rate,
        state=None if state is None else state.training,
        save=save,
        save_every=objective.memory,
        progress=progress,
    )
    model = Model(character, motion, replace(resolved, steps=steps), history, parameters_of(field), rest)
    return model.to(device=device, dtype=dtype)


def _place(device: str, dtype: "torch.dtype | None") -> "tuple[str, torch.dtype]":
    """Device and precision of a training, checked."""
    import torch

    from nilbs.models.torch_field import torch_device

    if dtype not in (None, torch.float32, torch.float64):
        raise ValueError(f"dtype must be torch.float32 or torch.float64, got {dtype}")
    return torch_device(device), torch.float32 if dtype is None else dtype


def remove_checkpoint(path: str | Path) -> None:
    """Remove the checkpoint of a training whose model is safe."""
    with suppress(FileNotFoundError):
        Path(path).unlink()


@dataclass(frozen=True)
class _Checkpoint:
    steps: int  # of the whole training
    training: "TrainingState"


def _steps_within(seconds: float, field: "Field", objective: "Objective", learning_rate: float) -> int:
    """How many steps fit into a time, by a trial that leaves the field as it was."""
    from nilbs.fields.training import train

    initial = {name: tensor.clone() for name, tensor in field.state_dict().items()}
    start = perf_counter()
    count = 1
    while True:  # the first steps of a process are slow
        began = perf_counter()
        train(field, objective, steps=count, learning_rate=learning_rate)
        now = perf_counter()
        step = (now - began) / count
        if count >= TRIAL or (count > 1 and now - start > TRIAL_PART * seconds):
            break
        count *= 2
    refresh = 0.0
    if objective.memory > 1:
        objective(objective.memory)
        refresh = perf_counter() - now - step
    field.load_state_dict(initial)
    steps = seconds / (step + refresh / objective.memory)
    if not steps < MOST_STEPS:
        raise ValueError(f"minutes are {seconds / 60:g}, enough for {steps:.1g} steps; {MOST_STEPS:g} are the most")
    return max(1, int(steps))


def _fingerprint(character: Character, motion: Motion, method: Method, dtype: "torch.dtype | None") -> str:
    """What a checkpoint belongs to: everything that the training depends on."""
    digest = hashlib.sha256(json.dumps([method.name, values_of(method), str(dtype)], sort_keys=True).encode())
    for array in (*character.arrays().values(), motion.B):
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _save_checkpoint(path: Path, fingerprint: str, steps: int, state: "TrainingState") -> None:
    from nilbs.io.archive import write_archive

    settings = {"step": state.step, "steps": steps, "fingerprint": fingerprint}
    write_archive(path, {**state.tensors, "history": state.history}, settings, kind=CHECKPOINT_KIND)


def _load_checkpoint(path: Path, fingerprint: str, report: Report) -> _Checkpoint | None:
    from nilbs.fields.training import TrainingState
    from nilbs.io.archive import read_archive
    from nilbs.io.errors import FileFormatError

    if not path.exists():
        report(f"no checkpoint {path}: training starts at step 0")
        return None
    try:
        tensors, settings = read_archive(path, kind=CHECKPOINT_KIND)
    except FileFormatError as error:
        raise FileFormatError(path, f"{error.message}: remove it to start anew") from None
    if settings.get("fingerprint") != fingerprint:
        raise FileFormatError(
            path, "belongs to a training with other files or settings: go on with those, or remove it to start anew"
        )
    history = tensors.pop("history", np.zeros(0))
    step, steps = settings.get("step"), settings.get("steps")
    if not (type(step) is type(steps) is int and 0 <= step <= steps <= MOST_STEPS and history.shape == (step,)):
        raise FileFormatError(path, "its numbers of steps do not fit: remove it to start anew")
    report(f"continuing at step {step} of {steps}")
    return _Checkpoint(steps, TrainingState(step, tensors, history))
