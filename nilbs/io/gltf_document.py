"""The container of a glTF 2.0 file: its JSON, its buffers, and arrays as accessors describe them."""

import base64
import binascii
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nilbs.io.bounded import file_bytes
from nilbs.io.errors import FileFormatError, check_suffix
from nilbs.io.names import printable
from nilbs.io.strict_json import json_errors, no_constant
from nilbs.io.text import without_mark

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_JSON_CHUNK, _BINARY_CHUNK = b"JSON", b"BIN\0"
_REPEATED = 2**24  # numbers that accessors may yield beyond twice the file's bytes: they may overlap, but not endlessly
INSTANCES = "EXT_mesh_gpu_instancing"
# Extensions that a file may require: they change no shape and no motion, or are read.
_HARMLESS = (
    "KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", INSTANCES
)  # fmt: skip
_COMPRESSION = re.compile("draco|meshopt|compress", re.IGNORECASE)  # in the names of extensions


class Document:
    """A glTF file, taken apart no further than into JSON (`root`) and buffers.

    Nothing in the file is trusted: every index, size and type is checked where it is used. Buffers come from the file
    itself or from a file in its folder or below, nowhere else. `size` counts the bytes of all that were read so far.
    """

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = path
        self._buffers: dict[int, memoryview] = {}
        self._files: dict[str, memoryview] = {}
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._yielded = 0
        binary = check_suffix(path, ".gltf", ".glb") == ".glb"
        data = memoryview(file_bytes(path))
        self.size = len(data)
        text, self._chunk = self._chunks(data) if binary else (data, None)
        self.root = self._json(text)
        version = self.text(self._object(self.root.get("asset", {}), "asset"), "version", "asset")
        if not version.startswith("2."):
            raise self.error(f"this is glTF {version[:20] or 'of no version'}; version 2 is read, export it as that")
        used = [name for kind in ("extensionsRequired", "extensionsUsed") for name in self.strings(kind)]
        self._compressions = [name for name in used if _COMPRESSION.search(name)]
        for name in self.strings("extensionsRequired"):
            if _COMPRESSION.search(name):
                self._refuse_held([name], "the file")
            if not name.startswith(_HARMLESS):
                raise self.error(f"it requires the extension {name[:80]}, which is not read: export it without")

    def error(self, message: str) -> FileFormatError:
        """An error of this file."""
        return FileFormatError(self.path, message)

    def entries(self, kind: str) -> list[dict[str, Any]]:
        """The objects of a list at the top level, such as "nodes"; none where there is no such list."""
        if kind not in self._lists:
            self._lists[kind] = self.objects(self.root, kind, "the file")
        return self._lists[kind]

    def objects(self, entry: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
        """A list of objects in an entry; empty where it is left out."""
        values = entry.get(key, [])
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            raise self.error(f"{where}: {key!r} must be a list of objects")
        return values

    def section(self, entry: dict[str, Any], key: str, where: str) -> dict[str, Any]:
        """An object in an entry; empty where it is left out."""
        return self._object(entry.get(key, {}), f"{where}: {key!r}")

    def strings(self, key: str) -> list[str]:
        """A list of strings at the top level; empty where it is left out."""
        values = self.root.get(key, [])
        if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
            raise self.error(f"{key!r} must be a list of strings")
        return values

    def text(self, entry: dict[str, Any], key: str, where: str) -> str:
        """A string in an entry, made printable; empty where it is left out."""
        value = entry.get(key, "")
        if not isinstance(value, str):
            raise self.error(f"{where}: {key!r} must be a string")
        return printable(value)

    def whole(
        self, entry: dict[str, Any], key: str, where: str, *, default: int | None = None, below: int = 2**53
    ) -> int:
        """A whole number in an entry, from 0 and below a limit."""
        value = entry.get(key, default)
        number = _whole(value, below)
        if number is None:
            shown = "is missing" if value is None else f"is {str(value)[:40]}"
            raise self.error(f"{where}: {key!r} {shown}; it must be a whole number from 0 to {below - 1}")
        return number

    def indices(self, entry: dict[str, Any], key: str, where: str, below: int) -> list[int]:
        """A list of indices in an entry; empty where it is left out."""
        values = entry.get(key, [])
        found = [_whole(value, below) for value in values] if isinstance(values, list) else [None]
        if None in found:
            raise self.error(f"{where}: {key!r} must be a list of indices from 0 to {below - 1}")
        return [number for number in found if number is not None]

    def numbers(self, entry: dict[str, Any], key: str, where: str, size: int) -> list[float]:
        """A list of so many finite numbers in an entry."""
        values = entry.get(key)
        # Compared as they are: a whole number may be too large for a float.
        if isinstance(values, list) and len(values) == size and all(_is_number(x) and abs(x) < 1e300 for x in values):
            return [float(x) for x in values]
        raise self.error(f"{where}: {key!r} must be {size} finite numbers")

    def extensions(self, entry: dict[str, Any], where: str) -> list[str]:
        """Names of the extensions in an entry that may hold data of it."""
        found = self.section(entry, "extensions", where)
        return [name for name in found if not name.startswith(_HARMLESS)]

    def accessor(
        self, index: int, where: str, kind: str, *, whole: bool = False, held: Sequence[str] = ()
    ) -> np.ndarray:
        """The numbers (count, width) that an accessor describes, of a type such as "VEC3".

        `whole` requires unsigned integers. Else integers become numbers, and normalised ones fractions. Errors name
        `where` as the user of the accessor. Where it names no data, and an extension may hold it, such as those `held`,
        it is refused.
        """
        entry, name = self._entry("accessors", index, where), f"accessor {index} ({where})"
        component = self.whole(entry, "componentType", name)
        if component not in _TYPES or entry.get("type") != kind:
            raise self.error(f"{name} must be of type {kind} and have a known component type")
        dtype, width = np.dtype(_TYPES[component]), _WIDTHS[kind]
        count = self.whole(entry, "count", name)
        normalized = entry.get("normalized") is True
        if whole and (dtype.kind != "u" or normalized):
            raise self.error(f"{name} must hold unsigned integers, not normalized")
        self.spend(count * width, name)
        if "bufferView" in entry:
            offset = self.whole(entry, "byteOffset", name, default=0)
            values = self._strided(self.whole(entry, "bufferView", name), offset, count, width, dtype, name)
        else:
            listed = [] if "sparse" in entry else self._compressions
            self._refuse_held([*held, *self.extensions(entry, name), *listed], name)
            values = np.zeros((count, width), dtype)
        if "sparse" in entry:
            values = self._replaced(values, self.section(entry, "sparse", name), name)
        if whole:
            return values.astype(np.int64)
        with np.errstate(invalid="ignore"):  # a signalling NaN is reported below
            result = values.astype(np.float64)
        if not np.isfinite(result).all():
            raise self.error(f"{name} holds a number that is not finite")
        if normalized and dtype.kind in "iu":
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        return result

    def spend(self, numbers: int, name: str) -> None:
        """Count numbers that the file yields, and refuse it where they are many times its size."""
        self._yielded += numbers
        if self._yielded > _REPEATED + 2 * self.size:
            raise self.error(f"{name}: the accessors hold many times more numbers than the file has bytes")

    def _refuse_held(self, names: Sequence[str], where: str) -> None:
        """Refuse data that is in an extension, if there is one that may hold it."""
        compression = next((name for name in names if _COMPRESSION.search(name)), None)
        if compression is not None:
            raise self.error(
                f"it is compressed ({compression[:80]}), which is not read: export it again without compression"
            )
        if names:
            raise self.error(f"{where} is left to the extension {names[0][:80]}, which is not read: export it without")

    def _entry(self, kind: str, index: int, where: str) -> dict[str, Any]:
        entries = self.entries(kind)
        if index >= len(entries):
            raise self.error(f"{where} refers to {kind}[{index}], but there are {len(entries)}")
        return entries[index]

    def _strided(self, view: int, offset: int, count: int, width: int, dtype: np.dtype, name: str) -> np.ndarray:
        """Rows of numbers in a buffer view, not copied."""
        entry, where = self._entry("bufferViews", view, name), f"bufferView {view} ({name})"
        size = width * dtype.itemsize
        stride = self.whole(entry, "byteStride", where, default=size)
        if not size <= stride <= 252 and "byteStride" in entry:
            raise self.error(f"{where}: a stride of {stride} bytes, which must be from {size} to 252")
        start, length = (self.whole(entry, key, where, default=0) for key in ("byteOffset", "byteLength"))
        buffer = self._buffer(self.whole(entry, "buffer", where), where, self.extensions(entry, where))
        if start + length > len(buffer):
            raise self.error(f"{where} ends at byte {start + length} of a buffer of {len(buffer)}")
        if count == 0:
            return np.zeros((0, width), dtype)
        end = offset + stride * (count - 1) + size
        if end > length:
            raise self.error(f"{name} takes {end} bytes of bufferView {view}, which has {length}")
        return np.ndarray((count, width), dtype, buffer, start + offset, (stride, dtype.itemsize))

    def _replaced(self, values: np.ndarray, sparse: dict[str, Any], name: str) -> np.ndarray:
        """Values with those that a sparse accessor lists in place."""
        count = self.whole(sparse, "count", name, below=len(values) + 1)
        at, by = (self.section(sparse, key, name) for key in ("indices", "values"))
        component = self.whole(at, "componentType", name)
        if component not in (5121, 5123, 5125):
            raise self.error(f"{name}: sparse indices must be unsigned integers")
        parts = []
        for entry, width, dtype in ((at, 1, np.dtype(_TYPES[component])), (by, values.shape[1], values.dtype)):
            view = self.whole(entry, "bufferView", name)
            offset = self.whole(entry, "byteOffset", name, default=0)
            parts.append(self._strided(view, offset, count, width, dtype, name))
        rows = parts[0][:, 0].astype(np.int64)
        if count and rows.max() >= len(values):
            raise self.error(f"{name}: sparse index {rows.max()} of {len(values)}")
        values = values.copy()
        values[rows] = parts[1]
        return values

    def _buffer(self, index: int, where: str, held: Sequence[str]) -> memoryview:
        if index not in self._buffers:
            entry, name = self._entry("buffers", index, where), f"buffer {index}"
            length = self.whole(entry, "byteLength", name)
            if "uri" in entry:
                data = self._resource(entry["uri"], name)
            elif self._chunk is not None and index == 0 and not self.extensions(entry, name):
                data = self._chunk
            else:
                self._refuse_held([*held, *self.extensions(entry, name), *self._compressions], name)
                raise self.error(f"{name} has no data")
            if length > len(data):
                raise self.error(f"{name} claims {length} bytes and has {len(data)}")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _resource(self, uri: object, name: str) -> memoryview:
        """The bytes that a URI holds, or those of the file beside this one that it names."""
        if not isinstance(uri, str):
            raise self.error(f"{name}: 'uri' must be a string")
        if uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            try:
                if head.endswith(";base64"):
                    return memoryview(base64.b64decode(body, validate=True))
            except (binascii.Error, ValueError):
                pass
            raise self.error(f"{name}: its data URI is not base64")
        relative = unquote(uri)
        outside = relative.startswith("/") or ".." in relative.split("/") or set(relative) & set(":\\")
        if outside or not relative or not relative.isprintable():
            raise self.error(f"{name} is {uri[:80]!r}; only files beside this one are read")
        folder = os.path.realpath(Path(self.path).parent)
        target = os.path.realpath(os.path.join(folder, relative))
        if os.path.commonpath([folder, target]) != folder:
            raise self.error(f"{name} is {uri[:80]!r}, a link that leads out of the file's folder")
        if target not in self._files:
            self._files[target] = memoryview(file_bytes(target))
            self.size += len(self._files[target])
        return self._files[target]

    def _chunks(self, data: memoryview) -> tuple[memoryview, memoryview | None]:
        """The JSON and, where there is one, the binary chunk of a GLB file."""
        version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
        if len(data) < 20 or data[:4] != b"glTF":
            raise self.error("this is no GLB file: it does not start with 'glTF'")
        if version != 2:
            raise self.error(f"this is GLB version {version}; version 2 is read")
        if length > len(data):
            raise self.error(f"the header claims {length} bytes, the file has {len(data)}")
        chunks: list[tuple[bytes, memoryview]] = []
        at = 12
        while at + 8 <= length and len(chunks) < 2:
            size, kind = int.from_bytes(data[at : at + 4], "little"), bytes(data[at + 4 : at + 8])
            if at + 8 + size > length:
                raise self.error(f"the chunk at byte {at} claims {size} bytes, which reach beyond the end")
            chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        if not chunks or chunks[0][0] != _JSON_CHUNK:
            raise self.error("the first chunk of a GLB file must be JSON")
        return chunks[0][1], chunks[1][1] if len(chunks) > 1 and chunks[1][0] == _BINARY_CHUNK else None

    def _json(self, text: memoryview) -> dict[str, Any]:
        with json_errors(self.path, lines=len(text) == self.size):
            root = json.loads(without_mark(self.path, bytes(text)).decode(), parse_constant=no_constant)
        return self._object(root, "the file")

    def _object(self, value: object, where: str) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.error(f"{where} must be an object")
        return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _whole(value: object, below: int) -> int | None:
    """A whole number, which JSON may write as 3.0; None for anything else."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < below else None
