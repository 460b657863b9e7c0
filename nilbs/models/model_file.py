"""Models as files: one self-contained archive each, without pickle."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.fields.field import Field
from nilbs.fields.rest_state import CACHE, FORWARD, RestState, check_rest_state
from nilbs.fields.search import SearchField
from nilbs.geometry.validation import arrays
from nilbs.methods.building import build_field
from nilbs.methods.settings import UNTRAINED, Settings
from nilbs.models.model import Model, torch_device

KIND = "nilbs model 5"


def save_model(model: Model, path: str | Path) -> None:
    """Write a model to a file.

    Parameters
    ----------
    model : Model
    path : path

    Raises
    ------
    OSError
        If the file cannot be written; what was there before is kept.
    """
    from nilbs.io.archive import write_archive

    c, field = model.character, model.field
    contents = {f"field.{name}": tensor.cpu().numpy() for name, tensor in field.state_dict().items()}
    contents |= {f"character.{name}": array for name, array in c.arrays().items()}
    contents |= {f"motion.{name}": getattr(model.motion, name) for name in ("B", "frames", "times")}
    contents["history"] = model.history
    text: dict[str, Any] = {
        "name": c.name,
        "bones": list(c.skeleton.names),
        "motion": model.motion.source,
        "settings": asdict(model.settings),
    }
    if isinstance(field, SearchField):
        text["spacing"] = {CACHE: field.inverse.cache.spacing, FORWARD: field.forward_field.spacing}
    write_archive(path, contents, text, kind=KIND)


def load_model(path: str | Path, *, device: str = "cpu") -> Model:
    """Read a model file.

    Parameters
    ----------
    path : path
        What `Model.save` wrote.
    device : str
        Where the field goes; "auto" takes a GPU if there is one.

    Returns
    -------
    model : Model

    Raises
    ------
    FileFormatError
        If the file is not a model of this version, or was damaged.
    ValueError
        If torch has no such device.
    OSError
        If it cannot be opened.

    Examples
    --------
    >>> import tempfile
    >>> from nilbs.characters.capsule import capsule
    >>> from nilbs.models.fitting import fit
    >>> from nilbs.characters.motion import random_motion
    >>> character = capsule(d=2)
    >>> model = fit(character, random_motion(character, frames=2), method="nearest")
    >>> path = tempfile.mkdtemp() + "/bar.nilbs"
    >>> model.save(path)
    >>> load_model(path).settings.method
    'nearest'
    """
    from nilbs.io.archive import read_archive
    from nilbs.io.errors import FileFormatError

    contents, text = read_archive(path, kind=KIND)
    try:
        part = {name.removeprefix("character."): a for name, a in contents.items() if name.startswith("character.")}
        character = Character.of_arrays(part, name=str(text["name"]), bones=list(map(str, text["bones"])))
        moved = [contents[f"motion.{name}"] for name in ("B", "frames", "times")]
        motion = Motion(moved[0], moved[1], str(text["motion"]), moved[2], character.skeleton)
        settings = Settings.from_mapping(text["settings"])
        state = {name.removeprefix("field."): a for name, a in contents.items() if name.startswith("field.")}
        for name, array in state.items():
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"field.{name} has numbers that are not finite")
        field = _field(character, settings, state, text)
        arrays(history=(contents["history"], "s"))
        model = Model(character, motion, settings, contents["history"], field)
    except (KeyError, TypeError, ValueError, OverflowError, RuntimeError) as error:
        reason = " ".join(str(error).split())  # torch explains itself over several lines
        raise FileFormatError(path, f"is not a complete nilbs model: {reason}") from None
    return model.to(device=torch_device(device))


def _field(character: Character, settings: Settings, state: Mapping[str, np.ndarray], text: Mapping[str, Any]) -> Field:
    """The field that a state describes."""
    if settings.method not in UNTRAINED:
        # Before anything is made as large as the settings say: the file must hold it.
        if settings.width > max((max(a.shape, default=0) for a in state.values()), default=0):
            raise ValueError(f"no layer is as wide as the settings say, {settings.width}")
        if settings.depth > len(state):
            raise ValueError(f"there are fewer layers than the settings say, {settings.depth}")
        if settings.width**2 * (settings.depth - 2) > sum(a.size for a in state.values()):
            raise ValueError(f"it holds less than {settings.depth} layers of width {settings.width}")
    rest = None
    if settings.method == "nilbs":
        check_rest_state(state, character)
        spacing = {name: float(text["spacing"][name]) for name in (CACHE, FORWARD)}
        if not all(0 < edge < 1e9 for edge in spacing.values()):
            raise ValueError(f"cells of grids must have an edge above zero, got {spacing}")
        rest = RestState(state, spacing)
    field = build_field(character, settings, rest)
    precision = next((a.dtype for a in state.values() if a.dtype.kind == "f"), np.dtype(np.float32))
    field = field.to(torch.float64 if precision == np.float64 else torch.float32)
    field.load_state_dict({name: torch.from_numpy(a) for name, a in state.items()})
    return field
