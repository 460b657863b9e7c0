"""Bone maps: which bone of a character follows which bone of a motion, as JSON that a person can correct.

A map may also hold the options of the command line that decide how the motion is put on the character.
"""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

from nilbs.io.atomic import replacing
from nilbs.io.errors import FileFormatError
from nilbs.io.strict_json import read_json

# Options of a motion that a map may hold, and what they are.
OPTIONS = {"--rest-frame": int, "--up": str, "--forward": str}


def read_bone_map(path: str | os.PathLike) -> tuple[dict[str, str | None], dict[str, Any]]:
    """Read a bone map: one JSON object, a bone of the character to a bone of the motion, or to null, and `OPTIONS`.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/map.json"
    >>> write_bone_map(path, {"upperarm01.L": "UpArm_L", "jaw": None})
    >>> read_bone_map(path)
    ({'upperarm01.L': 'UpArm_L', 'jaw': None}, {})
    """
    found = read_json(path)
    if not isinstance(found, dict):
        raise FileFormatError(path, 'a bone map is one object such as {"bone of the character": "bone of the motion"}')
    options = {name: found.pop(name) for name in OPTIONS if name in found}
    for name, value in options.items():
        if type(value) is not OPTIONS[name]:
            kind = "a whole number" if OPTIONS[name] is int else 'an axis, such as "z"'
            raise FileFormatError(path, f"{name} must be {kind}, not {json.dumps(value)[:80]}")
    for name, led in found.items():
        if not (led is None or isinstance(led, str)):
            raise FileFormatError(path, f"{name[:80]!r} must follow a bone, by name, or null")
    return found, options


def write_bone_map(path: str | os.PathLike, bone_map: Mapping[str, str | None], names: Sequence[str] = ()) -> None:
    """Write a bone map, one bone a line; those of `names` that the map leaves out are written with null."""
    full = {**dict.fromkeys(names), **bone_map}
    with replacing(path, "w") as file:
        file.write(json.dumps(full, indent=2, ensure_ascii=True) + "\n")
