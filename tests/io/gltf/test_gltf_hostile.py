"""Reading untrusted glTF: wrong claims are refused, no file outside the folder is read, any bytes end well."""

import base64
import json
import os
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nilbs.io.errors import FileFormatError
from nilbs.io.gltf import read_gltf

from .files import TRIANGLE, File, animate, glb


def refused(folder, content, match, name="bad.glb"):
    path = folder / name
    path.write_bytes(content.glb() if isinstance(content, File) else content)
    with pytest.raises(FileFormatError, match=match) as caught:
        read_gltf(path)
    assert "\n" not in str(caught.value)


class TestWhereBuffersComeFrom:
    def gltf(self, folder, uri, data=None):
        file = File()
        file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}))
        file.json()["buffers"][0]["uri"] = uri
        path = folder / "made.gltf"
        path.write_text(json.dumps(file.root))
        return path, file.data

    @pytest.mark.parametrize("name", ["a b.bin", "below/ä.bin"])
    def test_beside_the_file(self, tmp_path, name):
        path, data = self.gltf(tmp_path, name.replace(" ", "%20"))
        with pytest.raises(FileNotFoundError):
            read_gltf(path)
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
        assert read_gltf(path).mesh.V.tolist() == TRIANGLE
        (tmp_path / name).write_bytes(data[:-1])
        with pytest.raises(FileFormatError, match="buffer 0 claims 36 bytes and has 35"):
            read_gltf(path)

    def test_in_the_file(self, tmp_path):
        _, data = self.gltf(tmp_path, "")
        text = base64.b64encode(data).decode()
        path, _ = self.gltf(tmp_path, f"data:application/octet-stream;base64,{text}")
        assert read_gltf(path).mesh.V.tolist() == TRIANGLE

    @pytest.mark.parametrize(
        "uri",
        [
            *[
                "",
                "/etc/passwd",
                "../secret.bin",
                "a/../../secret.bin",
                "a/../made.gltf",
                "%2e%2e/secret.bin",
                "https://a.b/c.bin",
            ],
            *[
                "file:secret.bin",
                "..\\secret.bin",
                "C:/secret.bin",
                "a\0.bin",
                "\ud800.bin",
                "\n",
                3,
                None,
                [],
                "link.bin",
            ],
            *["data:;base64,AAA", "data:,AAAA", "data:;base64", "data:;base64,ä"],
        ],
    )
    def test_no_other_files_are_read(self, tmp_path, uri):
        folder = tmp_path / "inside"
        folder.mkdir()
        (tmp_path / "secret.bin").write_bytes(bytes(36))
        os.symlink(tmp_path / "secret.bin", folder / "link.bin")
        path, _ = self.gltf(folder, uri)
        with pytest.raises(FileFormatError, match=r"buffer 0|bufferView 0") as caught:
            read_gltf(path)
        assert "\n" not in str(caught.value)


def changed(change):
    """A good file that was changed."""

    def make(file):
        animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
        change(file.root)
        return file

    return make


def put(value, *keys):
    """Put a value at a place in the JSON."""

    def change(root):
        for key in keys[:-1]:
            root = root[key]
        root[keys[-1]] = value

    return changed(change)


def spread(root):
    """A billion zeros."""
    del root["accessors"][1]["bufferView"]
    root["accessors"][1]["count"] = 10**9


def again(root):
    """One channel twice."""
    root["animations"][0]["channels"] *= 2


def lone(root):
    """Joints without weights."""
    del root["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]


def ring(root):
    """Two nodes below each other."""
    root["nodes"] += [{"children": [8]}, {"children": [7]}]


FAR_INDEX = {"count": 1, "indices": {"componentType": 5125, "bufferView": 3}, "values": {"bufferView": 1}}
CLAIMS = {
    "version": (put("1.0", "asset", "version"), "glTF 1.0"),
    "no version": (put({}, "asset"), "of no version"),
    "asset": (put([], "asset"), "'asset' must be an object|asset must be an object"),
    "draco": (put(["KHR_draco_mesh_compression"], "extensionsRequired"), "without compression"),
    "meshopt": (put(["EXT_meshopt_compression"], "extensionsRequired"), "without compression"),
    "extension": (put(["ACME_mesh"], "extensionsRequired"), "requires the extension ACME_mesh"),
    "extensions": (put("EXT", "extensionsRequired"), "list of strings"),
    "count": (put(10**9, "accessors", 1, "count"), "takes 12000000000 bytes of bufferView 1|hold many times more"),
    "huge count": (put(10**400, "accessors", 1, "count"), "'count' is 1000"),
    "small count": (put(13, "accessors", 1, "count"), "takes 156 bytes of bufferView 1, which has 144"),
    "negative count": (put(-1, "accessors", 1, "count"), "whole number"),
    "boolean count": (put(True, "accessors", 1, "count"), "whole number"),
    "missing count": (changed(lambda root: root["accessors"][1].pop("count")), "is missing"),
    "endless zeros": (changed(spread), "many times more"),
    "component": (put(5124, "accessors", 1, "componentType"), "known component type"),
    "type": (put("VEC2", "accessors", 1, "type"), "must be of type VEC3"),
    "type of joints": (put(5126, "accessors", 2, "componentType"), "unsigned integers"),
    "offset": (put(4, "accessors", 1, "byteOffset"), "takes 148 bytes"),
    "stride 0": (put(0, "bufferViews", 1, "byteStride"), "a stride of 0 bytes"),
    "huge stride": (put(2**40, "bufferViews", 1, "byteStride"), "a stride of"),
    "long stride": (put(16, "bufferViews", 1, "byteStride"), "takes 188 bytes"),
    "view": (put(10**6, "bufferViews", 1, "byteLength"), "bufferView 1 .* ends at byte"),
    "view's start": (put(10**18, "bufferViews", 1, "byteOffset"), "whole number|ends at byte"),
    "missing view": (put(99, "accessors", 1, "bufferView"), r"bufferViews\[99\]"),
    "missing buffer": (put(1, "bufferViews", 1, "buffer"), r"buffers\[1\]"),
    "buffer without data": (
        changed(lambda root: (root["bufferViews"][1].update(buffer=1), root.update(buffers=[{}, {"byteLength": 200}]))),
        "buffer 1 has no data",
    ),
    "list of accessors": (put({}, "accessors"), "list of objects"),
    "list of nodes": (put([1], "nodes"), "list of objects"),
    "name": (put(5, "nodes", 0, "name"), "must be a string"),
    "many nodes": (put([{}] * (2**17 + 1), "nodes"), "at most 131072"),
    "circle": (put([1], "nodes", 5, "children"), "node 1 is a child of node 0 and of node 5"),
    "closed circle": (changed(ring), "below itself"),
    "own child": (changed(lambda root: root["nodes"].append({"children": [7]})), "below itself"),
    "two parents": (put([3], "nodes", 6, "children"), "node 3 is a child of node 2 and of node 6"),
    "child": (put([77], "nodes", 6, "children"), "'children' must be a list of indices"),
    "children": (put(3, "nodes", 6, "children"), "'children' must be a list of indices"),
    "scene": (put([{"nodes": [50]}], "scenes"), "scene 0"),
    "scene number": (changed(lambda root: root.update(scenes=[{}], scene=1)), "'scene'"),
    "translation": (put([1, 2], "nodes", 0, "translation"), "3 finite numbers"),
    "null": (put(None, "nodes", 0, "translation"), "3 finite numbers"),
    "word": (put(["1", 2, 3], "nodes", 0, "translation"), "3 finite numbers"),
    "too large": (put([10**400, 0, 0], "nodes", 0, "translation"), "3 finite numbers"),
    "overflow": (put([1e200, 0, 0], "nodes", 0, "scale"), "out of bounds"),
    "zero rotation": (put([0, 0, 0, 0], "nodes", 0, "rotation"), "node 0: the rotation is zero"),
    "matrix": (put([1] * 15, "nodes", 0, "matrix"), "16 finite numbers"),
    "no affine map": (put([*range(1, 17)], "nodes", 6, "matrix"), "last row"),
    "flat root": (put([0, 0, 0], "nodes", 1, "scale"), "root joint: it is singular"),
    "joints": (put([1, 1], "skins", 0, "joints"), "each once"),
    "no joints": (put([], "skins", 0, "joints"), "each once"),
    "joint": (put([1, 99], "skins", 0, "joints"), "'joints' must be a list of indices"),
    "few matrices": (put([1, 4, 3, 5, 0], "skins", 0, "joints"), "5 joints but 4 inverse"),
    "joint of a weight": (put([1, 4, 3], "skins", 0, "joints"), "refers to joint 3 of a skin of 3"),
    "mesh": (put(4, "nodes", 6, "mesh"), "'mesh' is 4"),
    "skin": (put(4, "nodes", 6, "skin"), "'skin' is 4"),
    "primitives": (put(1, "meshes", 0, "primitives"), "list of objects"),
    "mode": (put(-1, "meshes", 0, "primitives", 0, "mode"), "whole number"),
    "attributes": (put([], "meshes", 0, "primitives", 0, "attributes"), "must be an object"),
    "no positions": (put({}, "meshes", 0, "primitives", 0, "attributes"), "no positions"),
    "positions": (put(1.5, "meshes", 0, "primitives", 0, "attributes", "POSITION"), "whole number"),
    "no weights": (changed(lone), "without the other"),
    "sizes": (put(11, "accessors", 2, "count"), "12 positions, 11 JOINTS_0 and 12 WEIGHTS_0"),
    "corners": (put(11, "accessors", 4, "count"), "no whole triangles"),
    "corner": (put(11, "accessors", 1, "count"), "11 positions, 12|refers to vertex 11 of 11"),
    "sparse": (put({}, "accessors", 1, "sparse"), "'count' is missing"),
    "sparse object": (put(7, "accessors", 1, "sparse"), "must be an object"),
    "sparse count": (put({"count": 13}, "accessors", 1, "sparse"), "'count' is 13"),
    "sparse type": (put({"count": 1, "indices": {"componentType": 5126}}, "accessors", 1, "sparse"), "unsigned"),
    "sparse index": (
        put(FAR_INDEX, "accessors", 1, "sparse"),
        "sparse index",
    ),
    "interpolation": (put("CUBIC", "animations", 0, "samplers", 0, "interpolation"), "unknown interpolation 'CUBIC'"),
    "spline": (put("CUBICSPLINE", "animations", 0, "samplers", 0, "interpolation"), "2 keys need 6 values, not 2"),
    "keys": (put(1, "accessors", 5, "count"), "1 keys need 1 values, not 2"),
    "no keys": (put(0, "accessors", 5, "count"), "must increase"),
    "input": (put(6, "animations", 0, "samplers", 0, "input"), "must be of type SCALAR"),
    "sampler": (put(1, "animations", 0, "channels", 0, "sampler"), "'sampler' is 1"),
    "node": (put(99, "animations", 0, "channels", 0, "target", "node"), "'node' is 99"),
    "twice": (changed(again), "animated twice"),
    "moved matrix": (
        changed(lambda root: root["nodes"].__setitem__(3, {"matrix": np.eye(4).ravel().tolist(), "children": [5]})),
        "the rotation of node 3 has a matrix",
    ),
    "nothing": (changed(lambda root: root.update(meshes=[], nodes=[], skins=[], animations=[])), "neither a mesh"),
}  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS)
def test_wrong_claims_are_refused(character, tmp_path, claim):
    make, match = CLAIMS[claim]
    refused(tmp_path, make(character), match)


@pytest.mark.parametrize(
    ("accessor", "values", "match"),
    [
        (0, np.full((4, 16), np.nan), "not finite"),
        (0, np.tile(np.diag([1, 1, 0, 1]).ravel(), (4, 1)), "inverse bind matrix 0: it is singular"),
        (0, np.tile(np.ones(16), (4, 1)), "last row"),
        (0, np.tile((np.eye(4) * [1e-30, 1e-30, 1e-30, 1]).ravel(), (4, 1)), None),
        (0, np.array([np.diag([s, s, s, 1]).ravel() for s in (1e37, 1e-37, 1, 1)]), "out of bounds"),
        (1, np.full((12, 3), np.inf), "not finite"),
        (5, [[1.0], [1.0]], "must increase"),
        (5, [[2.0], [1.0]], "must increase"),
        (5, [[np.nan], [1.0]], "not finite"),
        (6, np.zeros((2, 4)), "key 0 is zero"),
    ],
)
def test_numbers_that_contradict_each_other(character, tmp_path, accessor, values, match):
    file = character
    animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
    file.root["accessors"][accessor] = file.root["accessors"][file.accessor(values)]
    if match is None:
        assert np.isfinite(file.read(tmp_path).mesh.V).all()
    else:
        refused(tmp_path, file, match)


def test_animations_out_of_bounds(character, tmp_path):
    file = character
    file.root["nodes"][0]["scale"] = [1e25] * 3
    del file.root["skins"][0]["inverseBindMatrices"]
    animate(file, "wave", [(1, "scale", "LINEAR", [0], [[1e38] * 3])])
    refused(tmp_path, file, "animation 'wave': the transform of bone 0 at 0 s is out of bounds")


def test_animations_of_many_frames_and_nodes(tmp_path):
    file = File(skins=[{"joints": [*range(1000)]}])
    for _ in range(1000):
        file.node()
    animate(file, "long", [(0, "scale", "LINEAR", np.arange(5000), np.ones((5000, 3)))])
    refused(tmp_path, file, "5000 frames of 1000 nodes, too many")


def test_meshes_repeated_without_end(tmp_path):
    file = File()
    mesh = file.mesh({"POSITION": file.accessor(np.ones((999, 3)))})
    for _ in range(10**4):
        file.node(mesh=mesh)
    refused(tmp_path, file, "many times more numbers than the file has bytes")


def test_corners_beyond_the_vertices(tmp_path):
    file = File()
    file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 3]))
    refused(tmp_path, file, "mesh 0, primitive 0 refers to vertex 3 of 3")


def test_whole_numbers_may_be_written_with_a_point(character, tmp_path):
    character.root["nodes"][6]["mesh"] = 0.0
    assert len(character.read(tmp_path).mesh.V) == 12


def test_names_with_line_ends_stay_on_one_line(character, tmp_path):
    file = character
    file.root["nodes"][3]["name"] = "ar\nm\ud800"
    assert file.read(tmp_path).skeleton.names[2] == "ar?m?"


GOOD = b'{"asset":{"version":"2.0"}}'


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("a.gltf", b"", "empty"),
        ("a.gltf", b"[" * 10**5, "too deep"),
        ("a.gltf", b'{"a":' * 10**5, "too deep"),
        ("a.gltf", b'{"asset": NaN}', "NaN"),
        ("a.gltf", b'\n{"asset": }', "a.gltf:2: this is no JSON"),
        ("a.gltf", b"\xff\xfd", "this JSON cannot be used"),
        ("a.gltf", b'{"a": ' + b"9" * 10**4 + b"}", "this JSON cannot be used"),
        ("a.gltf", b"[]", "must be an object"),
        ("a.gltf", GOOD, "neither a mesh"),
        ("a.obj", GOOD, "must end in .gltf or .glb"),
        ("a.glb", GOOD, "no GLB"),
        ("a.glb", b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "GLB version 1"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 2**32 - 1) + bytes(8), "claims 4294967295 bytes"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 24) + struct.pack("<I", 99) + b"JSON{}  ", "claims 99 bytes"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 24) + struct.pack("<I", 4) + b"BIN\0{}  ", "must be JSON"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 12) + bytes(12), "must be JSON"),
        ("a.glb", glb("{"), "a.glb: this is no JSON"),
    ],
)
def test_containers_with_wrong_headers(tmp_path, name, content, match):
    refused(tmp_path, content, match, name)


def check(path, content):
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    try:
        parts = read_gltf(path)
    except (FileFormatError, FileNotFoundError):
        return
    if parts.mesh is not None:
        assert np.isfinite(parts.mesh.V).all()
        assert ((parts.mesh.E >= 0) & (len(parts.mesh.V) > parts.mesh.E)).all()
    assert all(np.isfinite(clip.B).all() for clip in parts.clips)


@given(data=st.data())
def test_any_bytes_in_a_good_file(character, tmp_path, data):
    content = bytearray(character.glb())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.sampled_from([0, 1, 4, 60]))] = data.draw(st.binary(max_size=4))
    check(tmp_path / "a.glb", bytes(content))


ODD = [None, True, -1, 0, 1, 2, 3.5, 10**9, 10**40, 1e300, "", "VEC3", "..", [], [0], [1e308] * 3, {}, [{}], [[]]]
VALUES = st.sampled_from([*ODD, {"count": 1}])


def places(value, path=()):
    """All places in a JSON value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, below in inner:
        yield (*path, key)
        yield from places(below, (*path, key))


@given(data=st.data())
def test_any_values_in_a_good_file(character, tmp_path, data):
    file = character
    if "animations" not in file.root:
        animate(file, "wave", [(3, "rotation", "LINEAR", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])])
    root = json.loads(json.dumps(file.json()))
    for _ in range(data.draw(st.integers(1, 3))):
        keys = data.draw(st.sampled_from([*places(root)]))
        inner = root
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = data.draw(VALUES)
    check(tmp_path / "a.glb", glb(root, file.data))
