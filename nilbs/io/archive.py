"""Named arrays and settings in one file without pickle: safetensors, with a digest that shows a flipped byte."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nilbs.io.atomic import replacing
from nilbs.io.bounded import file_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.strict_json import parse_json

KINDS = {np.dtype(kind) for kind in ("float32", "float64", "int16", "int32", "int64", "bool")}


def write_archive(
    path: str | Path, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any], *, kind: str
) -> None:
    """Write arrays (float32, float64, int16, int32, int64, bool) and settings; the file appears whole or not at all.

    `kind` names the content, for example "nilbs model 1"; `read_archive` expects the same.

    Examples
    --------
    >>> import tempfile, os
    >>> path = os.path.join(tempfile.mkdtemp(), "a.bin")
    >>> write_archive(path, {"x": np.arange(3.0)}, {"seed": 7}, kind="example 1")
    >>> read_archive(path, kind="example 1")
    ({'x': array([0., 1., 2.])}, {'seed': 7})
    """
    from safetensors.numpy import save

    for name, array in arrays.items():
        if array.dtype not in KINDS:
            raise ValueError(f"{name} has type {array.dtype}; an archive holds {sorted(map(str, KINDS))}")
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    text = json.dumps(dict(settings), sort_keys=True, allow_nan=False)
    metadata = {"kind": kind, "settings": text, "digest": _digest(contiguous, kind, text)}
    with replacing(path) as file:
        file.write(save(contiguous, metadata))


def read_archive(
    path: str | Path, *, kind: str, older: Sequence[str] = ()
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and settings that `write_archive` wrote.

    `older` are kinds of earlier versions that are read too; another kind, or a damaged file, is a FileFormatError.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    data = file_bytes(path)
    what = kind.rsplit(" ", 1)[0]
    try:
        # The header is a little-endian length and then JSON; safetensors.numpy does not hand out its metadata.
        length = int.from_bytes(data[:8], "little")
        if len(data) < 8 or length > len(data) - 8:
            raise FileFormatError(path, f"is not a {what} file, or is cut short")
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__", {})
        arrays = load(data)
    except FileFormatError:
        raise
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(path, f"is not a {what} file, or is damaged ({type(error).__name__})") from None
    found = metadata.get("kind") if isinstance(metadata, dict) else None
    if found not in (kind, *older):
        raise FileFormatError(
            path, f"is {found or 'something else'!r}, not {kind!r}, which this version of nilbs reads"
        )
    text = str(metadata.get("settings"))
    if metadata.get("digest") != _digest(arrays, found, text):
        raise FileFormatError(path, "is damaged: its digest does not match its content")
    try:
        settings = parse_json(text)
    except (ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise FileFormatError(path, "is damaged: its settings are no JSON object")
    return arrays, settings


def _digest(arrays: Mapping[str, np.ndarray], kind: str, text: str) -> str:
    digest = hashlib.sha256(f"{kind}\0{text}\0".encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"{name}\0{array.dtype}\0{array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
