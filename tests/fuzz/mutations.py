"""Changes to a file that keep its form, so that what lies behind the first checks is reached too."""

import base64
import io
import json as _json
import re
import struct
import zipfile
from collections.abc import Callable
from contextlib import suppress
from random import Random
from typing import Any

import numpy as np

from nilbs.io.archive import HEADER, _digest, safetensors_digest

Bytes = Callable[[bytes], bytes]
Mutation = Callable[[bytes, Random, Bytes], bytes]

NUMBERS = [0, 1, -1, 2, 3, 4, 0.5, -0.0, 1e-320, 1e30, 1e160, 1.7e308, 255, 2**16, 2**31, 2**32 - 1, 2**53, 2**63]
VALUES = [None, True, False, *NUMBERS, 10**400, "", "a", "\ud800", "\n\x1b[1m", [], {}, [0], [[[]]], [{}]]
WORDS = [*(b"%a" % number for number in NUMBERS), b"nan", b"inf", b"-", b"1_0", b"\xff\xfe", b"\xc3\xa9", b"#", b""]
FLOATS = [0.0, -0.0, 1.0, -1.0, 1e-45, 1e30, -3e38, float("inf"), float("nan")]
KINDS = ["<f8", "<f4", ">f4", "<f2", "|i1", "|u1", "<i2", "<u4", "<i8", ">u8"]


def words(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change, repeat, drop and move words and lines."""
    if rng.random() < 0.3:
        return mutate(data)
    lines = [line.split(b" ") for line in data.split(b"\n")]
    for _ in range(rng.choice([1, 1, 2, 5])):
        row = rng.choice(lines)
        other = rng.choice(lines)
        at = rng.randrange(len(row))
        match rng.randrange(9):
            case 0:
                row[at] = rng.choice(WORDS)
            case 1:
                row.insert(at, rng.choice(WORDS))
            case 2:
                row[at] = rng.choice(other)
            case 3:
                row[at] = mutate(row[at])
            case 4:
                row[at] = re.sub(rb"\d+", lambda found: b"%d" % (int(found[0][:30]) + rng.choice([-1, 1])), row[at])
            case 5 if len(row) > 1:
                del row[at]
            case 6:
                lines.insert(rng.randrange(len(lines) + 1), [*other])
            case 7 if len(lines) > 1:
                lines.remove(other)
            case 8:
                lines += [[*line] for line in lines[rng.randrange(len(lines)) :]][:50]
    return b"\n".join(b" ".join(line) for line in lines)


def json(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change, repeat, drop and move values of a JSON tree."""
    tree = _loaded(data)
    if tree is None or rng.random() < 0.2:
        return mutate(data)
    try:
        return _json.dumps(tree_of(tree, rng)).encode()
    except (ValueError, RecursionError):  # whole numbers of thousands of digits, and too deep a tree
        return mutate(data)


def gltf(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change the JSON tree, or numbers in the buffer that it holds as a data URI."""
    tree = _loaded(data)
    try:
        head, text = tree["buffers"][0]["uri"].split(",")
        buffer = base64.b64decode(text)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return json(data, rng, mutate)
    if rng.random() < 0.6:
        return json(data, rng, mutate)
    tree["buffers"][0]["uri"] = f"{head},{base64.b64encode(_numbers(buffer, rng, mutate)).decode()}"
    return _json.dumps(tree).encode()


def glb(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change the JSON tree or numbers of the binary chunk, and put them together again."""
    size = int.from_bytes(data[12:16], "little")
    text, binary = data[20 : 20 + size], data[28 + size :]
    tree = _loaded(text)
    if tree is None or rng.random() < 0.1:
        return mutate(data)
    if rng.random() < 0.6:
        text = json(text, rng, mutate)
    else:
        binary = _numbers(binary, rng, mutate)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def npy(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change an array, its type or shape, or the header alone."""
    try:
        A = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # whatever is wrong with it: it is only bytes then
        return mutate(data)
    choice = rng.randrange(8)
    if choice == 0 or A.dtype.kind not in "biuf":
        return mutate(data)
    if choice == 1:
        start, end = 10, data.find(b"\n", 10) + 1 or len(data)
        header = words(data[start:end].replace(b"(", b"( ").replace(b",", b" ,"), rng, mutate)
        return data[:8] + struct.pack("<H", len(header) & 0xFFFF) + header + data[end:]
    with np.errstate(all="ignore"):
        if choice == 2:
            A = A.astype(rng.choice(KINDS))
        elif choice == 3 and A.ndim:
            A = A[: rng.randrange(len(A) + 1)]
        elif choice == 4 and A.ndim:
            A = np.concatenate([A, A[rng.randrange(len(A) + 1) :]])
        elif choice == 5:
            A = rng.choice([A.T, A.ravel(), A[None], A[..., None]])
        elif A.size:
            A = A.copy()
            for _ in range(rng.choice([1, 1, 3])):
                A.flat[rng.randrange(A.size)] = np.array(rng.choice([*NUMBERS, *FLOATS]), float).astype(A.dtype)
    saved = io.BytesIO()
    np.save(saved, A, allow_pickle=False)
    return saved.getvalue()


def npz(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change, drop, rename and repeat the arrays of an archive, with checksums that fit."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    except Exception:  # whatever is wrong with it: it is only bytes then
        return mutate(data)
    if not members or rng.random() < 0.1:
        return mutate(data)
    at = rng.randrange(len(members))
    name, content = members[at]
    choice = rng.randrange(10)
    if choice == 0:
        del members[at]
    elif choice == 1:
        members[at] = (rng.choice(members)[0], content)
    elif choice == 2:
        members[at] = (name, rng.choice(members)[1])
    elif choice == 3:
        members[at] = (mutate(name.encode()).decode("latin-1"), content)
    else:
        members[at] = (name, npy(content, rng, mutate))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for member, inside in dict(members).items():
            archive.writestr(zipfile.ZipInfo(member or "x"), inside)
    return packed.getvalue()


def threemf(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change words of the model in a 3MF file."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            members = {name: packed.read(name) for name in packed.namelist()}
    except Exception:  # whatever is wrong with it: it is only bytes then
        return mutate(data)
    if not members or rng.random() < 0.1:
        return mutate(data)
    changed = io.BytesIO()
    with zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            text = content.replace(b'"', b' " ').replace(b"><", b">\n<")
            packed.writestr(zipfile.ZipInfo(name or "x"), words(text, rng, mutate).replace(b' " ', b'"'))
    return changed.getvalue()


def archive(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Change the header of an archive, or its arrays, with a digest that fits."""
    from safetensors.numpy import load

    if data.startswith(b"PK"):
        return _zipped(data, rng, mutate)

    length = int.from_bytes(data[:8], "little")
    tree = _loaded(data[8 : 8 + length])
    if not isinstance(tree, dict) or rng.random() < 0.1:
        return mutate(data)
    tensors = data[8 + length :]
    meta = tree.get("__metadata__")
    choice = rng.randrange(4)
    if choice == 0:
        tree = tree_of(tree, rng)
    elif choice == 1:
        tensors = _numbers(tensors, rng, mutate)
    elif isinstance(meta, dict) and isinstance(meta.get("settings"), str):
        meta["settings"] = json(meta["settings"].encode("utf-8", "replace"), rng, mutate).decode("latin-1")

    def packed() -> bytes:
        text = _json.dumps(tree).encode()
        return struct.pack("<Q", len(text)) + text + tensors

    with suppress(Exception):  # no archive any more, or one without its texts, goes as it is
        tree["__metadata__"]["digest"] = safetensors_digest(load(packed()), meta["kind"], meta["settings"])
    return packed()


def _zipped(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    if rng.random() < 0.1:
        return mutate(data)
    if rng.random() < 0.5:
        changed = npz(data, rng, mutate)
    else:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        members[HEADER] = json(members[HEADER], rng, mutate)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(zipfile.ZipInfo(name), content)
        changed = packed.getvalue()
    changed = changed[:-2] + struct.pack("<H", 64)  # the length of the comment, which is the digest
    return changed + _digest(changed)


def tree_of(tree: Any, rng: Random) -> Any:
    """A JSON tree with some values changed, repeated, dropped and moved."""
    for _ in range(rng.choice([1, 1, 2, 4])):
        places = _places(tree)
        if not places:
            return _copy(rng.choice(VALUES))
        inner, key = rng.choice(places)
        value = inner[key]
        choice = rng.randrange(8)
        if choice == 0:
            inner[key] = _copy(rng.choice(VALUES))
        elif choice == 1:
            del inner[key]
        elif choice == 2 and isinstance(value, int | float) and not isinstance(value, bool):
            inner[key] = rng.choice([value + 1, value - 1, -value, value // 2, rng.choice(NUMBERS)])
        elif choice == 3 and isinstance(inner, list):
            inner.insert(key, _copy(value))
        elif choice == 4 and isinstance(inner, dict):
            names = [other for _, other in places if isinstance(other, str)]
            inner[rng.choice([*names, "", "\ud800", "\n"])] = _copy(value)
        elif choice == 5 and isinstance(value, list):
            value += _copy(value)[:100]
        elif choice == 6 and isinstance(value, list):
            inner[key] = value[: rng.randrange(len(value) + 1)]
        else:
            there, where = rng.choice(places)
            inner[key] = _copy(there[where])
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every place of a tree: the list or object, and the index or name."""
    found, open_ = [], [tree]
    while open_ and len(found) < 10_000:
        value = open_.pop()
        keys = list(value) if isinstance(value, dict) else range(len(value))
        found += [(value, key) for key in keys]
        open_ += [value[key] for key in keys if isinstance(value[key], dict | list)]
    return found


def _copy(value: Any) -> Any:
    return _json.loads(_json.dumps(value))


def _loaded(text: bytes) -> Any:
    """A list or object of JSON, None for anything else."""
    try:
        tree = _json.loads(text)
    except (ValueError, RecursionError):
        return None
    return tree if isinstance(tree, dict | list) else None


def _numbers(data: bytes, rng: Random, mutate: Bytes) -> bytes:
    """Binary data with some numbers of four bytes changed."""
    if len(data) < 4 or rng.random() < 0.3:
        return mutate(data)
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8])):
        at = rng.randrange(len(data) // 4) * 4
        whole, number = rng.choice([0, 1, 2, 255, 2**16, 2**31, 2**32 - 1]), rng.choice(FLOATS)
        changed[at : at + 4] = struct.pack("<I", whole) if rng.random() < 0.4 else struct.pack("<f", number)
    return bytes(changed)
