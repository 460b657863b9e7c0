"""Named arrays and settings in one file without pickle: a zip archive of `.npy` members, as NumPy's `.npz` is.

The member `archive.json` holds the file's kind and settings. The comment of the archive is a digest of all bytes before
it, so that any flipped, missing or added byte is noticed. Where the file is compressed, arrays are stored in the form
that compresses best, which `archive.json` names:

- "bytes": the first bytes of all numbers, then the second ones and so on, as an array of bytes with one row for each;
- "differences": the same of the differences of whole numbers from the one before along the last axis, where an integer
  that overflows wraps around.

Files that earlier versions wrote in the format safetensors are read too.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from nilbs.io.atomic import replacing
from nilbs.io.bounded import SIZE_LIMIT, file_bytes
from nilbs.io.errors import FileFormatError
from nilbs.io.npy import stored_array
from nilbs.io.strict_json import parse_json
from nilbs.io.zipped import opened, unpacked

KINDS = {
    np.dtype(kind)
    for kind in ("float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "bool")
}
HEADER = "archive.json"
FORMS = ("plain", "bytes", "differences")
# Characters of the digest.
DIGEST = 64
LEVEL = 6
# Bytes of an array that are compressed on trial to choose its form; one with fewer is stored plain.
TRIAL, LEAST = 2**17, 2**10


def write_archive(
    path: str | Path,
    arrays: Mapping[str, np.ndarray],
    settings: Mapping[str, Any],
    *,
    kind: str,
    compress: bool = False,
) -> None:
    """Write arrays (of the types in `KINDS`) and settings; the file appears whole or not at all.

    `kind` names the content, for example "nilbs model 1"; `read_archive` expects the same. A compressed file is a third
    as large, and takes many times as long to write.

    Examples
    --------
    >>> import tempfile, os
    >>> path = os.path.join(tempfile.mkdtemp(), "a.bin")
    >>> write_archive(path, {"x": np.arange(3.0)}, {"seed": 7}, kind="example 1")
    >>> read_archive(path, kind="example 1")
    ({'x': array([0., 1., 2.])}, {'seed': 7})
    """
    for name, array in arrays.items():
        if array.dtype not in KINDS:
            raise ValueError(f"{name} has type {array.dtype}; an archive holds {sorted(map(str, KINDS))}")
    forms, members = {}, {}
    for name, array in arrays.items():
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        form = _best_form(array) if compress else "plain"
        members[name] = _stored(array, form)
        if form != "plain":
            forms[name] = {"form": form, "type": array.dtype.name, "shape": array.shape}
    header = {"kind": kind, "settings": dict(settings), "forms": forms}
    text = json.dumps(header, sort_keys=True, allow_nan=False)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED) as archive:
        archive.comment = b"0" * DIGEST
        for name, content in {HEADER: text.encode(), **{f"{name}.npy": _npy(a) for name, a in members.items()}}.items():
            # The time of writing is no part of the content.
            archive.writestr(zipfile.ZipInfo(name), content, archive.compression, LEVEL)
    data = file.getbuffer()
    data[-DIGEST:] = _digest(data[:-DIGEST])
    with replacing(path) as target:
        target.write(data)


def read_archive(
    path: str | Path, *, kind: str, older: Sequence[str] = ()
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and settings that `write_archive` wrote, in this version or an earlier one.

    `older` are kinds of earlier versions that are read too; another kind, or a damaged file, is a FileFormatError.
    """
    data, what = file_bytes(path), kind.rsplit(" ", 1)[0]
    read = _read_zip if data.startswith(b"PK") else _read_safetensors
    return read(path, data, what, (kind, *older))


def _read_zip(
    path: str | Path, data: bytes, what: str, kinds: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    if _digest(memoryview(data)[:-DIGEST]) != data[-DIGEST:]:
        raise FileFormatError(path, f"is not a {what} file, or is damaged: its digest does not match its content")
    archive = opened(path, data)
    names = archive.namelist()
    if HEADER not in names or len(set(names)) < len(names):
        raise FileFormatError(path, f"is not a {what} file: it has no {HEADER}, or a member twice")
    if sum(member.file_size for member in archive.infolist()) > SIZE_LIMIT:
        raise FileFormatError(path, f"is not a {what} file: it holds more than {SIZE_LIMIT >> 20} MiB")
    try:
        header = parse_json(unpacked(path, archive, HEADER).decode())
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict):
        raise FileFormatError(path, f"is damaged: {HEADER} is no JSON object")
    found, settings, forms = header.get("kind"), header.get("settings"), header.get("forms")
    _check_kind(path, found, kinds)
    if not isinstance(settings, dict) or not isinstance(forms, dict):
        raise FileFormatError(path, "is damaged: its settings are no JSON object")
    arrays = {}
    for member in names:
        name = member.removesuffix(".npy")
        if member != HEADER:
            stored = stored_array(path, unpacked(path, archive, member), name, kinds="fiub")
            arrays[name] = _restored(path, name, stored, forms.get(name))
    return arrays, settings


def _read_safetensors(
    path: str | Path, data: bytes, what: str, kinds: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """What versions before 7 of model files wrote."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

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
    _check_kind(path, found, kinds)
    text = str(metadata.get("settings"))
    if metadata.get("digest") != safetensors_digest(arrays, str(found), text):
        raise FileFormatError(path, "is damaged: its digest does not match its content")
    try:
        settings = parse_json(text)
    except (ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise FileFormatError(path, "is damaged: its settings are no JSON object")
    return arrays, settings


def _check_kind(path: str | Path, found: Any, kinds: Sequence[str]) -> None:
    if found not in kinds:
        raise FileFormatError(
            path, f"is {found or 'something else'!r}, not {kinds[0]!r}, which this version of nilbs reads"
        )


def _best_form(array: np.ndarray) -> str:
    """The form in which a piece of an array from its middle is shortest when it is compressed."""
    if array.nbytes < LEAST or array.dtype.kind == "b":
        return "plain"
    flat = array.reshape(-1, array.shape[-1]) if array.ndim > 1 else array.reshape(1, -1)
    rows = max(1, TRIAL // (flat.shape[1] * array.itemsize))
    middle = max(0, (len(flat) - rows) // 2)
    columns = max(1, TRIAL // array.itemsize)
    piece = flat[middle : middle + rows, max(0, flat.shape[1] // 2 - columns // 2) :][:, :columns]
    forms = FORMS if array.dtype.kind in "iu" else FORMS[:2]
    return min(forms, key=lambda form: len(zlib.compress(_stored(piece, form).tobytes(), LEVEL)))


def _stored(array: np.ndarray, form: str) -> np.ndarray:
    """An array as it is stored."""
    if form == "differences":
        array = np.diff(array, prepend=array.dtype.type(0))
    if form != "plain":
        array = np.ascontiguousarray(array).reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
    return np.ascontiguousarray(array)


def _restored(path: str | Path, name: str, stored: np.ndarray, how: Any) -> np.ndarray:
    """The array that was stored in a form."""
    if how is None:
        array = stored.astype(stored.dtype.newbyteorder("="))
        if array.dtype not in KINDS:
            raise FileFormatError(path, f"{name} is of the type {array.dtype}, which archives do not hold")
        return array
    try:
        form, kind, shape = how["form"], np.dtype(str(how["type"])), tuple(how["shape"])
        fits = form in FORMS[1:] and kind in KINDS and kind.kind in ("iu" if form == "differences" else "iuf")
        fits = fits and all(type(size) is int and size > 0 for size in shape)
        fits = fits and stored.dtype == np.uint8 and stored.shape == (kind.itemsize, prod(shape))
        if not fits:
            raise ValueError
        array = np.empty(shape, dtype=kind.newbyteorder("<"))
        for k, row in enumerate(stored):  # faster than to transpose all at once
            array.reshape(-1).view(np.uint8)[k :: kind.itemsize] = row
        array = array.astype(kind, copy=False)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise FileFormatError(path, f"is damaged: {name} is not stored in the form that {HEADER} names") from None
    return np.cumsum(array, axis=-1, dtype=kind) if form == "differences" else array


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=False)
    return file.getvalue()


def _digest(data: bytes | memoryview) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()


def safetensors_digest(arrays: Mapping[str, np.ndarray], kind: str, text: str) -> str:
    """What files in the format safetensors name their digest."""
    digest = hashlib.sha256(f"{kind}\0{text}\0".encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"{name}\0{array.dtype}\0{array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
