"""Extensions that hold a mesh's data or place it: refused by what they leave empty, read where it is there too."""

import base64
import json

import numpy as np
import pytest

from nilbs.io import FileFormatError
from nilbs.io.gltf import read_gltf

from .files import TRIANGLE, File, animate, glb, matrix, quaternion

DRACO, MESHOPT, INSTANCES = "KHR_draco_mesh_compression", "EXT_meshopt_compression", "EXT_mesh_gpu_instancing"
COMPRESSED = r"it is compressed \({}\), which is not read: export it again without compression"


def triangle(**primitive):
    """A file of one triangle, and its primitive."""
    file = File()
    file.node(mesh=file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 2], **primitive))
    return file, file.root["meshes"][0]["primitives"][0]


def emptied(file, *accessors):
    for index in accessors:
        del file.root["accessors"][index]["bufferView"]


@pytest.mark.parametrize("used", [[DRACO], [DRACO, "KHR_materials_unlit"], []])
@pytest.mark.parametrize("accessors", [(0, 1), (0,), (1,)])
def test_optional_compression_is_refused_where_it_leaves_data_out(tmp_path, used, accessors):
    file, _ = triangle(extensions={DRACO: {"bufferView": 0, "attributes": {"POSITION": 0}}})
    file.root["extensionsUsed"] = used
    assert np.array_equal(file.read(tmp_path).mesh.V, TRIANGLE)  # the fallback
    emptied(file, *accessors)
    with pytest.raises(FileFormatError, match=COMPRESSED.format(DRACO)):
        file.read(tmp_path)


def test_an_unknown_extension_that_holds_the_data_is_named(tmp_path):
    file, primitive = triangle(extensions={"ACME_mesh": {}, "KHR_materials_variants": {}})
    file.root["extensionsUsed"] = ["ACME_mesh", "KHR_materials_variants"]
    assert np.array_equal(file.read(tmp_path).mesh.V, TRIANGLE)
    emptied(file, 0)
    with pytest.raises(
        FileFormatError, match=r"accessor 0 \(mesh 0, primitive 0, positions\) is left to the extension ACME_m"
    ):
        file.read(tmp_path)
    file.root["accessors"][0]["extensions"] = {"ACME_codec": {}}
    del primitive["extensions"]["ACME_mesh"]
    with pytest.raises(FileFormatError, match="left to the extension ACME_codec, which is not read: export it without"):
        file.read(tmp_path)
    # Without an extension these are zeros, as the specification has it.
    del file.root["accessors"][0]["extensions"]
    assert not file.read(tmp_path).mesh.V.any()


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("name", [MESHOPT, "KHR_meshopt_compression"])
def test_a_fallback_buffer_is_read_if_it_is_there(tmp_path, suffix, name):
    file, _ = triangle()
    size = len(file.data)
    compressed = file.view(b"\0" * 8)
    for view in file.root["bufferViews"][:compressed]:
        view["extensions"] = {name: {"buffer": 0, "byteOffset": 0, "byteLength": 8, "count": 3}}
        view["buffer"] = 1
    fallback = {"byteLength": size, "extensions": {name: {"fallback": True}}}
    file.root["buffers"] = [None, fallback]
    path = tmp_path / f"a{suffix}"

    def read():
        path.unlink(missing_ok=True)
        if suffix == ".glb":
            path.write_bytes(file.glb())
        else:
            root = file.json()
            root["buffers"][0]["uri"] = f"data:;base64,{base64.b64encode(file.data).decode()}"
            path.write_text(json.dumps(root))
        return read_gltf(path)

    with pytest.raises(FileFormatError, match=COMPRESSED.format(name)):
        read()
    fallback["uri"] = f"data:;base64,{base64.b64encode(file.data[:size]).decode()}"
    assert np.array_equal(read().mesh.V, TRIANGLE)


def test_the_chunk_of_a_glb_file_is_no_fallback_buffer(tmp_path):
    file, _ = triangle()
    root = file.json()
    root["buffers"][0]["extensions"] = {MESHOPT: {"fallback": True}}
    (tmp_path / "a.glb").write_bytes(glb(root, file.data))
    with pytest.raises(FileFormatError, match=COMPRESSED.format(MESHOPT)):
        read_gltf(tmp_path / "a.glb")


def instanced(rng, count=3, **node):
    """A triangle at a node with instances, and where they stand relative to it."""
    file = File(extensionsUsed=[INSTANCES], extensionsRequired=[INSTANCES])
    moves, scales = rng.normal(size=(count, 3)).astype("f4"), rng.uniform(0.5, 2, (count, 3)).astype("f4")
    turns = np.array([quaternion(rng) for _ in range(count)], "f4")
    values = {"TRANSLATION": moves, "ROTATION": turns, "SCALE": scales}
    attributes = {name: file.accessor(value) for name, value in values.items()}
    mesh = file.mesh({"POSITION": file.accessor(TRIANGLE)}, [0, 1, 2])
    file.node(name="tree", mesh=mesh, extensions={INSTANCES: {"attributes": attributes}}, **node)
    return file, attributes, [matrix(*parts) for parts in zip(moves, turns, scales, strict=True)]


def moved(M):
    return np.array(TRIANGLE) @ M[:3, :3].T + M[:3, 3]


def test_instances_are_copies(tmp_path, rng):
    file, attributes, places = instanced(rng, translation=[1, 2, 3], scale=[-1, 1, 1])
    parts = file.read(tmp_path)
    above = matrix((1, 2, 3), s=(-1, 1, 1))
    np.testing.assert_allclose(parts.mesh.V, np.concatenate([moved(above @ M) for M in places]), atol=1e-5)
    assert parts.mesh.E.tolist() == [[2, 1, 0], [5, 4, 3], [8, 7, 6]]  # of a mirrored node
    assert parts.mesh.groups["tree"].tolist() == [0, 1, 2]
    assert parts.notes == ("'tree' is an instance of its mesh at 3 places: there are so many copies of it",)
    del attributes["ROTATION"], attributes["SCALE"]
    V = file.read(tmp_path).mesh.V.reshape(3, 3, 3)
    shifts = np.array([M[:3, 3] for M in places])
    np.testing.assert_allclose(V, moved(above)[None] + (shifts * [-1, 1, 1])[:, None], atol=1e-5)
    attributes.clear()
    parts = file.read(tmp_path)
    np.testing.assert_allclose(parts.mesh.V, moved(above), atol=1e-6)
    assert "'tree' is shown once" in parts.notes[0]


def test_instances_that_contradict_each_other(tmp_path, rng):
    file, attributes, _ = instanced(rng)
    attributes["SCALE"] = file.accessor(np.ones((2, 3)))
    with pytest.raises(FileFormatError, match="'tree', EXT_mesh_gpu_instancing, SCALE: 2 instances, and 3 before"):
        file.read(tmp_path)
    attributes["ROTATION"] = file.accessor(np.zeros((3, 4)))
    attributes["SCALE"] = file.accessor(np.ones((3, 3)))
    with pytest.raises(FileFormatError, match="a rotation is zero"):
        file.read(tmp_path)
    file.root["nodes"][0]["extensions"][INSTANCES] = {"attributes": []}
    with pytest.raises(FileFormatError, match="'attributes' must be an object"):
        file.read(tmp_path)


def test_too_many_instances_are_refused(tmp_path, rng):
    file, attributes, _ = instanced(rng)
    attributes.clear()
    attributes["TRANSLATION"] = file.accessor(np.zeros((3, 3)))
    entry = file.root["accessors"][attributes["TRANSLATION"]]
    del entry["bufferView"]
    entry["count"] = 20_000
    with pytest.raises(FileFormatError, match="its nodes have 19999 instances; at most 16384 are read"):
        file.read(tmp_path)


def test_a_skin_is_not_instanced(character, tmp_path, rng):
    plain = character.read(tmp_path).mesh.V
    node = next(node for node in character.root["nodes"] if "skin" in node)
    attributes = {"TRANSLATION": character.accessor(rng.normal(size=(2, 3)))}
    node["extensions"] = {INSTANCES: {"attributes": attributes}}
    parts = character.read(tmp_path)
    assert np.array_equal(parts.mesh.V, plain)
    assert any("is shown once: its instances name no place, or have a skin" in note for note in parts.notes)


@pytest.mark.parametrize(("kind", "steps"), [("i2", 2**15 - 1), ("u2", 2**16 - 1), ("i1", 127)])
@pytest.mark.parametrize("normalized", [False, True])
def test_a_quantized_skin_takes_its_scale_from_the_bind_matrices(character, tmp_path, kind, steps, normalized):
    """As gltfpack writes it: the map from whole numbers to places is part of each inverse bind matrix."""
    animate(character, "a", [(3, "translation", "LINEAR", [0, 1], [[0, 2, 0], [1, 0, 0]])])
    plain = character.read(tmp_path)
    low = character.v.min(axis=0) if kind[0] == "u" else np.zeros(3)
    size = np.abs(character.v - low).max()
    whole = np.rint((character.v - low) / size * steps)
    attributes = character.root["meshes"][0]["primitives"][0]["attributes"]
    attributes["POSITION"] = character.accessor(whole, kind, normalized=normalized)
    binds = character.bind @ matrix(low, s=np.full(3, size / (1 if normalized else steps)))
    character.root["skins"][0]["inverseBindMatrices"] = character.accessor(np.swapaxes(binds, 1, 2))
    character.root["nodes"][6]["scale"] = [3, 3, 3]  # of a skinned mesh, that counts for nothing
    parts = character.read(tmp_path)
    stretch = np.linalg.norm(character.place[:3, :3], 2)
    np.testing.assert_allclose(parts.mesh.V, plain.mesh.V, atol=2 * size / steps * stretch)
    np.testing.assert_allclose(parts.skeleton.C, plain.skeleton.C, atol=1e-4)
    np.testing.assert_allclose(parts.clips[0].B, plain.clips[0].B, atol=1e-3)
