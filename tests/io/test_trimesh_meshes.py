import io
import zipfile

import numpy as np
import pytest
import trimesh

from nilbs.io import FileFormatError, read_mesh, trimesh_meshes, write_mesh
from nilbs.io.mesh import read_mesh_parts

NAMESPACE = 'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"'
VERTICES = '<vertices><vertex x="0" y="0" z="1"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/></vertices>'
MESH = f'<mesh>{VERTICES}<triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh>'
OBJECT = f'<object id="1" name="arm">{MESH}</object>'
ITEM = '<item objectid="1"/>'


def model(objects=OBJECT, items=ITEM, unit="", head=""):
    start = f"{head}<model {NAMESPACE} {unit}>"
    return f"{start}<resources>{objects}</resources><build>{items}</build></model>".encode()


def packed(content, name="3D/3dmodel.model", **more):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
        for other, text in more.items():
            archive.writestr(other, text)
    return data.getvalue()


@pytest.fixture
def threemf(tmp_path):
    def read(content):
        path = tmp_path / "a.3mf"
        path.write_bytes(content)
        return read_mesh_parts(path)

    return read


@pytest.mark.parametrize("suffix", [".off", ".stl", ".3mf"])
@pytest.mark.parametrize("scale", [1, 1e-6, 1e6])
def test_what_is_written_is_read(tmp_path, rng, suffix, scale):
    V = rng.normal(size=(20, 3)) * scale
    F = np.array([rng.choice(20, 3, replace=False) for _ in range(40)])
    path = tmp_path / f"a{suffix}"
    write_mesh(path, V, F)
    U, G = read_mesh(path)
    if suffix == ".stl":
        assert np.allclose(U[G], V[F], rtol=1e-6, atol=0)
    else:
        assert np.abs(U - V).max() <= 1e-16 * np.abs(V).max()
        assert np.array_equal(G, F)
    assert type(U) is np.ndarray
    other = trimesh.load_mesh(path, process=False)
    assert np.allclose(other.vertices[other.faces], V[F], atol=1e-6 * scale)


@pytest.mark.parametrize("suffix", [".off", ".stl", ".3mf"])
def test_flat_and_empty(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    V = np.array([[0, 0], [1, 0], [0, 0.5]])
    write_mesh(path, V, [[0, 1, 2]])
    assert read_mesh(path)[0].tolist() == V.tolist()
    with pytest.raises(ValueError, match="outline"):
        write_mesh(path, V, [[0, 1]])
    assert len(read_mesh(path)[1]) == 1  # the file is as it was
    write_mesh(path, np.zeros((0, 3)), np.zeros((0, 3), int))
    with pytest.raises(FileFormatError):
        read_mesh(path)


def test_stl_holds_numbers_of_32_bits(tmp_path):
    with pytest.raises(ValueError, match=r"1e\+39"):
        write_mesh(tmp_path / "a.stl", [[0, 0, 1e39], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert not (tmp_path / "a.stl").exists()


def test_3mf_keeps_numbers_and_order_and_reports_another_unit(threemf):
    mesh = threemf(packed(model(unit='unit="inch"')))
    assert mesh.V.tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert mesh.E.tolist() == [[0, 1, 2]]
    assert any("inch" in note for note in mesh.notes)
    assert threemf(packed(model())).notes == threemf(packed(model(unit='unit="millimeter"'))).notes == ()


def test_placed_objects_are_groups_moved_and_turned_outward(threemf):
    component = '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>'
    inner = f'<object id="2"><components>{component}</components></object>'
    mirrored = '<item objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/>'
    mesh = threemf(packed(model(OBJECT + inner, f'{ITEM}{mirrored}<item objectid="2"/>')))
    normals = np.cross(mesh.V[mesh.E[:, 1]] - mesh.V[mesh.E[:, 0]], mesh.V[mesh.E[:, 2]] - mesh.V[mesh.E[:, 0]])
    found = {tuple(V[:, 0].tolist()): normal.tolist() for V, normal in zip(mesh.V[mesh.E], normals, strict=True)}
    assert found.pop((0, 1, 0)) == found.pop((5, 6, 5)) == [1, 1, 1]
    ((corners, normal),) = found.items()
    assert sorted(corners) == [-1, 0, 0]
    assert normal == [-1, 1, 1]
    assert sorted(faces.tolist() for faces in mesh.groups.values()) == [[0], [1], [2]]


def test_many_solids_of_one_name_are_one_group(tmp_path):
    facet = "facet\nvertex 0 0 1\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    (tmp_path / "a.stl").write_text(f"solid a\n{facet}endsolid a\n" * 3000)
    assert len(read_mesh_parts(tmp_path / "a.stl").groups["a"]) == 3000


def test_an_object_that_is_not_placed_is_left_out(threemf):
    assert len(threemf(packed(model(OBJECT + OBJECT.replace('"1"', '"9"')))).E) == 1


def nested(levels, times):
    """Objects that each hold the one before several times."""
    objects = OBJECT
    for level in range(2, levels + 2):
        inner = f'<component objectid="{level - 1}"/>' * times
        objects += f'<object id="{level}"><components>{inner}</components></object>'
    return packed(model(objects, f'<item objectid="{levels + 1}"/>'))


def test_objects_may_be_nested(threemf):
    assert len(threemf(nested(3, 2)).E) == 8


ENTITY = '<?xml version="1.0"?><!DOCTYPE model [<!ENTITY a SYSTEM "file:///etc/hostname">]>'


@pytest.mark.parametrize(
    ("content", "fact"),
    [
        (b"hello", "damaged .3mf"),
        (packed(model())[:-10], "damaged .3mf"),
        (packed(model(), "other"), "3dmodel.model"),
        (packed(model(), **{"3D/3dmodel.model.copy": "x"}), "here are 2"),
        (packed(b""), "empty"),
        (packed(b"<model>"), "cannot be read"),
        (packed(model().decode().encode("utf-16")), "UTF-8"),
        (packed(model(head=ENTITY)), "UTF-8"),
        (packed(model(items="")), "places no object"),
        (packed(model(items='<item objectid="7"/>')), "no vertex"),
        (packed(model(OBJECT.replace('x="1"', 'x="nan"'))), "finite"),
        (packed(model(OBJECT.replace('x="1"', 'x="a"'))), "trimesh cannot read"),
        (packed(model(OBJECT.replace('x="1"', ""))), "trimesh cannot read"),
        (packed(model(OBJECT.replace('v3="2"', 'v3="3"'))), "vertex 3 of 3"),
        (packed(model(OBJECT.replace('v3="2"', 'v3="-1"'))), "vertex -1 of 3"),
        (packed(model(items='<item objectid="1" transform="1 2"/>')), "trimesh cannot read"),
        (packed(model(items='<item objectid="1" xmlns:p="q" p:path="/3D/b.model"/>')), "several files"),
        (packed(model(OBJECT.replace('id="1"', ""))), "'id'"),
        (packed(model(OBJECT + OBJECT.replace("</mesh>", f"</mesh>{OBJECT}"))), "object in object"),
        (packed(model(items=f"<build>{ITEM}</build>")), "build in build"),
        (packed(model(OBJECT.replace("</vertices>", f"{MESH}</vertices>"))), "mesh in vertices"),
        (packed(b" " * 2**21), "2097152 bytes"),
        (packed(model(items=ITEM * 5000)), "4096 objects"),
        (packed(model('<object id="1"><mesh/></object>' * 9000)), "16384 objects"),
        (nested(13, 3), "4096 objects"),
        (nested(6, 3), "of one another"),
        (nested(30, 1), "16 times deep"),
        (packed(model('<object id="1"><components><component objectid="1"/></components></object>')), "of one another"),
    ],
)
def test_errors(threemf, content, fact):
    with pytest.raises(FileFormatError) as caught:
        threemf(content)
    assert "a.3mf: " in str(caught.value)
    assert fact in str(caught.value)


def test_triangles_of_all_placed_objects_are_bounded(threemf, monkeypatch):
    monkeypatch.setattr(trimesh_meshes, "_TRIANGLES", 2)
    assert len(threemf(packed(model(items=ITEM * 2))).E) == 2
    with pytest.raises(FileFormatError, match="more than 2 triangles"):
        threemf(packed(model(items=ITEM * 3)))


@pytest.mark.parametrize("name", ["a.off", "a.stl"])
def test_text_is_bounded(tmp_path, name):
    with open(tmp_path / name, "wb") as file:
        file.write(b"solid a\n")
        file.truncate(trimesh_meshes.TEXT_LIMIT + 1)
    with pytest.raises(FileFormatError, match="64 MiB"):
        read_mesh(tmp_path / name)


def test_a_large_model_in_a_3mf_file_is_refused(threemf, monkeypatch):
    monkeypatch.setattr(trimesh_meshes, "TEXT_LIMIT", 100)
    with pytest.raises(FileFormatError, match="larger than"):
        threemf(packed(model()))
