"""Readers return arrays or raise FileFormatError, for any content."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nilbs.io import (
    FileFormatError,
    read_dmat,
    read_mesh,
    read_motion_json,
    read_npy,
    read_tgf,
    read_transforms,
    read_weights,
    write_dmat,
    write_mesh,
    write_motion_json,
    write_npy,
    write_tgf,
    write_weights,
)

NAMES = ["bone0", "bone1"]


def _checked_mesh(path):
    V, E = read_mesh(path)
    assert np.isfinite(V).all()
    assert ((E >= 0) & (len(V) > E)).all()


def _checked_rig(path):
    C, BE = read_tgf(path)
    assert np.isfinite(C).all()
    assert ((BE >= 0) & (len(C) > BE)).all()


def _checked_array(reader):
    def read(path):
        A = reader(path)
        assert all(np.isfinite(part).all() for part in (A if isinstance(A, tuple) else (A,)))

    return read


def _checked_motion(d):
    def read(path):
        motion = read_motion_json(path, NAMES, d)
        return tuple(
            part
            for part in (motion.theta, motion.root_translation, motion.translation, motion.scale, motion.times)
            if part is not None
        )

    return _checked_array(read)


def _binary_dmat(path):
    path.write_bytes(b"0 0\n3 4\n" + np.arange(12.0).tobytes())


def _text_ply(path):
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 1\n1 0 0\n0 1 0\n3 0 1 2\n"
    )


# Name: (reader, writer of a good file, words of such files).
FORMATS = {
    "a.obj": (
        _checked_mesh,
        lambda path: write_mesh(path, np.eye(3), [[0, 1, 2]]),
        ["v", "f", "l", "1", "-1", "0", "2/1", "1//1", "0.5", "nan", "1e999", "\\", "#", "vt", "1_0", "9" * 25],
    ),
    "a.ply": (
        _checked_mesh,
        lambda path: write_mesh(path, np.eye(3), [[0, 1, 2], [0, 2, 1]]),
        [
            "ply",
            "format",
            "ascii",
            "binary_big_endian",
            "1.0",
            "element",
            "vertex",
            "face",
            "property",
            "list",
            "uchar",
            "int",
            "float",
            "x",
            "y",
            "z",
            "vertex_indices",
            "end_header",
            "1",
            "3",
            "-1",
            "nan",
            "1000000000",
        ],
    ),
    "text.ply": (_checked_mesh, _text_ply, ["1", "-1", "nan", "0.5", "300", "9" * 25]),
    "a.tgf": (
        _checked_rig,
        lambda path: write_tgf(path, np.eye(3), [[0, 1], [1, 2]]),
        ["1", "2", "3", "-1", "#", "0.5", "nan", "1e999", "9" * 25],
    ),
    "a.dmat": (
        _checked_array(read_dmat),
        lambda path: write_dmat(path, np.eye(3)),
        ["0", "1", "2", "nan", "1_0", "9" * 25, "0.5"],
    ),
    "b.dmat": (_checked_array(read_dmat), _binary_dmat, ["0 0\n", "1 1\n", "\0\0\0\0\0\0\0\0", "x"]),
    "t.dmat": (
        _checked_array(read_transforms),
        lambda path: write_dmat(path, np.zeros((24, 2))),
        ["2 12\n", "0", "0", "0", "1"],
    ),
    "a.npz": (
        _checked_array(read_weights),
        lambda path: write_weights(path, np.eye(3)),
        ["PK\3\4", "PK\1\2", "PK\5\6", "W.npy", "\0\0"],
    ),
    "a.npy": (
        _checked_array(read_npy),
        lambda path: write_npy(path, np.eye(3)),
        ["\x93NUMPY", "\1\0", "v\0", "{'descr': '<f8', 'fortran_order': False, 'shape': (", "1", ", ", "), }"],
    ),
    "a.json": (
        _checked_motion(3),
        lambda path: write_motion_json(path, NAMES, np.ones((2, 2, 3)), np.ones((2, 3))),
        ["{", "}", "[", "]", ",", ":", '"frames"', '"bone0"', '"root_translation"', "1", "NaN", "null", "1e999", '"x"'],
    ),
}


def refused_or_read(read, path, content=None):
    """Whether the file, or this content instead, is read."""
    if content is not None:
        path.unlink()  # replacing a file is much slower on some disks than writing a new one
        path.write_bytes(content)
    message = ""
    try:
        read(path)
    except FileFormatError as error:
        message = str(error)
    assert not message or (path.name in message and "\n" not in message)
    return not message


@pytest.fixture(params=FORMATS)
def form(request, tmp_path):
    read, write, words = FORMATS[request.param]
    path = tmp_path / request.param
    write(path)
    assert refused_or_read(read, path)
    return read, path, path.read_bytes(), words


@settings(max_examples=25)
@given(content=st.binary(max_size=300))
def test_any_bytes(form, content):
    read, path, _, _ = form
    refused_or_read(read, path, content)


@settings(max_examples=25)
@given(data=st.data())
def test_a_good_file_damaged(form, data):
    read, path, good, _ = form
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged)))
        stop = at + data.draw(st.sampled_from([0, 0, 1, 1, 4, 60]))
        damaged[at:stop] = data.draw(st.binary(max_size=4) | st.sampled_from([b"", b"-", b"9" * 19, b"\xff" * 4, b" "]))
    refused_or_read(read, path, damaged)


@settings(max_examples=25)
@given(data=st.data())
def test_the_right_words_in_any_order(form, data):
    read, path, good, words = form
    ends = st.sampled_from([" ", "\n", ""])
    pairs = data.draw(st.lists(st.tuples(st.sampled_from(words), ends), max_size=30))
    drawn = "".join(word + end for word, end in pairs)
    # Alone, and behind the start of a good file.
    start = data.draw(st.sampled_from([0, len(good) // 2, len(good)]))
    refused_or_read(read, path, good[:start] + drawn.encode("latin-1"))


def test_cut_anywhere(form):
    read, path, good, _ = form
    for end in range(0, len(good), max(1, len(good) // 60)):
        refused_or_read(read, path, good[:end])


TYPES = {"uchar": "B", "char": "b", "short": "h", "uint": "I", "float": "f", "double": "d"}


@settings(max_examples=25)
@given(data=st.data())
def test_binary_ply_of_any_layout(tmp_path, data):
    kinds = st.sampled_from(sorted(TYPES))
    header, rows = "ply\nformat binary_little_endian 1.0\n", b""
    for element in data.draw(st.permutations(["vertex", "face", "edge"])):
        size = data.draw(st.integers(0, 4))
        header += f"element {element} {size}\n"
        columns = []
        names = {"vertex": "xyz", "face": ["vertex_indices"], "edge": ["vertex1", "vertex2"]}[element]
        for name in [*names, "other"]:
            as_list = data.draw(st.booleans()) if name not in "xyz" else False
            kind = data.draw(kinds)
            columns.append((as_list, TYPES[kind]))
            header += f"property {'list uchar ' if as_list else ''}{kind} {name}\n"
        for _ in range(size):
            for as_list, code in columns:
                count = data.draw(st.integers(0, 4)) if as_list else 1
                rows += struct.pack(f"<{'B' * as_list}{count}{code}", *[count] * as_list, *[1] * count)
    path = tmp_path / "a.ply"
    path.write_bytes((header + "end_header\n").encode() + rows)
    refused_or_read(_checked_mesh, path)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*NAMES, "frames"]), inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=25)
@given(motion=VALUES | st.fixed_dictionaries({"frames": st.lists(VALUES, max_size=3)}))
@pytest.mark.parametrize("d", [2, 3])
def test_any_json(tmp_path, motion, d):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(motion))
    refused_or_read(_checked_motion(d), path)
