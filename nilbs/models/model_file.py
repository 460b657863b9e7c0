"""Models as files: one self-contained archive each, without pickle."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nilbs.characters.character import Character
from nilbs.characters.motion import Motion
from nilbs.engine.rest_state import RestState, from_version_6
from nilbs.geometry.validation import arrays
from nilbs.methods.base import Method
from nilbs.methods.registry import method_class, of_version_5, values_of
from nilbs.models.stored_curves import restored_curves, stored_curves

KIND, KIND_6, KIND_5 = "nilbs model 7", "nilbs model 6", "nilbs model 5"


class ModelParts(NamedTuple):
    """What a model file holds: all of a `nilbs.models.model.Model`."""

    character: Character
    motion: Motion
    method: Method
    history: np.ndarray
    parameters: Mapping[str, np.ndarray]
    rest: RestState


def write_model_file(path: str | Path, parts: ModelParts) -> None:
    """Write a model; the file appears whole or not at all."""
    from nilbs.io.archive import write_archive

    c, motion, method, history, parameters, rest = parts
    contents = {f"field.{name}": array for name, array in {**parameters, **rest.arrays}.items()}
    contents |= {f"character.{name}": array for name, array in c.arrays().items()}
    contents |= {f"motion.{name}": getattr(motion, name) for name in ("B", "frames", "times")}
    curves, curve_texts = stored_curves(motion.curves)
    contents |= {f"motion.curves.{name}": array for name, array in curves.items()}
    contents["history"] = history
    text = {
        "name": c.name,
        "bones": list(c.skeleton.names),
        "motion": motion.source,
        "clips": motion.clips,
        "curves": curve_texts,
        "method": method.name,
        "settings": values_of(method),
        **rest.header,
    }
    write_archive(path, contents, text, kind=KIND, compress=True)


def read_model_file(path: str | Path) -> ModelParts:
    """Read what `write_model_file` wrote, in this or the last version; FileFormatError for anything else."""
    from nilbs.io.archive import read_archive
    from nilbs.io.errors import FileFormatError

    contents, text = read_archive(path, kind=KIND, older=[KIND_6, KIND_5])
    try:
        part = {name.removeprefix("character."): a for name, a in contents.items() if name.startswith("character.")}
        character = Character.of_arrays(part, name=str(text["name"]), bones=list(map(str, text["bones"])))
        moved = [contents[f"motion.{name}"] for name in ("B", "frames", "times")]
        clips = tuple((str(name), int(start)) for name, start in text.get("clips", ()))
        stored = {name[14:]: array for name, array in contents.items() if name.startswith("motion.curves.")}
        curves = restored_curves(stored, text.get("curves", ()), character.skeleton)
        motion = Motion(moved[0], moved[1], str(text["motion"]), moved[2], character.skeleton, clips, curves)
        settings = text["settings"]
        if "forward" in settings:  # its name before
            settings["forward_map"] = settings.pop("forward")
        if settings.get("mapping") == "parts":  # before the default was the same
            settings["mapping"] = "search"
        if "method" not in text:
            method = of_version_5(settings)
        else:
            method = method_class(text["method"]).from_settings(settings)
            if set(settings) != set(values_of(method)):
                raise ValueError(f"settings are {sorted(settings)}, expected {sorted(values_of(method))}")
        state = {name.removeprefix("field."): a for name, a in contents.items() if name.startswith("field.")}
        for name, array in state.items():
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"field.{name} has numbers that are not finite")
        if any(name.startswith("inverse.cache.") for name in state):
            state, text = from_version_6(state, text, character)
        rest = RestState.of_state(state, text)
        parameters = {name: array for name, array in state.items() if name not in rest.arrays}
        method.check_state(character, parameters, rest)
        if method.trained and not rest.arrays:  # only torch has the shapes of its layers, and it answers anyway
            from nilbs.models.torch_field import field_of

            field_of(character, method, parameters, rest)
        arrays(history=(contents["history"], "s"))
        return ModelParts(character, motion, method, contents["history"], parameters, rest)
    except (LookupError, TypeError, ValueError, OverflowError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise FileFormatError(path, f"is not a complete nilbs model: {reason}") from None
