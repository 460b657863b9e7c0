"""OpenVDB's `.vdb` files: one grid of single precision numbers, as a tree of blocks without those that are empty.

The layout is that of version 224 of the format [1]_: leaves of 8^3 voxels, below nodes of 16^3 leaves, below nodes of
32^3 of these. A block of values holds the active ones only, and zlib shortens it.

References
----------
.. [1] Museth, VDB: High-resolution sparse volumes with dynamic topology, ACM Transactions on Graphics 32 (3), 2013.
"""

import os
import struct
import zlib
from collections.abc import Mapping
from hashlib import blake2b
from itertools import groupby
from uuid import UUID

import numpy as np

from nilbs.geometry.validation import arrays
from nilbs.io.atomic import replacing

_VERSION, _LIBRARY = 224, (12, 0)
_ZIPPED_ACTIVE = 3  # compression: zlib, and active values only
_LEAF, _BELOW, _TOP = 8, 16, 32  # edges of a leaf in voxels, and of the nodes above it in children
_INACTIVE_IS_BACKGROUND = b"\0"


def write_vdb(
    path: str | os.PathLike,
    values: np.ndarray,
    *,
    origin: np.ndarray,
    spacing: float,
    name: str,
    background: float,
    metadata: Mapping[str, str | int | float],
    level_set: bool = False,
) -> None:
    """Write a dense grid; the file appears whole or not at all.

    Parameters
    ----------
    path : str or path
    values : (nx, ny, nz) float array
        Values of the nodes, whose first index is x. Those that are `background` are not stored.
    origin : (3,) float array
        Place of the first node.
    spacing : float
        Between nodes.
    name : str
        The grid's name in the file.
    background : float
        The value outside the grid.
    metadata : mapping
        More about the grid.
    level_set : bool
        Whether values are distances, negative inside; else the grid is a fog volume.
    """
    (origin,) = arrays(origin=(origin, "3"))
    values = np.asarray(values, dtype="<f4")
    if values.ndim != 3:
        raise ValueError(f"values must be (nx, ny, nz), got {values.shape}")
    active = _leaves(values != np.float32(background), False)
    values = _leaves(values, background)
    top, below, leaf = _placed(np.argwhere(active.any(axis=-1)))
    order = np.lexsort((leaf[1], below[1], *top[0].T[::-1]))
    rows = list(
        zip(top[0][order].tolist(), below[1][order].tolist(), leaf[1][order].tolist(), leaf[0][order], strict=True)
    )
    roots = [(place, list(found)) for place, found in groupby(rows, key=lambda row: row[0])]
    topology = [struct.pack("<IfII", 1, background, 0, len(roots))]  # one buffer, no tiles
    buffers = []
    for place, in_root in roots:
        nodes = [(number, list(found)) for number, found in groupby(in_root, key=lambda row: row[1])]
        topology.append(struct.pack("<3i", *(_LEAF * _BELOW * _TOP * n for n in place)))
        topology.append(_node([number for number, _ in nodes], _TOP))
        for _, in_node in nodes:
            topology.append(_node([row[2] for row in in_node], _BELOW))
            for *_, at in in_node:
                mask = np.packbits(active[tuple(at)], bitorder="little").tobytes()
                topology.append(mask)
                buffers.append(mask + _block(values[tuple(at)][active[tuple(at)]].tobytes()))
    about = {"class": "level set" if level_set else "fog volume", "name": name, **metadata}
    scale = [[spacing] * 3, [spacing] * 3, [1 / spacing] * 3, [spacing**-2] * 3, [0.5 / spacing] * 3]
    head = struct.pack("<I", _ZIPPED_ACTIVE) + struct.pack("<I", len(about)) + b"".join(map(_entry, about.items()))
    head += _text("UniformScaleTranslateMap") + np.array([origin, *scale], "<f8").tobytes()
    tree, leaves = b"".join([head, *topology]), b"".join(buffers)
    start = struct.pack("<qIII?", 0x56444220, _VERSION, *_LIBRARY, True)
    start += str(UUID(bytes=blake2b(tree + leaves, digest_size=16).digest())).encode()
    start += struct.pack("<II", 0, 1) + _text(name) + _text("Tree_float_5_4_3") + _text("")  # no metadata, one grid
    first = len(start) + 24
    start += struct.pack("<3q", first, first + len(tree), first + len(tree) + len(leaves))
    with replacing(path, "wb") as file:
        file.write(start + tree + leaves)


def _leaves(A: np.ndarray, outside: float) -> np.ndarray:
    """The leaves of a grid, (lx, ly, lz, 512)."""
    A = np.pad(A, [(0, -n % _LEAF) for n in A.shape], constant_values=outside)
    x, y, z = (n // _LEAF for n in A.shape)
    return A.reshape(x, _LEAF, y, _LEAF, z, _LEAF).transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, _LEAF**3)


def _placed(at: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where leaves and the nodes above them stand: places among their like, and numbers in the node above."""
    found = []
    for edge in (_BELOW, _TOP, 1):
        found.append((at, at % edge @ np.array([edge**2, edge, 1])))
        at = at // edge
    leaf, below, top = found
    return [top, below, leaf]


def _node(children: list[int], edge: int) -> bytes:
    """A node: which children it has, no values."""
    mask = np.zeros(edge**3, dtype=bool)
    mask[children] = True
    return np.packbits(mask, bitorder="little").tobytes() + bytes(edge**3 // 8) + _block(b"")


def _block(values: bytes) -> bytes:
    """Active values, shortened if that makes them shorter."""
    short = zlib.compress(values, 1)
    size, content = (len(short), short) if len(short) < len(values) else (-len(values), values)
    return _INACTIVE_IS_BACKGROUND + struct.pack("<q", size) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _entry(item: tuple[str, str | int | float]) -> bytes:
    """A line of metadata: name, type, size, value."""
    name, value = item
    if isinstance(value, str):
        return _text(name) + _text("string") + _text(value)
    kind, form = ("int64", "<q") if isinstance(value, int) else ("double", "<d")
    data = struct.pack(form, value)
    return _text(name) + _text(kind) + struct.pack("<I", len(data)) + data
