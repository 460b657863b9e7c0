"""Bone maps: which bone of a character follows which bone of a motion, as JSON that a person can correct."""

import json
import os
from collections.abc import Mapping, Sequence

from nilbs.io.atomic import replacing
from nilbs.io.errors import FileFormatError
from nilbs.io.strict_json import read_json


def read_bone_map(path: str | os.PathLike) -> dict[str, str | None]:
    """Read a bone map.

    Parameters
    ----------
    path : str or path
        One JSON object: for bones of the character, by name, the name of the bone of the motion that they follow, or
        null for none. Bones left out follow none.

    Returns
    -------
    bone_map : dict of str to str or None

    Raises
    ------
    FileFormatError
        If the file is anything else.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/map.json"
    >>> write_bone_map(path, {"upperarm01.L": "UpArm_L", "jaw": None})
    >>> read_bone_map(path)
    {'upperarm01.L': 'UpArm_L', 'jaw': None}
    """
    found = read_json(path)
    if not isinstance(found, dict):
        raise FileFormatError(path, 'a bone map is one object such as {"bone of the character": "bone of the motion"}')
    for name, led in found.items():
        if not (led is None or isinstance(led, str)):
            raise FileFormatError(path, f"{name[:80]!r} must follow a bone, by name, or null")
    return found


def write_bone_map(path: str | os.PathLike, bone_map: Mapping[str, str | None], names: Sequence[str] = ()) -> None:
    """Write a bone map, one bone a line.

    Parameters
    ----------
    path : str or path
    bone_map : mapping of str to str or None
    names : sequence of str, optional
        All bones of the character: those that the map leaves out are written with null, so that nobody need look up
        their names to correct the file.

    Raises
    ------
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> path = tempfile.mkdtemp() + "/map.json"
    >>> write_bone_map(path, {"head": "Head"}, ("head", "jaw"))
    >>> with open(path) as file:
    ...     print(file.read().strip())
    {
      "head": "Head",
      "jaw": null
    }
    """
    full = {**dict.fromkeys(names), **bone_map}
    with replacing(path, "w") as file:
        file.write(json.dumps(full, indent=2, ensure_ascii=True) + "\n")
