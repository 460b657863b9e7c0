"""From a character and a motion to a trained model."""

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nilbs.character import Character
from nilbs.fields.forward import packed_weights
from nilbs.fields.nilbs import NilbsField
from nilbs.fields.objective import REFRESH, NilbsObjective, RandomPoses
from nilbs.fields.samples import OccupancySamples, RestSamples, occupancy_samples, surface_samples, volume_samples
from nilbs.fields.search import SearchField
from nilbs.fields.training import TrainingState, train
from nilbs.geometry.grids import Grid
from nilbs.geometry.rest_grids import distance_grid, weight_grid
from nilbs.model import CACHE, FORWARD, Model, blank_field, in_unit_frame, rest_center, torch_device
from nilbs.motion import Motion
from nilbs.report import Report, silent
from nilbs.settings import Settings

CHECKPOINT_KIND = "nilbs checkpoint 1"
# In units of L: how far around the body rest weights are known, and how far they go on beyond the skin unbroken.
BAND, DEPTH = 0.05, 0.015


def fit(
    character: Character,
    motion: Motion,
    settings: Settings | None = None,
    *,
    device: str = "auto",
    dtype: torch.dtype = torch.float32,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: bool = False,
    report: Report | None = None,
    **changes: Any,
) -> Model:
    """Train a field on a character in motion.

    Parameters
    ----------
    character : Character
    motion : Motion
        Its frames are what the occupancy loss sees.
    settings : Settings, optional
        How to train.
    device : str
        "cpu", "cuda", ... or "auto".
    dtype : torch.dtype
        torch.float32 or torch.float64.
    checkpoint : path, optional
        Where the training is saved while it runs; `remove_checkpoint` removes it when the model is safe.
    resume : bool
        Whether to go on from the checkpoint, if there is one.
    progress : bool
        Show progress on standard error.
    report : function of str, optional
        Receives a line on where a continued training goes on.
    **changes
        Settings by name, in place of those given: ``fit(character, motion, steps=1000, seed=3)``.

    Returns
    -------
    model : Model

    Raises
    ------
    ValueError
        If the motion moves another number of bones, a setting is out of range, or the checkpoint belongs to another
        training.
    FileFormatError
        If the checkpoint cannot be read.
    """
    settings = replace(settings or Settings(), **changes).resolved(bones=len(character.BE), d=character.d)
    report = report or silent
    if motion.B.shape[1:] != (len(character.BE), character.d + 1, character.d + 1):
        raise ValueError(
            f"the motion moves {motion.B.shape[1]} bones in {motion.B.shape[2] - 1} dimensions, "
            f"the character has {len(character.BE)} in {character.d}"
        )
    state = None
    fingerprint = _fingerprint(character, motion, settings, dtype)
    if checkpoint is not None and resume:
        state = _load_checkpoint(Path(checkpoint), fingerprint, report)
    torch.manual_seed(settings.seed)
    field = _untrained(character, settings, dtype).to(torch_device(device))
    # Look-ups take the most of a step's time, and the network does not learn to a cell's width.
    learning = NilbsField(field.inverse.network, field.inverse.cache.coarser(), root=field.inverse.root)
    objective = _objective(learning, character, motion, settings, progress=progress)

    def save(state: TrainingState) -> None:
        if checkpoint is not None:
            _save_checkpoint(Path(checkpoint), fingerprint, state)

    history = train(
        field.inverse.network,
        objective,
        steps=settings.steps,
        learning_rate=settings.learning_rate,
        state=state,
        save=save,
        save_every=REFRESH,
        progress=progress,
    )
    return Model(character, motion, settings, history, field)


def remove_checkpoint(path: str | Path) -> None:
    """Remove the checkpoint of a training whose model is safe."""
    with suppress(FileNotFoundError):
        Path(path).unlink()


def _untrained(character: Character, settings: Settings, dtype: torch.dtype) -> SearchField:
    """A field with its grids of the rest pose, which know nothing of training."""
    c = character
    V, V_volume = ((points - rest_center(c)) / c.L for points in (c.V, c.V_volume))
    kind = np.float64 if dtype == torch.float64 else np.float32
    cache = Grid.box(V, settings.cache_resolution)
    weights = Grid.box(V, settings.weight_resolution, pad=BAND)
    node, W_node = weight_grid(V, c.F, c.W, V_volume, c.T, c.W_volume, weights, band=BAND, depth=DEPTH)
    packed = packed_weights(node, W_node, weights.shape)
    state = {
        f"{CACHE}.values": distance_grid(V, c.F, cache).astype(kind),
        f"{CACHE}.origin": cache.origin.astype(kind),
        **{f"{FORWARD}.{name}": array for name, array in packed.items()},
        f"{FORWARD}.weight": packed["weight"].astype(kind),
        f"{FORWARD}.origin": weights.origin.astype(kind),
    }
    return blank_field(character, settings, state, {CACHE: cache.spacing, FORWARD: weights.spacing})


def _objective(
    field: NilbsField, character: Character, motion: Motion, settings: Settings, *, progress: bool
) -> NilbsObjective:
    from tqdm import tqdm

    paper = settings.supervision == "paper"
    center, L = rest_center(character), character.L
    V, V_volume, C = ((points - center) / L for points in (character.V, character.V_volume, character.C))
    _, B = in_unit_frame(character, np.zeros((len(motion), 1, character.d)), motion.B)
    rng = np.random.default_rng([settings.seed, settings.steps])
    frames: Iterable[np.ndarray] = tqdm(B, desc="labelling", unit="frame", disable=not progress, delay=2)
    labelled: OccupancySamples = occupancy_samples(
        V,
        character.F,
        character.W,
        frames,
        n=settings.samples_per_frame,
        noise=None if paper else settings.noise,
        rng=rng,
    )
    rest: RestSamples
    if paper:
        rest, random_poses = surface_samples(V, character.W), None
    else:
        rest = volume_samples(
            V,
            character.F,
            character.W,
            V_volume,
            character.T,
            character.W_volume,
            n=200_000,
            shell=settings.shell,
            rng=rng,
        )
        random_poses = RandomPoses(C, character.BE, character.P, settings.random_pose_std)
    return NilbsObjective(
        field,
        B,
        labelled,
        rest,
        random_poses=random_poses,
        poses_per_step=settings.poses_per_step,
        points_per_pose=settings.points_per_pose,
        weight_loss=settings.weight_loss,
        position_loss=0.0 if paper else settings.position_loss,
        adaptive=not paper,
        seed=settings.seed,
    )


def _fingerprint(character: Character, motion: Motion, settings: Settings, dtype: torch.dtype) -> str:
    """What a checkpoint belongs to: everything that the training depends on."""
    c = character
    digest = hashlib.sha256(json.dumps([asdict(settings), str(dtype)], sort_keys=True).encode())
    for array in (c.V, c.F, c.W, c.C, c.BE, c.P, c.V_volume, c.T, c.W_volume, motion.B):
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _save_checkpoint(path: Path, fingerprint: str, state: TrainingState) -> None:
    from nilbs.io.archive import write_archive

    settings = {"step": state.step, "fingerprint": fingerprint}
    write_archive(path, {**state.tensors, "history": state.history}, settings, kind=CHECKPOINT_KIND)


def _load_checkpoint(path: Path, fingerprint: str, report: Report) -> TrainingState | None:
    from nilbs.io.archive import read_archive
    from nilbs.io.errors import FileFormatError

    if not path.exists():
        report(f"no checkpoint {path}: training starts at step 0")
        return None
    tensors, settings = read_archive(path, kind=CHECKPOINT_KIND)
    if settings.get("fingerprint") != fingerprint:
        raise FileFormatError(
            path, "belongs to a training with other files or settings; train without --resume to start again"
        )
    history = tensors.pop("history")
    report(f"continuing at step {settings['step']}")
    return TrainingState(int(settings["step"]), tensors, history)
